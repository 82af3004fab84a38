defmodule Aerie.Console.Pages.Fleet.OnMap do
  @moduledoc "Sends changes to the page's map. What it has got is in `socket.private.fleet`: `:sent`, `:homes`."

  import Phoenix.LiveView

  alias Aerie.Console.Pages.Fleet.Board.Row
  alias Aerie.Console.Map.Payload
  alias Phoenix.LiveView.Socket

  @doc "Pushes the vehicles and homes that differ from those of the last time; nothing before the page is connected."
  @spec push_vehicles(Socket.t(), map_id :: String.t(), [Row.t()]) :: Socket.t()
  def push_vehicles(%{private: %{fleet: fleet}} = socket, map, rows) do
    if connected?(socket) do
      {payload, sent} = Payload.changes(fleet.sent, for(%{on_map: [_ | _] = row} <- rows, do: row))
      homes = Payload.homes(Enum.map(rows, & &1.home))

      socket
      |> push(payload != nil, "map:vehicles", payload, map)
      |> push(homes != fleet.homes, "map:homes", %{homes: homes}, map)
      |> put_private(:fleet, %{fleet | sent: sent, homes: homes})
    else
      socket
    end
  end

  defp push(socket, true, event, payload, map), do: push_event(socket, event, Map.put(payload, :map, map))
  defp push(socket, false, _event, _payload, _map), do: socket
end
