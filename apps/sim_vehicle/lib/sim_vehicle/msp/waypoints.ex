defmodule SimVehicle.Msp.Waypoints do
  @moduledoc """
  The mission of iNav: a value. A waypoint out of order or of an unknown action is acknowledged and ignored, number 1 begins a new mission,
  and the flag of the last one makes it valid.
  """

  alias SimVehicle.Msp.Flight

  @room 120
  @last 0xA5
  @actions [1, 3, 4, 5, 6, 7, 8]
  @beyond <<4, 0::144, @last>>

  defstruct list: [], stored: [], home: nil, desired: nil

  @typedoc "`home`, `desired`: latitude, longitude, height above the origin (12 bytes), set where iNav takes them"
  @type t :: %__MODULE__{list: [binary], stored: [binary], home: binary | nil, desired: binary | nil}

  @doc "WP_GETINFO."
  @spec info(t) :: binary
  def info(%{list: list} = mission), do: <<0, @room, valid(mission), length(list)>>

  defp valid(%{list: []}), do: 0
  defp valid(%{list: list}), do: if(:binary.last(List.last(list)) == @last, do: 1, else: 0)

  @doc """
  WP: the waypoint of a number, or what iNav says of one that is not there. Its home, and where it is and wants to be,
  have heights above sea level.
  """
  @spec get(t, byte, Flight.t()) :: binary
  def get(%{list: list}, number, _flight) when number in 1..@room,
    do: Enum.at(list, number - 1) || <<number>> <> @beyond

  def get(%{home: place}, 0, flight) when place != nil, do: above_sea(0, place, flight)
  def get(%{desired: place}, 254, flight) when place != nil, do: above_sea(254, place, flight)
  def get(_mission, 255, flight), do: above_sea(255, place(flight), flight)
  def get(_mission, number, _flight), do: <<number>> <> @beyond

  defp above_sea(number, <<place::binary-size(8), height::32-little-signed>>, flight),
    do: <<number, 1, place::binary, round(flight.ground * 100) + height::32-little-signed, 0::56>>

  defp place(flight),
    do:
      <<round(flight.lat * 1.0e7)::32-little-signed, round(flight.lon * 1.0e7)::32-little-signed,
        round(flight.alt * 100)::32-little-signed>>

  @doc "It is armed: its first home is here."
  @spec armed(t, Flight.t()) :: t
  def armed(%{home: nil} = mission, flight), do: %{mission | home: place(flight)}
  def armed(mission, _flight), do: mission

  @doc "SET_WP of home (0) or of where to fly (255), which the vehicle takes now or ignores."
  @spec place(t, 0 | 255, binary, takes? :: boolean) :: t
  def place(mission, _number, _place, false), do: mission
  def place(mission, 0, place, true), do: %{mission | home: place}
  def place(mission, 255, place, true), do: %{mission | desired: place}

  @doc "SET_WP, 21 bytes."
  @spec set(t, binary) :: t
  def set(%{list: list} = mission, <<number, action, _rest::binary>> = waypoint) do
    cond do
      action not in @actions -> mission
      number == 1 -> %{mission | list: [waypoint]}
      number == length(list) + 1 and number <= @room -> %{mission | list: list ++ [waypoint]}
      true -> mission
    end
  end

  @doc "WP_MISSION_SAVE."
  @spec save(t) :: {:ok, t} | :error
  def save(mission),
    do: if(valid(mission) == 1, do: {:ok, %{mission | stored: mission.list}}, else: :error)

  @doc "WP_MISSION_LOAD."
  @spec load(t) :: t
  def load(mission), do: %{mission | list: mission.stored}

  @doc "After a restart."
  @spec restarted(t) :: t
  def restarted(mission), do: %{mission | list: []}
end
