defmodule SimVehicle.Vehicle do
  @moduledoc """
  One simulated autopilot as a value: no process, no clock, no socket.

  `step/2` lets time pass, `handle/2` takes what happens; both return the vehicle and a list of actions, in order:

  - `{:send, message}`: a `MavCodec.Messages` struct to send
  - `{:bytes, binary}`: bytes outside any frame (ArduPilot's boot text)
  - `{:notify, event}`: something that tests and the fleet may wait for (`t:event/0`)
  - `:reboot`: the vehicle restarts; the owner boots it again with `boot/2`

  What ArduPilot and PX4 do differently is in the modules behind `SimVehicle.Personality`. Internally every function
  takes and returns the vehicle and puts actions into `out`.
  """

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Battery, Command, Flight, Geo, Kinematics, Params, Plans, Streams, Telemetry, Wind}

  # A coarser step would let the position controller overshoot.
  @step_max_us 50_000
  @later_max 200

  defstruct personality: nil,
            system: 1,
            component: 1,
            origin: nil,
            home: nil,
            heading: 0.0,
            now: 0,
            epoch: 0,
            ready_us: 0,
            boots: 0,
            kin: nil,
            wind: nil,
            battery: nil,
            battery_opts: [],
            params: nil,
            plans: nil,
            streams: nil,
            rates: %{},
            limits: %{},
            mode: nil,
            armed: false,
            armed_at: nil,
            airborne: false,
            flight: :off,
            landed: :on_ground,
            mission: nil,
            failsafes: MapSet.new(),
            gcs_heard: nil,
            text_id: 0,
            later: [],
            out: [],
            own: %{}

  @typedoc """
  - `origin`: where the local frame has its zero (`t:SimVehicle.Geo.origin/0`); `home`: what HOME_POSITION tells, nil
    until it is known
  - `now`: microseconds since boot; `epoch`: UNIX time of boot in microseconds
  - `ready_us`: vehicle time at which position is good enough to arm in a position mode
  - `mode`: the mode's name ("GUIDED", "AUTO_LOITER")
  - `flight`: what the vehicle is doing (`SimVehicle.Flight`)
  - `own`: what only one personality knows
  """
  @type t :: %__MODULE__{}

  @type event ::
          :armed
          | :disarmed
          | :airborne
          | :landed
          | :arrived
          | :rebooting
          | {:mode, String.t()}
          | {:reached, non_neg_integer}
          | {:failsafe, atom, boolean}
          | {:text, 0..7, String.t()}
          | {:param, String.t(), number}

  @type action :: {:send, struct} | {:bytes, binary} | {:notify, event} | :reboot

  @doc """
  A vehicle that has not booted yet. Options (all needed, see `SimVehicle.Options`): `:personality`, `:system`,
  `:component`, `:home`, `:heading` (degrees), `:ready_s`, `:battery`, `:wind`, `:seed`, `:rates`, `:params`.
  """
  @spec new(map) :: t
  def new(opts) do
    personality = opts.personality
    params = Enum.reduce(opts.params, personality.params(), &put_param!/2)

    vehicle = %__MODULE__{
      personality: personality,
      system: opts.system,
      component: opts.component,
      origin: opts.home,
      heading: opts.heading * :math.pi() / 180,
      ready_us: round(opts.ready_s * 1.0e6),
      kin: %Kinematics{yaw: Geo.wrap_pi(opts.heading * :math.pi() / 180)},
      wind: Wind.new(opts.wind, opts.seed),
      battery: Battery.new(opts.battery),
      battery_opts: opts.battery,
      params: params,
      plans: Plans.new(personality.plan_style()),
      rates: Map.merge(personality.rates(), opts.rates)
    }

    %{vehicle | limits: personality.limits(params)}
  end

  @doc """
  Powers the vehicle up at UNIX time `epoch` (microseconds). Parameters, plans, position and charge survive a reboot;
  everything else starts anew.
  """
  @spec boot(t, integer) :: {t, [action]}
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
  @spec step(t, number) :: {t, [action]}
  def step(vehicle, dt), do: vehicle |> advance(round(dt * 1.0e6)) |> flush()

  @doc """
  Something happened:

  - `{:message, struct, {system, component}}`: a decoded message from that source
  - `{:command, SimVehicle.Command.t()}`: an order that did not come over the link
  - `{:failsafe, kind, on?}`: `:battery`, `:battery_critical`, `:gcs`, `:rc`, `:fence`, `:ekf`, `:gps` begins or ends
  - `{:set_param, name, value}`: as if it had been set before boot
  - `:swap_battery`: a full pack (only on the ground, disarmed)
  - `:reboot`: power is lost and comes back
  - `{:clock_jump, seconds}`: the vehicle's idea of UTC jumps
  """
  @spec handle(t, term) :: {t, [action]}
  def handle(vehicle, event), do: vehicle |> on(event) |> flush()

  # --- what personalities and flight use ---

  @doc false
  def emit(vehicle, message), do: %{vehicle | out: [{:send, message} | vehicle.out]}

  @doc false
  def act(vehicle, action), do: %{vehicle | out: [action | vehicle.out]}

  @doc false
  def notify(vehicle, event), do: act(vehicle, {:notify, event})

  @doc "Sends `message` when `delay_us` of vehicle time have passed."
  @spec later(t, non_neg_integer, struct) :: t
  def later(%{later: queue} = vehicle, _delay, _message) when length(queue) >= @later_max, do: vehicle

  def later(vehicle, delay_us, message),
    do: %{vehicle | later: [{vehicle.now + delay_us, message} | vehicle.later]}

  @doc "A text to the ground, as the personality formats it."
  @spec text(t, 0..7, String.t()) :: t
  def text(vehicle, severity, text),
    do: vehicle |> notify({:text, severity, text}) |> vehicle.personality.text(severity, text)

  @doc "Acknowledges a command to whom it came from."
  @spec ack(t, Command.t(), non_neg_integer) :: t
  def ack(vehicle, %{source: :pilot}, result), do: put_own(vehicle, :pilot_result, result)

  def ack(vehicle, command, result) do
    {system, component} = command.source

    emit(vehicle, %M.CommandAck{
      command: command.id,
      result: result,
      target_system: system,
      target_component: component
    })
  end

  @doc false
  def own(vehicle, key, default \\ nil), do: Map.get(vehicle.own, key, default)

  @doc false
  def put_own(vehicle, key, value), do: %{vehicle | own: Map.put(vehicle.own, key, value)}

  @doc "Seconds since boot."
  @spec seconds(t) :: float
  def seconds(vehicle), do: vehicle.now / 1.0e6

  @doc "Latitude and longitude in degrees x 1e7."
  @spec position(t) :: {integer, integer}
  def position(%{kin: kin, origin: origin}), do: Geo.to_global(origin, kin.n, kin.e)

  @doc "Metres above mean sea level."
  @spec altitude(t) :: number
  def altitude(vehicle), do: vehicle.origin.alt - vehicle.kin.d

  @doc "Metres above home (above the take-off point while home is unknown)."
  @spec relative_altitude(t) :: number
  def relative_altitude(vehicle), do: altitude(vehicle) - (vehicle.home || vehicle.origin).alt

  @doc "True while the position estimate is good."
  @spec positioned?(t) :: boolean
  def positioned?(vehicle) do
    vehicle.now >= vehicle.ready_us and not Enum.any?([:ekf, :gps], &MapSet.member?(vehicle.failsafes, &1))
  end

  @doc "Arms without asking; personalities check first."
  @spec arm(t) :: t
  def arm(vehicle) do
    %{vehicle | armed: true, armed_at: vehicle.now, flight: :idle} |> notify(:armed)
  end

  @doc "Stops the motors, wherever the vehicle is."
  @spec disarm(t) :: t
  def disarm(vehicle) do
    %{vehicle | armed: false, armed_at: nil, flight: :off, mission: Flight.Mission.stop(vehicle)}
    |> notify(:disarmed)
  end

  @doc "Messages by id, as REQUEST_MESSAGE asks for them; nil when this vehicle has no such message."
  @spec message(t, non_neg_integer) :: struct | nil
  def message(vehicle, id), do: Telemetry.message(vehicle, id)

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
    |> stream()
  end

  defp drain(vehicle, dt) do
    %{vehicle | battery: Battery.step(vehicle.battery, vehicle.armed, vehicle.kin.throttle, dt)}
  end

  defp send_later(%{later: []} = vehicle), do: vehicle

  defp send_later(vehicle) do
    {due, later} = Enum.split_with(vehicle.later, fn {at, _message} -> at <= vehicle.now end)
    # The list is newest first; sorting by time is stable only if the order is turned first.
    due = due |> Enum.reverse() |> Enum.sort_by(&elem(&1, 0))
    Enum.reduce(due, %{vehicle | later: later}, fn {_at, message}, v -> emit(v, message) end)
  end

  defp tick_plans(vehicle) do
    {plans, replies} = Plans.tick(vehicle.plans, vehicle.now)
    send_replies(%{vehicle | plans: plans}, replies)
  end

  defp stream(vehicle) do
    {ids, streams} = Streams.due(vehicle.streams, vehicle.now)

    Enum.reduce(ids, %{vehicle | streams: streams}, fn id, v ->
      case Telemetry.message(v, id) do
        nil -> v
        message -> emit(v, message)
      end
    end)
  end

  # --- events ---

  defp on(vehicle, {:message, message, source}) do
    case Command.from(message, source) do
      nil -> vehicle |> heard(message, source) |> on_message(message, source)
      command -> on_command(vehicle, command)
    end
  end

  defp on(vehicle, {:command, command}), do: vehicle.personality.command(vehicle, command)
  defp on(vehicle, {:failsafe, kind, on?}), do: vehicle.personality.failsafe(vehicle, kind, on?)
  defp on(vehicle, {:set_param, name, value}), do: set_param(vehicle, name, value)
  defp on(vehicle, {:clock_jump, seconds}), do: %{vehicle | epoch: vehicle.epoch + round(seconds * 1.0e6)}
  defp on(vehicle, :reboot), do: reboot(vehicle)

  defp on(%{armed: false, airborne: false} = vehicle, :swap_battery),
    do:
      Enum.reduce([:battery, :battery_critical], full(vehicle), &vehicle.personality.failsafe(&2, &1, false))

  defp on(vehicle, :swap_battery), do: vehicle

  defp full(vehicle), do: %{vehicle | battery: Battery.new(vehicle.battery_opts)}

  @doc false
  def reboot(vehicle), do: vehicle |> notify(:rebooting) |> act(:reboot)

  defp on_command(vehicle, command) do
    if vehicle.personality.addressed?(vehicle, command.target),
      do: vehicle.personality.command(vehicle, command),
      else: vehicle
  end

  defp heard(vehicle, %M.Heartbeat{type: 6}, {system, _component}) do
    vehicle = %{vehicle | gcs_heard: vehicle.now}
    vehicle.personality.gcs_heard(vehicle, system)
  end

  defp heard(vehicle, _message, _source), do: vehicle

  defp on_message(vehicle, message, source) do
    if vehicle.personality.addressed?(vehicle, target(message)) do
      case Plans.handle(vehicle.plans, message, source, Telemetry.home_item(vehicle), vehicle.now) do
        nil -> vehicle.personality.message(vehicle, message, source)
        {plans, replies} -> send_replies(%{vehicle | plans: plans}, replies)
      end
    else
      vehicle
    end
  end

  defp send_replies(vehicle, replies) do
    Enum.reduce(replies, vehicle, fn
      {:text, severity, text}, v -> text(v, severity, text)
      {kind, type}, v when kind in [:stored, :cleared] -> v.personality.plan_changed(v, kind, type)
      message, v -> emit(v, message)
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

  defp put_param!({name, value}, params) do
    {:ok, params} = Params.put(params, name, value)
    params
  end

  defp flush(vehicle), do: {%{vehicle | out: []}, Enum.reverse(vehicle.out)}
end
