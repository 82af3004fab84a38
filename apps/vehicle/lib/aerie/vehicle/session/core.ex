defmodule Aerie.Vehicle.Session.Core do
  @moduledoc """
  What a vehicle's session does, without the process: `handle(state, event) -> {state, actions}`.

  Events:

    * `{:frames, path, frames}` - frames of this system in the order of their arrival, each with its time `at`; `path` is a
      link's id, or `{link, peer}` if several peers bring the system
    * `{:claimed, path, at}` - somebody sends under the vehicle's id by a path that is not its own; the router keeps his frames off
    * `{:link_reconnected, link}` - a link on which the vehicle was heard was interrupted and is connected again
    * `{:tick, now}` - it is `now` (unix microseconds), and nothing has come
    * `{:rebase, now}` - time goes on from `now`, which is not comparable with the time before: a recording began again. What was
      waited for before is not waited for again
    * `{:shift, step}` - the clock was set by `step` (microseconds): everything was heard as long ago as before
    * `{:link, link, %{high_latency: boolean, msp: boolean}}` - what is configured for a link; `msp`: it says itself
      what its vehicle is
    * `{:stations, stations}` - what else sends heartbeats on the vehicle's network (`MavRouter.Forward.GroundStations`)
    * `{:vehicles, n}` - how many vehicles the gateway has: the more, the less often each is shown
    * `{:asked, request, at}` - a TIMESYNC request of ours that is in a recording, to recognise its answers
    * `{:hold_requests, hold?}` - no message or rate is to be requested until further notice
    * `{:event_definitions, definitions}` - what the vehicle itself says about its events (`Aerie.Vehicle.Services.Reports.Definitions`)
    * `{:operator, fields}` - who is in charge of the vehicle changed: fields of the group `operator`
    * `{:demand, demand, forwarded}` - the rates that clients want have changed (`Aerie.Vehicle.Services.Streams.Arbiter.demand/3`)

  Time is that of the frames, so a recorded flight gives the same result at any speed. Before a frame is applied, every
  earlier deadline is handled. A frame that is older than the one before came late, which changes nothing of what is waited for.

  Actions, to be carried out in order:

    * `{:snapshot, snapshot}` - what the store is to show
    * `{:observe, observation}` - for the detector (`Aerie.Vehicle.Events.Detector.Observation`)
    * `{:reported, report}` - a report (EVENT) has just come, and tells what is
    * `{:publish, group, %{data: map, time_boot_ms: ms}, at}` - a sample of a state group for the fleet
    * `{:send, message, version}` - a message to the vehicle, in the MAVLink version that it speaks
    * `{:send, message, version, link}` - the same, by this link
    * `{:authorise_arming, from}` - the vehicle asks whether it may arm (`Aerie.Vehicle.Session.ArmAuthorization`)
    * `{:round_trip, link, us}` - a measured round trip by a link
    * `{:heartbeat, version}` - our heartbeat is due on the vehicle's path
    * `:withhold` - our heartbeat is due and must not be sent there, not by other vehicles' sessions either
    * `:describe_events` - what the vehicle itself says about its events is to be read
    * `{:other_vehicle, paths}` - the paths by which another vehicle with this id is heard; `[]` when that is over
      (`Aerie.Vehicle.Collision.Owner`)
    * `{:count, counter}` - something to count
    * `{:status, old, new}` - `:online`, `:stale` or `:lost`

  Only the autopilot's component says anything about the vehicle (H2, H4): the first one that sends an autopilot's
  heartbeat, or component 1 when it does. Frames of gimbals, cameras and ground stations with the vehicle's system id count
  as heard on the link, and their texts and reports become events; they change nothing else.
  """

  alias MavCodec.Message.BootClock
  alias Aerie.Vehicle.{Collision, Options, State}
  alias Aerie.Vehicle.State.Sampling
  alias Aerie.Vehicle.Services.{Gcs, Reports, Switches, Timesync}
  alias Aerie.Vehicle.Session.Core.{Collisions, Effects, Frames, Reporting, Services}
  alias Aerie.Vehicle.Session.Core.{SnapshotSchedule, Texts, Timers}
  alias Aerie.Vehicle.Events.Detector.Observation
  alias Aerie.Vehicle.Services.Links.{HighLatency, Reception}
  alias Aerie.Vehicle.Services.Streams.Arbiter

  # At most 32 keys with __struct__: the BEAM keeps a larger map as a tree, which takes several times as long to read and to change.
  defstruct [
    :options,
    :now,
    :last_heard,
    :component,
    :expired_at,
    :digest,
    :path,
    :settle_at,
    :observed_at,
    :heard_again_at,
    :modes_asked,
    status: :online,
    version: 2,
    heartbeat: %{at: nil, version: 1, heard2: nil},
    shown: %SnapshotSchedule{},
    dirty: false,
    state: %State{},
    reception: Reception.new(),
    boot_clock: BootClock.new(),
    collision_detector: Collision.Detector.new(),
    owner: Collision.Owner.new(),
    suspicion: Collision.Suspicion.new(),
    other_vehicle: %{collision: nil, paths: [], claims: %{}},
    texts: %Texts{},
    reports: Reports.new(),
    streams: Arbiter.new(),
    timesync: Timesync.new(0),
    gcs: Gcs.new(),
    switches: Switches.new(),
    high_latency: HighLatency.new(),
    samplers: nil
  ]

  @typedoc """
  For this module and those in its folder.

  - `expired_at`, `observed_at`: when deadlines were last handled, the detector was last given something
  - `version`: 2 while the autopilot is heard in MAVLink 2, by whichever link; `heartbeat`: when ours was last due, the
    version of the last one, and when version 2 was last heard (`heard2`)
  - `heard_again_at`: the first frame after a silence, until the vehicle's clock shows whether it was restarted
  - `settle_at`: when the detector looks again for the cause of a failsafe
  - `digest`: what the detector was shown last; `:restored` after a crash, until it has got the status again
  - `path`: that of the frames at hand; `other_vehicle`: the last collision, what the last `:other_vehicle` action said,
    and since when who claims the id
  """
  @type t :: %__MODULE__{}
  @type status :: :online | :stale | :lost
  @type event ::
          {:frames, Collision.Owner.path(), [struct()]}
          | {:claimed, Collision.Owner.path(), integer()}
          | {:link_reconnected, link :: term()}
          | {:tick, integer()}
          | {:rebase, integer()}
          | {:shift, integer()}
          | {:link, link :: term(), %{:high_latency => boolean(), optional(:msp) => boolean()}}
          | {:stations, [MavRouter.Forward.GroundStations.station()]}
          | {:vehicles, non_neg_integer()}
          | {:demand, Aerie.Vehicle.Services.StreamDemand.merged(), non_neg_integer() | nil}
          | {:asked, struct(), integer()}
          | {:operator, map()}
          | {:hold_requests, boolean()}
          | {:event_definitions, Aerie.Vehicle.Services.Reports.Definitions.t()}
  @type action ::
          {:snapshot, SnapshotSchedule.snapshot()}
          | {:observe, Observation.t()}
          | {:reported, Aerie.Vehicle.Services.Reports.report()}
          | {:publish, State.group(), map(), integer()}
          | {:send, struct(), 1 | 2}
          | {:send, struct(), 1 | 2, link :: term()}
          | {:authorise_arming, Aerie.Vehicle.Protocol.source()}
          | {:round_trip, link :: term(), us :: non_neg_integer()}
          | {:heartbeat, 1 | 2}
          | :withhold
          | :describe_events
          | {:other_vehicle, [Collision.Owner.path()]}
          | {:count, atom()}
          | {:status, atom(), atom()}

  @doc "The core of a vehicle of which nothing is known, or of one with a last snapshot."
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
        component: snapshot.component,
        version: snapshot.mavlink_version || 2,
        reception: Reception.new(snapshot.links, snapshot.last_heard),
        boot_clock: BootClock.new(Enum.max(boots, fn -> nil end), snapshot.last_heard),
        gcs: Gcs.new(snapshot.gcs),
        switches: Switches.new(snapshot.params),
        high_latency: HighLatency.new(snapshot.high_latency, snapshot.last_heard),
        # Digest and status are shown to the detector again: the crash may have come between writing the snapshot and
        # telling the detector, and the detector knows what it has seen.
        digest: :restored
    }
  end

  @doc "The system ids that the vehicle takes for its station's (`Gcs.obeyed/1`)."
  @spec obeyed(t()) :: {integer(), integer()} | :unknown | nil
  def obeyed(core), do: Gcs.obeyed(core.gcs)

  @doc "The time between two ticks (microseconds)."
  @spec tick_us(t()) :: pos_integer()
  def tick_us(core), do: SnapshotSchedule.tick_us(core.shown)

  @doc "One step."
  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(core, {:link, link, %{high_latency: configured?} = facts}) do
    owner = Collision.Owner.says(core.owner, link, Map.get(facts, :msp, false))
    {%{core | high_latency: HighLatency.configured(core.high_latency, link, configured?), owner: owner}, []}
  end

  def handle(core, {:stations, stations}),
    do: {%{core | gcs: Gcs.stations(core.gcs, stations, own(core.options))}, []}

  def handle(core, {:vehicles, n}), do: {%{core | shown: SnapshotSchedule.vehicles(core.shown, n)}, []}

  def handle(core, {:demand, demand, forwarded}),
    do: {%{core | streams: Arbiter.demand(core.streams, demand, forwarded)}, []}

  def handle(%{now: nil} = core, {:operator, _operator}), do: {core, []}

  def handle(core, {:operator, operator}) do
    core = %{core | state: State.put(core.state, :operator, operator, core.now)}
    {core, actions} = {core, []} |> Effects.sample(:operator, core.now) |> Effects.show(core.now)
    {core, Enum.reverse(actions)}
  end

  def handle(core, {:hold_requests, hold?}),
    do: {%{core | streams: Arbiter.hold(core.streams, hold?)}, []}

  def handle(core, {:event_definitions, definitions}), do: {Reporting.definitions(core, definitions), []}

  def handle(core, {:asked, request, at}),
    do: {%{core | timesync: Timesync.asked(core.timesync, request, at)}, []}

  def handle(%{digest: :restored} = core, event) do
    {next, actions} = handle(%{core | digest: nil}, event)
    {next, [confirm_status(core) | actions]}
  end

  def handle(core, {:frames, path, frames}) do
    {core, actions} = frames(core, [], frames, path, Collision.Owner.link(path))
    # Once for all of them: nobody would see those in between.
    {core, actions} = Effects.show({core, actions}, core.now)

    {Timers.observed(core, actions), Enum.reverse(actions)}
  end

  def handle(%{now: nil} = core, {:claimed, _path, _at}), do: {core, []}

  def handle(core, {:claimed, path, at}) do
    {core, actions} = Collisions.claimed(core, [], path, at)
    {core, actions} = Effects.show({core, actions}, core.now)
    {core, Enum.reverse(actions)}
  end

  # The vehicle may have been restarted, or be on another of its ports, which sends other streams.
  def handle(%{now: nil} = core, {:link_reconnected, _link}), do: {core, []}

  def handle(core, {:link_reconnected, _link}),
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

  defp frames(core, actions, [], _path, _link), do: {core, actions}

  defp frames(core, actions, [%{at: at} = frame | frames], path, link) do
    {core, actions} = Timers.before(core, actions, at)
    owner = Collision.Owner.seen(core.owner, path, at)
    core = %{core | now: max(core.now || at, at), owner: owner, path: path}

    {core, actions} =
      if Collision.Owner.other?(owner, path, at),
        do: Collisions.other_vehicle(core, actions, frame),
        else: Frames.frame(core, actions, link, frame)

    frames(core, actions, frames, path, link)
  end

  defp own(options), do: {options.own_system, options.own_component}

  @doc false
  # For `Aerie.Vehicle.Session.Core.Effects`, which the services use.
  @spec view(t()) :: map()
  defdelegate view(core), to: Services, as: :show

  @doc "The vehicle as the read model shows it."
  @spec snapshot(t()) :: SnapshotSchedule.snapshot()
  def snapshot(core), do: SnapshotSchedule.snapshot(core, Services.show(core))

  # The status before this step.
  defp confirm_status(%{status: :lost, options: %{lost_us: lost_us}} = core),
    do: {:observe, Observation.new(:lost, core.last_heard + lost_us, nil, lost_us)}

  defp confirm_status(core), do: {:observe, Observation.new(:restored, core.last_heard, nil)}
end
