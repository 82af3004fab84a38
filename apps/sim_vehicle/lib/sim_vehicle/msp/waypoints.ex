defmodule SimVehicle.Msp.Waypoints do
  @moduledoc """
  The mission of iNav: a value. A waypoint out of order or of an unknown action is acknowledged and ignored, number 1 begins a new mission,
  and the flag of the last one makes it valid.
  """

  @room 120
  @last 0xA5
  @actions [1, 3, 4, 5, 6, 7, 8]
  @beyond <<4, 0::144, @last>>

  defstruct list: [], stored: [], home: nil, desired: nil

  @typedoc "`home`, `desired`: latitude and longitude as eight bytes, which are set only where iNav takes them"
  @type t :: %__MODULE__{list: [binary], stored: [binary], home: binary | nil, desired: binary | nil}

  @doc "WP_GETINFO."
  @spec info(t) :: binary
  def info(%{list: list} = mission), do: <<0, @room, valid(mission), length(list)>>

  defp valid(%{list: []}), do: 0
  defp valid(%{list: list}), do: if(:binary.last(List.last(list)) == @last, do: 1, else: 0)

  @doc "WP: the waypoint of a number, or what iNav says of one that is not there."
  @spec get(t, byte) :: binary
  def get(%{list: list}, number) when number in 1..@room,
    do: Enum.at(list, number - 1) || <<number>> <> @beyond

  def get(%{home: place}, 0) when place != nil, do: <<0, 1, place::binary, 0::88>>
  def get(%{desired: place}, 254) when place != nil, do: <<254, 1, place::binary, 0::88>>
  def get(_mission, number), do: <<number>> <> @beyond

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
