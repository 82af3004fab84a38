defmodule Aerie.Vehicle.Firmware.Px4.Modes do
  @moduledoc """
  PX4's modes: `custom_mode = sub mode << 24 | main mode << 16`.

  An orbit flies as position control with sub mode 1, so it has a name of its own here.
  """

  @behaviour Aerie.Vehicle.Firmware.Modes

  import Bitwise

  alias Aerie.Vehicle.Firmware.Modes

  # MAV_MODE_FLAG
  @custom 0x01
  @auto 0x04
  @guided 0x08
  @stabilize 0x10
  @manual 0x40

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

  # All kinds have the same.
  @impl true
  def kinds, do: ["any"]

  @impl true
  def name(kind, base, 0) when band(base, @custom) == 0, do: Modes.Flags.name(kind, base, 0)
  def name(_kind, _base, custom), do: known(custom) || Modes.numbered(custom)

  @impl true
  def number(_kind, name), do: Map.fetch(@numbers, Map.get(@aliases, name, name))

  @impl true
  def asked(_kind, base, custom) when band(base, @custom) != 0 do
    case {known(custom), effect(custom)} do
      {nil, [_ | _] = effect} -> effect
      {name, effect} -> [name || Modes.numbered(custom) | effect]
    end
  end

  # Without the flag it goes by the others, and the number does not count.
  def asked(_kind, base, 0), do: [flags(base)]
  def asked(_kind, base, custom), do: [flags(base), known(custom) || Modes.numbered(custom)]

  defp known(mode) when band(mode, 0xFFFF) == 0,
    do: Map.get(@names, {mode >>> 16 &&& 0xFF, mode >>> 24 &&& 0xFF})

  defp known(_mode), do: nil

  # It takes no notice of most sub modes, and AUTO without one is the mission.
  defp effect(mode) do
    case {mode >>> 16 &&& 0xFF, mode >>> 24 &&& 0xFF} do
      {3, 2} -> []
      {3, _sub} -> ["POSCTL"]
      {4, 0} -> ["AUTO_MISSION"]
      {4, _sub} -> []
      {main, _sub} -> List.wrap(Map.get(@names, {main, 0}))
    end
  end

  defp flags(base) do
    cond do
      band(base, @auto) != 0 -> "AUTO_MISSION"
      band(base, @manual) == 0 -> "PREFLIGHT"
      band(base, @guided) != 0 -> "POSCTL"
      band(base, @stabilize) != 0 -> "STABILIZED"
      true -> "MANUAL"
    end
  end

  # It takes no notice of the lower half of the number.
  @impl true
  def wrong(mode) do
    if mode not in 0..0xFFFFFFFF or band(mode, 0xFFFF) != 0,
      do: "the mode #{mode} is not a main mode and a sub mode of PX4"
  end

  @impl true
  def all(_kind), do: @names |> Enum.sort() |> Enum.map(&elem(&1, 1))

  @impl true
  def standard(_kind), do: @standard

  # It tells by itself which mode it would have to be in.
  @impl true
  def arm_first(_kind, _mode), do: nil
end
