defmodule SimVehicle.Firmware.Px4.Modes do
  @moduledoc """
  PX4's flight modes: main and sub mode, names, and what each needs.
  """

  import Bitwise

  alias MavCodec.Enums.MavResult
  alias MavCodec.Messages, as: M
  alias SimVehicle.{Flight, Params, Vehicle}
  alias SimVehicle.Physics.Geo
  alias SimVehicle.Flight.{Goal, Mission}
  alias SimVehicle.Firmware.Px4.{Events, Internal}

  # name => {main, sub, navigation state, standard mode, words}
  @modes %{
    "MANUAL" => {1, 0, 0, 0, "Manual"},
    "ALTCTL" => {2, 0, 1, 4, "Altitude"},
    "POSCTL" => {3, 0, 2, 1, "Position"},
    "AUTO_MISSION" => {4, 4, 3, 6, "Mission"},
    "AUTO_LOITER" => {4, 3, 4, 0, "Hold"},
    "AUTO_RTL" => {4, 5, 5, 5, "Return"},
    "ACRO" => {5, 0, 10, 0, "Acro"},
    "OFFBOARD" => {6, 0, 14, 0, "Offboard"},
    "STABILIZED" => {7, 0, 15, 0, "Stabilized"},
    "AUTO_TAKEOFF" => {4, 2, 17, 8, "Takeoff"},
    "AUTO_LAND" => {4, 6, 18, 7, "Land"},
    "ORBIT" => {3, 1, 21, 2, "Orbit"}
  }
  @by_number Map.new(@modes, fn {name, {main, sub, _nav, _standard, _words}} -> {{main, sub}, name} end)
  @main_modes @modes |> Map.values() |> Enum.map(&elem(&1, 0)) |> Enum.uniq()

  # There is no RC in the simulator, so modes that need a pilot cannot be flown.
  @manual ["MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED"]

  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @temporarily_rejected MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)

  @doc "custom_mode of HEARTBEAT."
  @spec number(String.t()) :: non_neg_integer
  def number(name) do
    {main, sub, _nav, _standard, _words} = Map.fetch!(@modes, name)
    sub <<< 24 ||| main <<< 16
  end

  @doc "True when PX4 has this main mode at all."
  @spec main?(integer) :: boolean
  def main?(main), do: main in @main_modes

  # Name of a main and sub mode, nil when there is none; the sub mode counts for AUTO and position only.
  defp name(main, sub) when main in [3, 4], do: Map.get(@by_number, {main, sub})
  defp name(main, _sub), do: Map.get(@by_number, {main, 0})

  @doc "Bits of base_mode without the armed one."
  @spec base_mode(String.t()) :: non_neg_integer
  def base_mode("AUTO" <> _rest), do: 29
  def base_mode("MANUAL"), do: 81
  def base_mode("ACRO"), do: 65
  def base_mode(_name), do: 17

  @doc "A ground station requests a mode. Returns `{the true MAV_RESULT, vehicle}`."
  @spec request(Vehicle.t(), integer, integer) :: {non_neg_integer, Vehicle.t()}
  def request(v, main, sub) do
    case name(main, sub) do
      nil -> {@temporarily_rejected, Events.emit(v, :mode_unsupported, [], {2, "Unsupported auto mode"})}
      "ORBIT" -> {@temporarily_rejected, v}
      name -> change(v, name)
    end
  end

  @doc "Changes the mode if it can be flown, or in any case while disarmed: arming is what checks."
  @spec change(Vehicle.t(), String.t()) :: {non_neg_integer, Vehicle.t()}
  def change(v, name) do
    cond do
      not v.armed or available?(v, name) -> {@accepted, enter(v, name)}
      name == "AUTO_MISSION" -> {@temporarily_rejected, v}
      true -> {@temporarily_rejected, unavailable(v, name)}
    end
  end

  @doc "True when the vehicle could fly in this mode now."
  @spec available?(Vehicle.t(), String.t()) :: boolean
  def available?(_v, name) when name in @manual, do: false
  def available?(v, "OFFBOARD"), do: Vehicle.positioned?(v) and setpoints?(v)
  def available?(v, "AUTO_MISSION"), do: Vehicle.positioned?(v) and mission?(v)
  def available?(v, _name), do: Vehicle.positioned?(v)

  @doc "True when there is a mission that passed the feasibility check."
  @spec mission?(Vehicle.t()) :: boolean
  def mission?(v), do: Mission.any?(v) and Vehicle.own(v, :mission_feasible, true)

  # True while setpoints come often enough for OFFBOARD (rule X7).
  defp setpoints?(v) do
    case Vehicle.own(v, :setpoints) do
      %{first: first, last: last} = stream -> steady?(v, stream) and last - first >= 800_000
      nil -> false
    end
  end

  @doc "True when the last set-point of a stream is recent: half of COM_OF_LOSS_T, at its default two in a second (X7)."
  @spec steady?(Vehicle.t(), %{first: integer, last: integer}) :: boolean
  def steady?(v, %{last: last}), do: v.now - last < Params.get(v.params, "COM_OF_LOSS_T") * 500_000

  @doc "Changes the mode without checks."
  @spec enter(Vehicle.t(), String.t()) :: Vehicle.t()
  def enter(%{mode: name} = v, name), do: start(v, name)

  def enter(v, name) do
    %{v | mode: name, landed: if(v.airborne, do: :in_air, else: :on_ground)}
    |> Vehicle.notify({:mode, name})
    |> task(name)
    |> Internal.gimbal(name)
    |> start(name)
  end

  defp task(v, name) when name in ["AUTO_TAKEOFF", "AUTO_LAND"], do: Vehicle.put_own(v, :task, :running)
  defp task(v, "AUTO_MISSION"), do: Vehicle.put_own(v, :task, nil)
  defp task(v, _name), do: v

  defp start(%{armed: false} = v, _name), do: Flight.hold(v)
  defp start(v, "AUTO_TAKEOFF"), do: takeoff(v)

  defp start(v, "AUTO_MISSION"),
    do: v |> Events.emit(:mission_executing, [], {6, "Executing Mission"}) |> Flight.mission()

  defp start(%{airborne: false} = v, _name), do: Flight.go(v, :idle)
  defp start(v, "AUTO_LAND"), do: %{land(v) | landed: :landing}
  defp start(v, "AUTO_RTL"), do: rtl(v)
  defp start(v, "ORBIT"), do: v
  defp start(v, _hold), do: Flight.hold(v)

  @doc "Takes off to the height that the last NAV_TAKEOFF asked for, but never lower than MIS_TAKEOFF_ALT above home."
  @spec takeoff(Vehicle.t()) :: Vehicle.t()
  def takeoff(v) do
    clearance = Params.get(v.params, "MIS_TAKEOFF_ALT")
    lowest = (v.home || v.origin).alt + clearance
    asked = Vehicle.own(v, :takeoff_alt) || lowest
    alt = max(asked, lowest)
    v = if asked < lowest, do: minimum(v, clearance), else: v
    from = if v.airborne, do: v.now, else: max(v.now + 900_000, v.armed_at + round(v.limits.spool * 1.0e6))
    Flight.go(v, Goal.takeoff(v.kin, v.origin.alt - alt, from))
  end

  defp minimum(v, clearance) do
    metres = :erlang.float_to_binary(clearance * 1.0, decimals: 2)
    Vehicle.text(v, 2, "Using minimum takeoff altitude: #{metres} m\t")
  end

  defp land(v) do
    if Vehicle.positioned?(v),
      do: Flight.go(v, Goal.land(v.kin.n, v.kin.e)),
      else: Flight.go(v, Goal.sink(v.limits.land_slow))
  end

  defp rtl(v) do
    home = v.home || v.origin
    {n, e} = Geo.to_local(v.origin, home.lat, home.lon)
    d = min(v.kin.d, v.origin.alt - home.alt - v.limits.rtl_alt)
    above = round(v.origin.alt - d - home.alt)
    amsl = round(v.origin.alt - d)
    text = "RTL: start return at #{amsl} m (#{above} m above destination)"

    v
    |> Events.emit(:returning, [], {6, "Returning to launch"})
    |> Events.emit(:return_altitude, [amsl, min(above, 255)], {6, text})
    |> Flight.go(
      Goal.steps([
        {:climb, Goal.goto(v.kin.n, v.kin.e, d)},
        {:return, Goal.goto(n, e, d)},
        {:land, Goal.land(n, e)}
      ])
    )
  end

  defp unavailable(v, name) do
    {_main, _sub, nav, _standard, words} = Map.fetch!(@modes, name)

    Events.emit(
      v,
      :mode_unavailable,
      [number(name), nav],
      {2, "Switching to #{words} is currently not available"}
    )
  end

  @doc "CURRENT_MODE."
  @spec current(Vehicle.t()) :: struct
  def current(v) do
    {_main, _sub, _nav, standard, _words} = Map.fetch!(@modes, v.mode)
    number = number(v.mode)
    %M.CurrentMode{standard_mode: standard, custom_mode: number, intended_custom_mode: number}
  end

  @doc "AVAILABLE_MODES, all of them or one by its index from 1."
  @spec available(integer) :: [struct]
  def available(index) do
    all =
      for {{_name, {main, sub, nav, standard, words}}, place} <- Enum.with_index(ordered(), 1), nav >= 0 do
        %M.AvailableModes{
          number_modes: map_size(@modes),
          mode_index: place,
          standard_mode: standard,
          custom_mode: sub <<< 24 ||| main <<< 16,
          # A standard mode needs no name.
          mode_name: if(standard == 0, do: words, else: "")
        }
      end

    if index == 0, do: all, else: Enum.filter(all, &(&1.mode_index == index))
  end

  defp ordered, do: Enum.sort_by(@modes, fn {_name, mode} -> elem(mode, 2) end)
end
