defmodule SimVehicle.Firmware.Ardupilot.Events do
  @moduledoc """
  ArduCopter's texts and actions on events in flight.
  """

  import MavCodec.Command

  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle
  alias SimVehicle.Firmware.Ardupilot.Arming

  @names %{
    cmd(:NAV_WAYPOINT) => "WP",
    cmd(:NAV_LOITER_UNLIM) => "LoitUnlim",
    cmd(:NAV_LOITER_TURNS) => "LoitTurns",
    cmd(:NAV_LOITER_TIME) => "LoitTime",
    cmd(:NAV_RETURN_TO_LAUNCH) => "RTL",
    cmd(:NAV_LAND) => "Land",
    cmd(:NAV_TAKEOFF) => "Takeoff",
    cmd(:NAV_SPLINE_WAYPOINT) => "SplineWP",
    cmd(:NAV_DELAY) => "Delay",
    cmd(:CONDITION_DELAY) => "CondDelay",
    cmd(:CONDITION_YAW) => "CondYaw",
    cmd(:DO_JUMP) => "DoJump",
    cmd(:DO_CHANGE_SPEED) => "DoSpeed",
    cmd(:DO_SET_HOME) => "DoSetHome",
    cmd(:DO_SET_ROI) => "DoROI"
  }

  @doc "See `SimVehicle.Flight`."
  @spec flight_event(Vehicle.t(), term) :: Vehicle.t()
  def flight_event(v, :airborne), do: %{v | landed: if(takeoff?(v), do: :taking_off, else: :in_air)}
  def flight_event(v, :takeoff_done), do: %{v | landed: :in_air}
  def flight_event(v, {:phase, :land}), do: %{v | landed: :landing}
  def flight_event(v, {:touchdown, speed}), do: Vehicle.text(v, 6, "SIM Hit ground at #{speed * 1.0} m/s")

  def flight_event(v, {:item, item}) do
    v = %{v | landed: if(v.airborne, do: :in_air, else: v.landed)}
    Vehicle.text(v, 6, "Mission: #{item.seq} #{Map.get(@names, item.command, "Cmd#{item.command}")}")
  end

  def flight_event(v, {:reached, :action, _seq}), do: v

  def flight_event(v, {:reached, :place, seq}) do
    v = %{v | landed: :in_air} |> Vehicle.emit(%M.MissionItemReached{seq: seq})
    # There is no "reached" text for a take-off.
    if item(v, seq) == 22, do: v, else: Vehicle.text(v, 6, "Reached command ##{seq}")
  end

  def flight_event(v, :landed) do
    v = %{v | landed: :on_ground}
    if v.armed and v.mode in ["LAND", "RTL", "SMART_RTL", "AUTO"], do: Arming.stop(v), else: v
  end

  def flight_event(v, _event), do: v

  defp item(v, seq) do
    case Enum.at(SimVehicle.Plans.items(v.plans, 0), seq) do
      nil -> nil
      item -> item.command
    end
  end

  defp takeoff?(%{flight: %{do: :takeoff}}), do: true
  defp takeoff?(%{flight: :mission, mission: %{goal: %{do: :takeoff}}}), do: true
  defp takeoff?(_v), do: false
end
