defmodule SimVehicle.Pilot do
  @moduledoc """
  Flies a script by giving the vehicle commands from inside, so that none of them appears on the link.

  A script is a list of steps that is repeated for ever:

  - `:ready` wait until the vehicle could be armed, `{:wait, seconds}`
  - `:arm` (in GUIDED, or PX4's hold), `{:takeoff, metres}`, `{:goto, north, east, metres_up}`, `:rtl`, `:land`
  - `:landed` wait until it is down and disarmed, `:swap_battery`

  If somebody else commands the vehicle (arms, changes the mode, sets a target), the pilot stops until the vehicle has been on
  the ground and disarmed for five minutes: nobody who looks around after a landing is to be surprised by a take-off. It also stops during any failsafe.
  """

  import MavCodec.Command

  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle
  alias SimVehicle.Physics.Geo
  alias SimVehicle.Services.Command

  @hands_off_us 300_000_000
  # A refused command is tried again; a step that does not finish is given up.
  @retry_us 2_000_000
  @step_max_us 300_000_000

  # Other senders' commands that do not affect the flight.
  @harmless [401, 410, 510, 511, 512, 519, 520, 42_428]

  defstruct script: [],
            left: [],
            since: nil,
            ordered_at: nil,
            hands_off: false,
            quiet_since: nil,
            boots: 0,
            events: []

  @type step ::
          :ready
          | {:wait, number}
          | :arm
          | {:takeoff, number}
          | {:goto, number, number, number}
          | :rtl
          | :land
          | :landed
          | :swap_battery
  @type t :: %__MODULE__{}

  @doc "True for a list of steps."
  @spec script?(term) :: boolean
  def script?(script), do: is_list(script) and script != [] and Enum.all?(script, &step?/1)

  @doc "A pilot before the first step."
  @spec new([step]) :: t
  def new(script), do: %__MODULE__{script: script, left: script}

  @doc "The patterns that the fleet flies, chosen by number: circuits of different shape, height and length."
  @spec pattern(non_neg_integer) :: [step]
  def pattern(number) do
    height = 15 + rem(number, 4) * 5
    size = 60 + rem(number * 37, 90)
    legs = shape(rem(number, 3), size, height)

    [:ready, {:wait, 2 + rem(number, 5)}, :arm, {:takeoff, height}] ++
      legs ++ legs ++ [:rtl, :landed, :swap_battery, {:wait, 8}]
  end

  defp shape(0, s, h), do: [{:goto, s, 0, h}, {:goto, s, s, h + 5}, {:goto, 0, s, h}, {:goto, 0, 0, h}]
  defp shape(1, s, h), do: [{:goto, s, s / 2, h + 8}, {:goto, 0, s, h}, {:goto, -s / 2, s / 2, h + 3}]

  defp shape(2, s, h),
    do: for(k <- 0..7, do: {:goto, wave(s, k, &:math.sin/1), wave(s, k, &:math.cos/1), h + rem(k, 2) * 4})

  defp wave(size, k, fun), do: Float.round(size * fun.(k * :math.pi() / 4), 1)

  @doc "The vehicle received somebody else's message."
  @spec overheard(t, struct, Vehicle.t()) :: t
  def overheard(pilot, %module{} = message, vehicle) do
    commanding? =
      case message do
        %M.CommandLong{target_system: to, command: id} -> to in [0, vehicle.system] and id not in @harmless
        %M.CommandInt{target_system: to, command: id} -> to in [0, vehicle.system] and id not in @harmless
        _other -> module in [M.SetMode, M.SetPositionTargetLocalNed, M.SetPositionTargetGlobalInt]
      end

    if commanding?, do: let_go(pilot), else: pilot
  end

  @doc "The vehicle reported an event."
  @spec notified(t, Vehicle.event()) :: t
  def notified(pilot, {:failsafe, _kind, true}), do: let_go(pilot)

  def notified(pilot, event) when event in [:arrived, :landed],
    do: %{pilot | events: [event | pilot.events] |> Enum.take(4)}

  def notified(pilot, _event), do: pilot

  @doc "The commands to give now, as events for `SimVehicle.Server.Simulation.handle/2`."
  @spec step(t, Vehicle.t()) :: {t, [term]}
  def step(%{boots: boots} = pilot, %{boots: now} = v) when boots != now,
    do: step(restart(%{pilot | boots: now}, v), v)

  def step(%{hands_off: true} = pilot, v), do: {wait_for_hands(pilot, v), []}
  def step(%{left: []} = pilot, v), do: step(restart(pilot, v), v)
  def step(%{since: nil} = pilot, v), do: step(%{pilot | since: v.now}, v)
  def step(pilot, v) when v.now - pilot.since > @step_max_us, do: {give_up(pilot, v), []}

  def step(%{left: [step | _rest]} = pilot, v) do
    cond do
      done?(step, pilot, v) -> {next(pilot), []}
      pilot.ordered_at != nil and v.now - pilot.ordered_at < @retry_us -> {pilot, []}
      true -> {%{pilot | ordered_at: v.now, events: []}, orders(step, v)}
    end
  end

  defp next(pilot), do: %{pilot | left: tl(pilot.left), since: nil, ordered_at: nil, events: []}
  defp restart(pilot, _v), do: %{pilot | left: pilot.script, since: nil, ordered_at: nil, events: []}
  defp let_go(pilot), do: %{pilot | hands_off: true, quiet_since: nil}

  # In the air, the script can only start again after a landing.
  defp give_up(pilot, %{airborne: true} = v), do: %{restart(pilot, v) | left: [:rtl, :landed, :swap_battery]}
  defp give_up(pilot, v), do: restart(pilot, v)

  defp wait_for_hands(pilot, %{armed: true}), do: %{pilot | quiet_since: nil}
  defp wait_for_hands(%{quiet_since: nil} = pilot, v), do: %{pilot | quiet_since: v.now}

  defp wait_for_hands(pilot, v) when v.now - pilot.quiet_since >= @hands_off_us,
    do: %{restart(pilot, v) | hands_off: false, left: [:swap_battery | pilot.script]}

  defp wait_for_hands(pilot, _v), do: pilot

  defp done?(:ready, _pilot, v), do: Vehicle.positioned?(v)
  defp done?({:wait, seconds}, pilot, v), do: v.now - pilot.since >= seconds * 1.0e6
  defp done?(:arm, _pilot, v), do: v.armed
  defp done?({:takeoff, height}, _pilot, v), do: v.airborne and Vehicle.relative_altitude(v) > height - 1
  defp done?({:goto, _n, _e, _up}, pilot, _v), do: pilot.ordered_at != nil and :arrived in pilot.events
  defp done?(going, pilot, _v) when going in [:rtl, :land], do: pilot.ordered_at != nil
  defp done?(:landed, _pilot, v), do: not v.armed and not v.airborne
  defp done?(:swap_battery, pilot, _v), do: pilot.ordered_at != nil

  defp orders(:arm, %{plans: %{style: :ardupilot}}),
    do: [command(cmd(:DO_SET_MODE), [1.0, 4.0]), command(cmd(:COMPONENT_ARM_DISARM), [1.0])]

  defp orders(:arm, _v),
    do: [command(cmd(:DO_SET_MODE), [1.0, 4.0, 3.0]), command(cmd(:COMPONENT_ARM_DISARM), [1.0])]

  defp orders({:takeoff, height}, %{plans: %{style: :ardupilot}}),
    do: [command(cmd(:NAV_TAKEOFF), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height * 1.0])]

  defp orders({:takeoff, height}, v) do
    nan = List.duplicate(:nan, 3)
    [command(cmd(:NAV_TAKEOFF), [0.0, 0.0, 0.0] ++ nan ++ [(v.home || v.origin).alt + height])]
  end

  defp orders({:goto, n, e, up}, v) do
    {lat, lon} = Geo.to_global(v.origin, n, e)
    alt = (v.home || v.origin).alt + up

    order = %{
      Command.pilot(cmd(:DO_REPOSITION), [-1.0, 1.0, 0.0, :nan, 0.0, 0.0, alt])
      | int?: true,
        frame: 0,
        x: lat,
        y: lon
    }

    [{:command, order}]
  end

  defp orders(:rtl, _v), do: [command(cmd(:NAV_RETURN_TO_LAUNCH), [])]
  defp orders(:land, _v), do: [command(cmd(:NAV_LAND), [0.0, 0.0, 0.0, :nan, :nan, :nan, :nan])]
  defp orders(:swap_battery, _v), do: [:swap_battery]
  defp orders(_waiting, _v), do: []

  defp command(id, params), do: {:command, Command.pilot(id, params)}

  defp step?(step) when step in [:ready, :arm, :rtl, :land, :landed, :swap_battery], do: true
  defp step?({:wait, seconds}), do: is_number(seconds) and seconds >= 0
  defp step?({:takeoff, height}), do: is_number(height) and height > 0
  defp step?({:goto, n, e, up}), do: is_number(n) and is_number(e) and is_number(up) and up > 0
  defp step?(_other), do: false
end
