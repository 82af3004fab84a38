defmodule SimVehicle.Firmware.Ardupilot.Modes do
  @moduledoc """
  ArduCopter's flight modes: numbers, when they can be entered, and what the vehicle then does.
  """

  import MavCodec.Command
  import MavCodec.MessageId
  import Bitwise

  alias MavCodec.Enums.MavResult
  alias SimVehicle.{Flight, Plans, Vehicle}
  alias SimVehicle.Services.Telemetry
  alias SimVehicle.Flight.{Goal, Mission}

  @modes %{
    0 => "STABILIZE",
    1 => "ACRO",
    2 => "ALT_HOLD",
    3 => "AUTO",
    4 => "GUIDED",
    5 => "LOITER",
    6 => "RTL",
    7 => "CIRCLE",
    9 => "LAND",
    11 => "DRIFT",
    13 => "SPORT",
    16 => "POSHOLD",
    17 => "BRAKE",
    20 => "GUIDED_NOGPS",
    21 => "SMART_RTL"
  }
  @numbers Map.new(@modes, fn {number, name} -> {name, number} end)

  @position ["AUTO", "GUIDED", "LOITER", "RTL", "CIRCLE", "DRIFT", "POSHOLD", "BRAKE", "SMART_RTL"]
  @manual ["STABILIZE", "ACRO"]
  @not_armable ["AUTO", "RTL", "LAND", "CIRCLE", "BRAKE", "SMART_RTL"]

  @custom_mode_enabled 1
  @denied MavResult.value(:MAV_RESULT_DENIED)
  @failed MavResult.value(:MAV_RESULT_FAILED)
  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)

  # With the throttle stick down, as the simulated receiver has it.
  @manual_sink 3.0

  @doc "Number of a mode as HEARTBEAT carries it."
  @spec number(String.t()) :: non_neg_integer
  def number(name), do: Map.fetch!(@numbers, name)

  # Name of a mode number, nil for an unknown one.
  defp name(number), do: Map.get(@modes, number)

  @doc "True for a mode that flies by position."
  @spec position?(String.t()) :: boolean
  def position?(name), do: name in @position or name == "LAND"

  @doc "True for a mode that needs a position: to be entered in flight, and to arm in it."
  @spec requires_position?(String.t()) :: boolean
  def requires_position?(name), do: name in @position

  @doc "True when the motors can be armed in this mode."
  @spec armable?(String.t()) :: boolean
  def armable?(name), do: name not in @not_armable

  @doc "A ground station requests a mode, by SET_MODE or DO_SET_MODE. Returns `{MAV_RESULT, vehicle}`."
  @spec request(Vehicle.t(), integer, integer) :: {non_neg_integer, Vehicle.t()}
  def request(v, base_mode, _custom) when (base_mode &&& @custom_mode_enabled) == 0, do: {@denied, v}

  def request(v, _base_mode, custom) do
    case name(custom) do
      nil -> {@failed, Vehicle.text(v, 4, "No such mode #{custom}")}
      name -> change(v, name)
    end
  end

  @doc "Changes the mode if it can be entered. Returns `{MAV_RESULT, vehicle}`."
  @spec change(Vehicle.t(), String.t()) :: {non_neg_integer, Vehicle.t()}
  def change(%{mode: name} = v, name), do: {@accepted, v}

  def change(v, name) do
    case obstacle(v, name) do
      nil -> {@accepted, enter(v, name)}
      {reason, v} -> {@failed, Vehicle.text(v, 4, "Mode change to #{name} failed: #{reason}")}
    end
  end

  @doc "Changes the mode without checks, as failsafes do, and sends a heartbeat at once."
  @spec enter(Vehicle.t(), String.t()) :: Vehicle.t()
  def enter(v, name) do
    v = start(%{v | mode: name, landed: if(v.airborne, do: :in_air, else: :on_ground)}, name)
    # In the next step, so that it follows the acknowledgement of the command.
    v |> Vehicle.notify({:mode, name}) |> Vehicle.later(0, Telemetry.message(v, id(Heartbeat)))
  end

  # While disarmed every mode can be entered; the checks come with arming.
  defp obstacle(%{armed: false}, _name), do: nil

  defp obstacle(v, name) do
    cond do
      requires_position?(name) and not Vehicle.positioned?(v) ->
        {"requires position", v}

      name != "AUTO" ->
        nil

      not Mission.any?(v) ->
        {"init failed", v}

      not v.airborne and not takeoff_first?(v) ->
        {"init failed", Vehicle.text(v, 2, "Auto: Missing Takeoff Cmd")}

      true ->
        nil
    end
  end

  defp takeoff_first?(v), do: match?([_home, %{command: cmd(:NAV_TAKEOFF)} | _rest], Plans.items(v.plans, 0))

  defp start(%{armed: false} = v, _name), do: Flight.hold(v)
  defp start(%{airborne: false} = v, "AUTO"), do: Flight.go(v, :idle)
  defp start(v, "AUTO"), do: Flight.mission(v)
  defp start(%{airborne: false} = v, _name), do: Flight.go(v, :idle)
  defp start(v, "LAND"), do: land(v)
  defp start(v, rtl) when rtl in ["RTL", "SMART_RTL"], do: Flight.go(v, rtl(v))

  defp start(v, "CIRCLE") do
    n = v.kin.n + v.limits.orbit * :math.cos(v.kin.yaw)
    e = v.kin.e + v.limits.orbit * :math.sin(v.kin.yaw)
    Flight.go(v, Goal.orbit(n, e, v.kin.d, v.limits.orbit, 3.0))
  end

  defp start(v, manual) when manual in @manual, do: Flight.go(v, Goal.sink(@manual_sink))
  defp start(v, _name), do: Flight.hold(v)

  defp land(v) do
    goal = if Vehicle.positioned?(v), do: Goal.land(v.kin.n, v.kin.e), else: Goal.sink(v.limits.land_slow)
    %{Flight.go(v, goal) | landed: :landing}
  end

  @doc "The way home: climb, return, wait, land."
  @spec rtl(Vehicle.t()) :: Goal.t()
  def rtl(v) do
    home = v.home || v.origin
    {n, e} = SimVehicle.Physics.Geo.to_local(v.origin, home.lat, home.lon)
    d = min(v.kin.d, v.origin.alt - home.alt - v.limits.rtl_alt)

    Goal.steps([
      {:climb, Goal.goto(v.kin.n, v.kin.e, d)},
      {:return, Goal.goto(n, e, d)},
      {:wait, Goal.wait(n, e, d, round(v.limits.rtl_wait * 1.0e6))},
      {:land, Goal.land(n, e)}
    ])
  end
end
