defmodule Aerie.Console.Pages.Fleet.OnMap do
  @moduledoc "Sends what the board has for the page's map, and says what the menu of a place offers there."

  import Phoenix.LiveView

  alias Aerie.Console.Commands.Guided
  alias Aerie.Console.Map.Zones
  alias Aerie.Control.Policy
  alias Aerie.Fleet
  alias Phoenix.LiveView.Socket

  @doc "The menu of a place, for the vehicles that are selected: one can be sent there, from its own page."
  @spec menu([String.t()], term(), map()) :: map()
  def menu(selected, gateway, user) do
    with [id] <- selected, %{} = vehicle <- Fleet.vehicle(gateway, id) do
      Guided.menu(vehicle, user, "/vehicles/#{URI.encode(id, &URI.char_unreserved?/1)}")
    else
      _none_or_many -> %{items: [], note: "Select one vehicle to send it here."}
    end
  end

  @doc "Pushes the policy's zones."
  @spec push_zones(Socket.t(), map_id :: String.t()) :: Socket.t()
  def push_zones(%{assigns: %{gateway: gateway}} = socket, map),
    do: push_event(socket, "map:zones", %{map: map, zones: Zones.of(Policy.in_force(gateway))})

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
