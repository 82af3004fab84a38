defmodule Aerie.Vehicle.Core do
  @moduledoc """
  What a vehicle's session does, without the process: `handle(state, event) -> {state, actions}`.

  Events:

    * `{:frames, way, frames}` - frames of this system, in the order of their arrival, each with its time `at`; `way` is a
      link's id, or `{link, peer}` where several endpoints bring the system
    * `{:link_again, link}` - a link on which it was heard was interrupted and is connected again
    * `{:tick, now}` - it is `now` (unix microseconds) and nothing has come
    * `{:rebase, now}` - what was called another time is `now` from here on: a clock was set
    * `{:shift, step}` - the clock was set by so much (microseconds): all that was heard was heard as long ago as before
    * `{:link, link, %{high_latency: boolean}}` - what is configured about a link
    * `{:stations, stations}` - who else sends heartbeats on the vehicle's network (`Aerie.Router.Stations`)
    * `{:asked, request, at}` - a TIMESYNC request of ours that a recording has, for its answers
    * `{:wants, wants, forwarded}` - what clients want of the vehicle has changed (`Aerie.Vehicle.Streams.Arbiter.wants/3`)

  Time is the frames' own: a recorded flight played at any speed gives what the flight gave. Before a frame is applied,
  every deadline that lies before its time is dealt with. A frame that is more than two seconds older than the one before
  means that a clock was set back or a recording began anew; nothing has to be waited for twice then.

  Actions, to be carried out in order:

    * `{:snapshot, map}` - what the store is to show
    * `{:observe, observation}` - something for the detector (`Aerie.Vehicle.Detector`)
    * `{:publish, group, %{data: map, time_boot_ms: ms}, at}` - a sampled state group for the fleet
    * `{:send, message, version}` - a message for the vehicle, in the MAVLink version that it speaks
    * `{:send, message, version, link}` - by this link
    * `{:round_trip, link, us}` - how long the way there and back by a link took
    * `{:heartbeat, version}` - our heartbeat is due on the vehicle's way
    * `:withhold` - it is due and must not go there, not from other vehicles' sessions either
    * `{:apart, ways}` - by these ways another vehicle with this id is heard, or by none any more (`Aerie.Vehicle.Rivals`)
    * `{:count, counter}` - something to be counted
    * `{:status, old, new}` - the vehicle is heard again, is silent, is lost

  Only the autopilot's component says anything about the vehicle (H2, H4): the first one that sends an autopilot's
  heartbeat, or component 1 when it does. Frames of gimbals, cameras and ground stations that use the vehicle's system id
  are counted as heard on the link, and change nothing else.
  """

  alias Aerie.Mavlink.BootClock

  alias Aerie.Vehicle.{
    Detector,
    Doubt,
    Heard,
    Options,
    Reports,
    Rivals,
    Sampling,
    State,
    StatusText,
    Twin
  }

  alias Aerie.Vehicle.Core.{Dealings, Intake, Timers}
  alias Aerie.Vehicle.{Gcs, HighLatency, Timesync}
  alias Aerie.Vehicle.Streams.Arbiter

  defstruct [
    :options,
    :now,
    :last_heard,
    :component,
    :expired,
    :shown,
    :digest,
    :heartbeat,
    :collision,
    :view,
    :viewed,
    :way,
    :settle,
    status: :online,
    version: 2,
    beat: 1,
    dirty: false,
    observed: nil,
    back: nil,
    confirm: false,
    state: %State{},
    heard: Heard.new(),
    clock: BootClock.new(),
    twin: Twin.new(),
    rivals: Rivals.new(),
    apart: [],
    doubt: Doubt.new(),
    texts: StatusText.new(),
    early: [],
    reports: Reports.new(),
    recent: %{},
    streams: Arbiter.new(),
    timesync: Timesync.new(0),
    gcs: Gcs.new(),
    high_latency: HighLatency.new(),
    samplers: nil
  ]

  @collision_us 60_000_000

  @typedoc "Only this module and those below it look into it."
  @type t :: %__MODULE__{}
  @type status :: :online | :stale | :lost
  @type event ::
          {:frames, Rivals.way(), [struct()]}
          | {:link_again, link :: term()}
          | {:tick, integer()}
          | {:rebase, integer()}
          | {:shift, integer()}
          | {:link, link :: term(), %{high_latency: boolean()}}
          | {:stations, [Aerie.Router.Stations.station()]}
          | {:wants, Aerie.Fleet.Wants.merged(), non_neg_integer() | nil}
          | {:asked, struct(), integer()}
  @type action ::
          {:snapshot, map()}
          | {:observe, Detector.observation()}
          | {:publish, State.group(), map(), integer()}
          | {:send, struct(), 1 | 2}
          | {:send, struct(), 1 | 2, link :: term()}
          | {:round_trip, link :: term(), us :: non_neg_integer()}
          | {:heartbeat, 1 | 2}
          | :withhold
          | {:apart, [Rivals.way()]}
          | {:count, atom()}
          | {:status, atom(), atom()}

  @doc "The state of a vehicle of which nothing is known, or what its last snapshot tells."
  @spec new(Options.t(), map() | nil) :: t()
  def new(options, snapshot \\ nil)

  def new(options, nil) do
    %__MODULE__{
      options: options,
      samplers: Sampling.new(options.sampling),
      streams: Arbiter.new(options.wants),
      timesync: Timesync.new(options.timesync_us)
    }
  end

  def new(options, snapshot) do
    state = State.restore(snapshot)
    boots = for {_group, %{time_boot_ms: boot_ms}} when is_integer(boot_ms) <- snapshot.groups, do: boot_ms

    %{
      new(options)
      | state: state,
        last_heard: snapshot.last_heard,
        now: snapshot.last_heard,
        status: snapshot.status,
        component: snapshot[:component],
        heard: Heard.new(snapshot.links, snapshot.last_heard),
        clock: BootClock.new(Enum.max(boots, fn -> nil end)),
        gcs: Gcs.new(snapshot[:gcs]),
        high_latency: HighLatency.new(snapshot[:high_latency], snapshot.last_heard),
        # Both are shown to the detector again: the crash may have been between the snapshot and that, and the
        # detector knows what it has seen.
        digest: nil,
        confirm: true
    }
  end

  @doc "One step."
  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(core, {:link, link, %{high_latency: marked?}}),
    do: {%{core | high_latency: HighLatency.marked(core.high_latency, link, marked?)}, []}

  def handle(core, {:stations, stations}),
    do: {%{core | gcs: Gcs.stations(core.gcs, stations, own(core.options))}, []}

  def handle(core, {:wants, wants, forwarded}),
    do: {%{core | streams: Arbiter.wants(core.streams, wants, forwarded)}, []}

  def handle(core, {:asked, request, at}),
    do: {%{core | timesync: Timesync.asked(core.timesync, request, at)}, []}

  def handle(%{confirm: true} = core, event) do
    {next, actions} = handle(%{core | confirm: false}, event)
    {next, [confirm(core) | actions]}
  end

  def handle(core, {:frames, way, frames}) do
    link = Rivals.link(way)

    {core, actions} =
      Enum.reduce(frames, {%{core | way: way}, []}, fn frame, {core, actions} ->
        {core, actions} = Timers.before(core, actions, frame.at)

        core = %{
          core
          | now: max(core.now || frame.at, frame.at),
            rivals: Rivals.heard(core.rivals, way, frame.at)
        }

        if Rivals.other?(core.rivals, way, frame.at),
          do: Intake.rival(core, actions, frame),
          else: Intake.frame(core, actions, link, frame)
      end)

    {Timers.observed(core, actions), Enum.reverse(actions)}
  end

  # It may have been restarted, or be on another of its ports, where it sends other streams.
  def handle(%{now: nil} = core, {:link_again, _link}), do: {core, []}

  def handle(core, {:link_again, _link}),
    do: {%{core | streams: Arbiter.rebooted(core.streams, core.now)}, []}

  def handle(core, {:tick, now}) do
    {core, actions} = Timers.tick(%{core | now: max(core.now || now, now)}, now)
    {Timers.observed(core, actions), Enum.reverse(actions)}
  end

  def handle(core, {:rebase, now}) do
    {core, actions} = Timers.rebase(core, [], now)
    {core, Enum.reverse(actions)}
  end

  def handle(%{now: nil} = core, {:shift, _step}), do: {core, []}

  def handle(core, {:shift, step}) do
    {core, actions} = Timers.shift(core, [], step)
    {core, Enum.reverse(actions)}
  end

  defp own(options), do: {options.own_system, options.own_component}

  @doc "The vehicle as faces see it."
  @spec snapshot(t()) :: map()
  def snapshot(core), do: snapshot(core, Dealings.show(core))

  @doc false
  @spec snapshot(t(), view :: map()) :: map()
  def snapshot(%__MODULE__{options: options, state: state} = core, view) do
    %{
      id: options.id,
      key: options.key,
      network: options.network,
      system_id: options.system_id,
      component: core.component,
      autopilot: state.autopilot,
      vehicle_type: state.kind,
      type: state.type,
      firmware: state.firmware,
      uid: state.uid,
      capabilities: state.capabilities,
      status: core.status,
      last_heard: core.last_heard,
      time_boot_ms: state.boot_ms,
      links: Heard.links(core.heard),
      groups: state.groups,
      collision: collision(core),
      memory: State.memory(state)
    }
    |> Map.merge(view)
  end

  # For as long as there may be two.
  defp collision(%{collision: %{at: at} = collision, now: now}) when now - at < @collision_us, do: collision
  defp collision(_core), do: nil

  # As of before this step.
  defp confirm(%{status: :lost} = core),
    do: {:observe, {:lost, core.last_heard + core.options.lost_us, nil, core.options.lost_us}}

  defp confirm(core), do: {:observe, {:restored, core.last_heard, nil}}
end
