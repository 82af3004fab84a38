defmodule Aerie.Vehicle.Firmware.Px4.Modes do
  @moduledoc """
  PX4's modes: `custom_mode = sub mode << 24 | main mode << 16`.

  An orbit flies as position control with sub mode 1, so it has a name of its own here.
  """

  import Bitwise

  @modes [
    {{1, 0}, "MANUAL"},
    {{2, 0}, "ALTCTL"},
    {{3, 0}, "POSCTL"},
    {{3, 1}, "POSCTL_ORBIT"},
    {{3, 2}, "POSCTL_SLOW"},
    {{4, 1}, "AUTO_READY"},
    {{4, 2}, "AUTO_TAKEOFF"},
    {{4, 3}, "AUTO_LOITER"},
    {{4, 4}, "AUTO_MISSION"},
    {{4, 5}, "AUTO_RTL"},
    {{4, 6}, "AUTO_LAND"},
    {{4, 8}, "AUTO_FOLLOW_TARGET"},
    {{4, 9}, "AUTO_PRECLAND"},
    {{4, 10}, "AUTO_VTOL_TAKEOFF"},
    {{4, 19}, "GUIDED_COURSE"},
    {{4, 20}, "AUTO_DESCEND"},
    {{5, 0}, "ACRO"},
    {{6, 0}, "OFFBOARD"},
    {{7, 0}, "STABILIZED"},
    {{8, 0}, "RATTITUDE"},
    {{10, 0}, "TERMINATION"},
    {{11, 0}, "ALTITUDE_CRUISE"}
  ]
  @external for n <- 1..8, do: {{4, 10 + n}, "EXTERNAL#{n}"}
  @names Map.new(@modes ++ @external)

  # Names that people and other programs use.
  @aliases %{
    "HOLD" => "AUTO_LOITER",
    "LOITER" => "AUTO_LOITER",
    "MISSION" => "AUTO_MISSION",
    "RTL" => "AUTO_RTL",
    "LAND" => "AUTO_LAND",
    "TAKEOFF" => "AUTO_TAKEOFF",
    "FOLLOWME" => "AUTO_FOLLOW_TARGET",
    "ORBIT" => "POSCTL_ORBIT",
    "ALTITUDE" => "ALTCTL",
    "POSITION" => "POSCTL"
  }
  @numbers for {{main, sub}, name} <- @names, into: %{}, do: {name, main <<< 16 ||| sub <<< 24}

  @standard %{
    "position_hold" => "POSCTL",
    "orbit" => "POSCTL_ORBIT",
    "cruise" => "POSCTL",
    "altitude_hold" => "ALTCTL",
    "safe_recovery" => "AUTO_RTL",
    "mission" => "AUTO_MISSION",
    "land" => "AUTO_LAND",
    "takeoff" => "AUTO_TAKEOFF"
  }

  @doc "The modes for MAVLink's standard modes, by their names."
  @spec standard() :: %{String.t() => String.t()}
  def standard, do: @standard

  @doc "The name of a custom mode, or nil."
  @spec name(non_neg_integer()) :: String.t() | nil
  def name(mode) when band(mode, 0xFFFF) == 0,
    do: Map.get(@names, {mode >>> 16 &&& 0xFF, mode >>> 24 &&& 0xFF})

  def name(_mode), do: nil

  @doc "The modes that PX4 makes of a custom mode: it takes no notice of most sub modes, and AUTO without one is the mission."
  @spec effect(non_neg_integer()) :: [String.t()]
  def effect(mode) do
    case {mode >>> 16 &&& 0xFF, mode >>> 24 &&& 0xFF} do
      {3, 2} -> []
      {3, _sub} -> ["POSCTL"]
      {4, 0} -> ["AUTO_MISSION"]
      {4, _sub} -> []
      {main, _sub} -> List.wrap(Map.get(@names, {main, 0}))
    end
  end

  @doc "The custom mode of a name in capitals; the common short names are known too."
  @spec number(String.t()) :: {:ok, non_neg_integer()} | :error
  def number(name), do: Map.fetch(@numbers, Map.get(@aliases, name, name))

  @doc "All names in the order of main and sub modes."
  @spec all() :: [String.t()]
  def all, do: @names |> Enum.sort() |> Enum.map(&elem(&1, 1))
end
