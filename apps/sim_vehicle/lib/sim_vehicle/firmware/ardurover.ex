defmodule SimVehicle.Firmware.Ardurover do
  @moduledoc """
  ArduRover, as far as it differs from `SimVehicle.Firmware.Ardupilot` in what it does with targets: it takes one while it is disarmed, keeps it, and
  drives there as soon as it is armed (`GCS_MAVLINK_Rover::handle_command_int_do_reposition` and `ModeGuided::set_desired_location`, neither of
  which asks whether it is armed). It has no height.
  """

  @behaviour SimVehicle.Firmware.Personality

  import MavCodec.Command
  import MavCodec.MessageId

  alias MavCodec.Enums.MavResult
  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle
  alias SimVehicle.Firmware.Ardupilot
  alias SimVehicle.Physics.Geo
  alias SimVehicle.Services.Command
  alias SimVehicle.Firmware.Ardupilot.Sticks

  @modes %{0 => "MANUAL", 3 => "STEERING", 4 => "HOLD", 10 => "AUTO", 11 => "RTL", 15 => "GUIDED"}
  @numbers Map.new(@modes, fn {number, name} -> {name, number} end)
  @m_s 5.0
  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @denied MavResult.value(:MAV_RESULT_DENIED)
  @unsupported MavResult.value(:MAV_RESULT_UNSUPPORTED)
  @failed MavResult.value(:MAV_RESULT_FAILED)

  @impl true
  defdelegate params, to: Ardupilot
  @impl true
  defdelegate plan_style, to: Ardupilot
  @impl true
  defdelegate rates, to: Ardupilot
  @impl true
  defdelegate limits(params), to: Ardupilot
  @impl true
  def boot(v), do: %{Ardupilot.boot(v) | mode: "MANUAL"}
  @impl true
  def tick(v), do: v |> Ardupilot.tick() |> drive()
  @impl true
  defdelegate addressed?(v, target), to: Ardupilot
  @impl true
  defdelegate text(v, severity, text), to: Ardupilot
  @impl true
  defdelegate gcs_heard(v, system), to: Ardupilot
  @impl true
  defdelegate flight_event(v, event), to: Ardupilot
  @impl true
  defdelegate failsafe(v, kind, on?), to: Ardupilot
  @impl true
  defdelegate plan_changed(v, kind, type), to: Ardupilot
  @impl true
  defdelegate mission_rtl(v), to: Ardupilot

  @impl true
  def command(v, %{id: cmd(:DO_SET_MODE)} = c) do
    case @modes[trunc(Command.p(c, 2))] do
      nil -> Vehicle.ack(v, c, @failed)
      name -> v |> enter(name) |> Vehicle.ack(c, @accepted)
    end
  end

  def command(v, %{id: cmd(:DO_REPOSITION)} = c) do
    {lat, lon, _height} = Command.location(c)

    if lat == nil or lon == nil or (v.mode != "GUIDED" and trunc(Command.p(c, 2)) != 1),
      do: Vehicle.ack(v, c, @denied),
      else:
        v
        |> enter("GUIDED")
        |> Vehicle.put_own(:target, Geo.to_local(v.origin, lat, lon))
        |> Vehicle.ack(c, @accepted)
  end

  def command(v, %{id: id} = c) when id in cmds(~w(NAV_LAND NAV_TAKEOFF)a),
    do: Vehicle.ack(v, c, @unsupported)

  def command(v, c), do: Ardupilot.command(v, c)

  @impl true
  def message(%{mode: "GUIDED"} = v, %M.SetPositionTargetGlobalInt{} = m, _source) do
    if Bitwise.band(m.type_mask, 7) == 0,
      do: Vehicle.put_own(v, :target, Geo.to_local(v.origin, m.lat_int, m.lon_int)),
      else: v
  end

  def message(v, %module{} = m, {system, _component}) when module in [M.RcChannelsOverride, M.ManualControl],
    do: Sticks.take(v, m, system, {"MODE_CH", "MODE"}, &enter_number/2)

  def message(v, m, source), do: Ardupilot.message(v, m, source)

  @impl true
  def telemetry(v, id(Heartbeat)),
    do: %{
      Ardupilot.telemetry(%{v | mode: "GUIDED"}, id(Heartbeat))
      | type: 10,
        custom_mode: Map.fetch!(@numbers, v.mode)
    }

  def telemetry(v, id), do: Ardupilot.telemetry(v, id)

  defp enter_number(v, number), do: if(name = @modes[number], do: enter(v, name), else: v)

  defp enter(%{mode: name} = v, name), do: v
  # The target of an earlier time in the mode is gone.
  defp enter(v, name), do: %{v | mode: name} |> Vehicle.put_own(:target, nil) |> Vehicle.notify({:mode, name})

  defp drive(v) do
    seconds = (v.now - Vehicle.own(v, :driven_at, v.now)) / 1.0e6
    v = Vehicle.put_own(v, :driven_at, v.now)
    if v.armed and v.mode == "GUIDED", do: towards(v, Vehicle.own(v, :target), seconds * @m_s), else: v
  end

  defp towards(v, nil, _metres), do: v

  defp towards(%{kin: kin} = v, {n, e}, metres) do
    away = :math.sqrt((n - kin.n) ** 2 + (e - kin.e) ** 2)
    share = if away > metres, do: metres / away, else: 1.0
    %{v | kin: %{kin | n: kin.n + (n - kin.n) * share, e: kin.e + (e - kin.e) * share}}
  end
end
