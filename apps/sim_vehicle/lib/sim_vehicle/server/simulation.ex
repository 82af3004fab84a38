defmodule SimVehicle.Server.Simulation do
  @moduledoc """
  Runs a `SimVehicle.Vehicle`: `boot/2` powers it up, `step/2` advances its time, `handle/2` gives it an event. All return the
  vehicle and its actions (`t:SimVehicle.Vehicle.action/0`), in order. Pure.
  """

  alias MavCodec.Messages, as: M

  alias SimVehicle.{Flight, Ftp, Params, Plans, Vehicle}
  alias SimVehicle.Physics.{Battery, Wind}
  alias SimVehicle.Services.{Command, Streams, Telemetry}
  alias SimVehicle.Vehicle.{Camera, Logs}

  # A coarser step would let the position controller overshoot.
  @step_max_us 50_000

  @doc """
  Powers the vehicle up at UNIX time `epoch` (microseconds). Parameters, plans, position and charge survive a reboot;
  everything else starts again.
  """
  @spec boot(Vehicle.t(), integer) :: {Vehicle.t(), [Vehicle.action()]}
  def boot(vehicle, epoch) do
    %{
      vehicle
      | now: 0,
        epoch: epoch,
        boots: vehicle.boots + 1,
        home: nil,
        streams: Streams.new(vehicle.rates),
        armed: false,
        armed_at: nil,
        flight: :off,
        airborne: vehicle.kin.d < -0.5,
        landed: :on_ground,
        mission: Flight.Mission.new(),
        plans: %{vehicle.plans | upload: nil},
        ftp: Ftp.reboot(vehicle.ftp),
        logs: Logs.reboot(vehicle.logs),
        camera: vehicle.camera && Camera.reboot(vehicle.camera),
        failsafes: MapSet.new(),
        gcs_heard: nil,
        text_id: 0,
        later: [],
        own: %{}
    }
    |> vehicle.personality.boot()
    |> flush()
  end

  @doc "Lets `dt` seconds of vehicle time pass."
  @spec step(Vehicle.t(), number) :: {Vehicle.t(), [Vehicle.action()]}
  def step(vehicle, dt), do: vehicle |> advance(round(dt * 1.0e6)) |> flush()

  @doc """
  Something happened:

  - `{:message, struct, {system, component}}`: a decoded message from that source
  - `{:command, SimVehicle.Services.Command.t()}`: a command that did not come over the link
  - `{:failsafe, kind, on?}`: `:battery`, `:battery_critical`, `:gcs`, `:rc`, `:fence`, `:ekf`, `:gps` begins or ends
  - `{:set_param, name, value}`: as if it had been set before boot
  - `:swap_battery`: a full pack (only on the ground, disarmed)
  - `:reboot`: power is lost and comes back
  - `{:clock_jump, seconds}`: the vehicle's UTC clock jumps
  """
  @spec handle(Vehicle.t(), term) :: {Vehicle.t(), [Vehicle.action()]}
  def handle(vehicle, event), do: vehicle |> on(event) |> flush()

  # --- time ---

  defp advance(vehicle, us) when us <= 0, do: vehicle

  defp advance(vehicle, us) when us > @step_max_us,
    do: vehicle |> tick(@step_max_us) |> advance(us - @step_max_us)

  defp advance(vehicle, us), do: tick(vehicle, us)

  defp tick(vehicle, us) do
    dt = us / 1.0e6
    wind = if vehicle.airborne, do: Wind.step(vehicle.wind, dt), else: vehicle.wind

    %{vehicle | now: vehicle.now + us, wind: wind}
    |> send_later()
    |> vehicle.personality.tick()
    |> Flight.step(dt)
    |> drain(dt)
    |> tick_plans()
    |> tick_logs()
    |> tick_camera()
    |> stream()
  end

  defp drain(vehicle, dt) do
    %{vehicle | battery: Battery.step(vehicle.battery, vehicle.armed, vehicle.kin.throttle, dt)}
  end

  defp send_later(%{later: []} = vehicle), do: vehicle

  defp send_later(vehicle) do
    {due, later} = Enum.split_with(vehicle.later, fn {at, _message} -> at <= vehicle.now end)
    # The list is newest first; it is reversed, so that the stable sort by time keeps the order.
    due = due |> Enum.reverse() |> Enum.sort_by(&elem(&1, 0))
    Enum.reduce(due, %{vehicle | later: later}, fn {_at, message}, v -> Vehicle.emit(v, message) end)
  end

  defp tick_plans(vehicle) do
    {plans, replies} = Plans.tick(vehicle.plans, vehicle.now)
    send_replies(%{vehicle | plans: plans}, replies)
  end

  defp tick_logs(vehicle) do
    {logs, pieces} = Logs.tick(vehicle.logs)
    send_replies(%{vehicle | logs: logs}, pieces)
  end

  defp tick_camera(%{camera: nil} = vehicle), do: vehicle

  defp tick_camera(vehicle) do
    {camera, messages} = Camera.tick(vehicle.camera, vehicle.now)

    for message <- messages, reduce: %{vehicle | camera: camera} do
      v -> Vehicle.emit(v, {camera.component, message})
    end
  end

  defp stream(vehicle) do
    {ids, streams} = Streams.due(vehicle.streams, vehicle.now)

    Enum.reduce(ids, %{vehicle | streams: streams}, fn id, v ->
      case Telemetry.message(v, id) do
        nil -> v
        message -> Vehicle.emit(v, message)
      end
    end)
  end

  # --- events ---

  defp on(vehicle, {:message, message, source}) do
    case Command.from(message, source) do
      nil -> vehicle |> note_station(message, source) |> on_message(message, source)
      command -> on_command(vehicle, command)
    end
  end

  defp on(vehicle, {:command, command}), do: vehicle.personality.command(vehicle, command)
  defp on(vehicle, {:failsafe, kind, on?}), do: vehicle.personality.failsafe(vehicle, kind, on?)
  defp on(vehicle, {:set_param, name, value}), do: set_param(vehicle, name, value)
  defp on(vehicle, {:clock_jump, seconds}), do: %{vehicle | epoch: vehicle.epoch + round(seconds * 1.0e6)}
  defp on(vehicle, :reboot), do: Vehicle.reboot(vehicle)

  defp on(%{armed: false, airborne: false} = vehicle, :swap_battery),
    do:
      Enum.reduce([:battery, :battery_critical], full(vehicle), &vehicle.personality.failsafe(&2, &1, false))

  defp on(vehicle, :swap_battery), do: vehicle

  defp full(vehicle), do: %{vehicle | battery: Battery.new(vehicle.battery_opts)}

  defp on_command(vehicle, command) do
    if vehicle.personality.addressed?(vehicle, command.target),
      do: vehicle.personality.command(vehicle, command),
      else: vehicle
  end

  defp note_station(vehicle, %M.Heartbeat{type: 6}, {system, _component}) do
    vehicle = %{vehicle | gcs_heard: vehicle.now}
    vehicle.personality.gcs_heard(vehicle, system)
  end

  defp note_station(vehicle, _message, _source), do: vehicle

  # ArduPilot also hears what is for the camera.
  defp on_message(%{camera: %{component: id}, system: system} = vehicle, message, source) do
    v =
      if match?({s, c} when s in [0, system] and c in [0, id], target(message)),
        do: to_camera(vehicle, message),
        else: vehicle

    to_autopilot(v, message, source)
  end

  defp on_message(vehicle, message, source), do: to_autopilot(vehicle, message, source)

  defp to_camera(vehicle, message) do
    {camera, answers} = Camera.handle(vehicle.camera, message, vehicle.now)

    for {after_us, answer} <- answers, reduce: %{vehicle | camera: camera} do
      v -> Vehicle.later(v, after_us, {camera.component, answer})
    end
  end

  defp to_autopilot(vehicle, message, source) do
    if vehicle.personality.addressed?(vehicle, target(message)) do
      case Plans.handle(vehicle.plans, message, source, Telemetry.home_item(vehicle), vehicle.now) do
        nil -> other(vehicle, message, source)
        {plans, replies} -> send_replies(%{vehicle | plans: plans}, replies)
      end
    else
      vehicle
    end
  end

  defp other(vehicle, %M.FileTransferProtocol{payload: payload}, {system, component} = source) do
    {ftp, answers} = Ftp.handle(vehicle.ftp, payload, source, vehicle.params)

    Enum.reduce(answers, %{vehicle | ftp: ftp}, fn {after_us, payload}, v ->
      answer = %M.FileTransferProtocol{target_system: system, target_component: component, payload: payload}
      if after_us == 0, do: Vehicle.emit(v, answer), else: Vehicle.later(v, after_us, answer)
    end)
  end

  # ArduPilot does not speak of its logs while it is armed (AP_Logger::should_handle_log_message).
  defp other(%{armed: true, plans: %{style: :ardupilot}} = vehicle, %module{}, _source)
       when module in [M.LogRequestList, M.LogRequestData, M.LogRequestEnd],
       do: vehicle

  defp other(vehicle, message, source) do
    case Logs.handle(vehicle.logs, message) do
      nil -> vehicle.personality.message(vehicle, message, source)
      {logs, replies} -> send_replies(%{vehicle | logs: logs}, replies)
    end
  end

  defp send_replies(vehicle, replies) do
    Enum.reduce(replies, vehicle, fn
      {:text, severity, text}, v -> Vehicle.text(v, severity, text)
      {kind, type}, v when kind in [:stored, :cleared] -> v.personality.plan_changed(v, kind, type)
      message, v -> Vehicle.emit(v, message)
    end)
  end

  # Messages without a target are for everyone.
  defp target(%{target_system: system, target_component: component}), do: {system, component}
  defp target(%{target_system: system}), do: {system, 0}
  defp target(_message), do: {0, 0}

  defp set_param(vehicle, name, value) do
    case Params.put(vehicle.params, name, value) do
      {:ok, params} -> %{vehicle | params: params, limits: vehicle.personality.limits(params)}
      {:error, :unknown} -> vehicle
    end
  end

  defp flush(vehicle), do: {%{vehicle | out: []}, Enum.reverse(vehicle.out)}
end
