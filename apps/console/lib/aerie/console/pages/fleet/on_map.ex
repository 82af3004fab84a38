defmodule Aerie.Console.Pages.Fleet.OnMap do
  @moduledoc "Sends what the board has for the page's map."

  import Phoenix.LiveView

  alias Phoenix.LiveView.Socket

  @doc "Pushes the vehicles and homes that have changed since the last time; nothing before the page is connected."
  @spec push_vehicles(Socket.t(), map_id :: String.t(), news :: map()) :: Socket.t()
  def push_vehicles(socket, map, news) do
    if connected?(socket) do
      socket
      |> push("map:vehicles", news.drawn, map)
      |> push("map:homes", news.places && Map.take(news.places, [:homes]), map)
    else
      socket
    end
  end

  defp push(socket, _event, nil, _map), do: socket
  defp push(socket, event, payload, map), do: push_event(socket, event, Map.put(payload, :map, map))
end
