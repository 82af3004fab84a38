defmodule SimVehicle.Vehicle do
  @moduledoc """
  One simulated autopilot as a value: no process, no clock, no socket.

  `SimVehicle.Server.Simulation` advances its time and gives it events, and returns the vehicle with a list of actions, in order:

  - `{:send, message}`: a `MavCodec.Messages` struct to send; `{component, message}` comes from another component than the autopilot
  - `{:bytes, binary}`: bytes outside any frame (ArduPilot's boot text)
  - `{:notify, event}`: something that tests and the fleet may wait for (`t:event/0`)
  - `:reboot`: the vehicle restarts; the owner boots it again with `SimVehicle.Server.Simulation.boot/2`

  The modules behind `SimVehicle.Firmware.Personality` have what ArduPilot and PX4 do differently. Internally every function takes and
  returns the vehicle and adds actions to `out`.
  """

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Ftp, Params, Plans}
  alias SimVehicle.Physics.{Battery, Geo, Kinematics, Wind}
  alias SimVehicle.Services.Command
  alias SimVehicle.Vehicle.{Camera, Logs}

  @later_max 200
  @override_us 3_000_000

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
            ftp: nil,
            logs: nil,
            camera: nil,
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
  - `origin`: origin of the local frame (`t:SimVehicle.Physics.Geo.origin/0`); `home`: the content of HOME_POSITION, nil until it is
    known
  - `now`: microseconds since boot; `epoch`: UNIX time of boot in microseconds
  - `ready_us`: vehicle time at which position is good enough to arm in a position mode
  - `mode`: the mode's name ("GUIDED", "AUTO_LOITER")
  - `flight`: what the vehicle is doing (`SimVehicle.Flight`)
  - `own`: state of the personality
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
          | {:heard, message :: struct, source :: {0..255, 0..255}}

  @type action :: {:send, struct | {1..255, struct}} | {:bytes, binary} | {:notify, event} | :reboot

  @doc """
  A vehicle that has not booted yet. Options (all needed, see `SimVehicle.Server.Options`): `:personality`, `:system`,
  `:component`, `:home`, `:heading` (degrees), `:ready_s`, `:battery`, `:wind`, `:seed`, `:rates`, `:params`, `:files`,
  `:logs`, `:camera`.
  """
  @spec new(map) :: t
  def new(opts) do
    personality = opts.personality
    params = personality.params() |> Params.append(opts.more_params)
    params = Enum.reduce(opts.params, params, &put_param!/2)

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
      plans: Plans.new(personality.plan_style(), opts.speed),
      ftp: Ftp.new(personality.plan_style(), opts.files),
      logs: Logs.new(personality.plan_style(), opts.logs),
      camera: opts.camera && Camera.new(opts.camera),
      rates: Map.merge(personality.rates(), opts.rates)
    }

    %{vehicle | limits: personality.limits(params)}
  end

  @doc false
  def emit(vehicle, message), do: %{vehicle | out: [{:send, message} | vehicle.out]}

  @doc false
  def act(vehicle, action), do: %{vehicle | out: [action | vehicle.out]}

  @doc false
  def notify(vehicle, event), do: act(vehicle, {:notify, event})

  @doc "Sends `message` when `delay_us` of vehicle time have passed."
  @spec later(t, non_neg_integer, struct | {1..255, struct}) :: t
  def later(%{later: queue} = vehicle, _delay, _message) when length(queue) >= @later_max, do: vehicle

  def later(vehicle, delay_us, message),
    do: %{vehicle | later: [{vehicle.now + delay_us, message} | vehicle.later]}

  @doc "A text to the ground, as the personality formats it."
  @spec text(t, 0..7, String.t()) :: t
  def text(vehicle, severity, text),
    do: vehicle |> notify({:text, severity, text}) |> vehicle.personality.text(severity, text)

  @doc "Notes and reports that a failsafe began or ended; `:unchanged` if it already had."
  @spec put_failsafe(t, atom, boolean) :: t | :unchanged
  def put_failsafe(v, kind, on?) do
    change = if on?, do: &MapSet.put/2, else: &MapSet.delete/2

    if MapSet.member?(v.failsafes, kind) == on?,
      do: :unchanged,
      else: notify(%{v | failsafes: change.(v.failsafes, kind)}, {:failsafe, kind, on?})
  end

  @doc "Acknowledges a command to its sender."
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

  @doc "The pulse width of a channel that a ground station overrides (`:overrides` of its own, with their times), nil for another."
  @spec overridden(t, 1..18) :: integer | nil
  def overridden(vehicle, n) do
    case own(vehicle, :overrides, %{}) do
      %{^n => {us, at}} when vehicle.now - at < @override_us -> us
      _pilots -> nil
    end
  end

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

  @doc "Arms without checks; personalities check first."
  @spec arm(t) :: t
  def arm(vehicle) do
    %{vehicle | armed: true, armed_at: vehicle.now, flight: :idle} |> notify(:armed)
  end

  @doc false
  def reboot(vehicle), do: vehicle |> notify(:rebooting) |> act(:reboot)

  defp put_param!({name, value}, params) do
    {:ok, params} = Params.put(params, name, value)
    params
  end
end
