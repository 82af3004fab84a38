defmodule Aerie.Vehicle.Core do
  @moduledoc """
  What a vehicle's session does, without the process: `handle(state, event) -> {state, actions}`.

  Events:

    * `{:frames, link, frames}` - frames of this system, in the order of their arrival, each with its time `at`
    * `{:tick, now}` - it is `now` (unix microseconds) and nothing has come

  Time is the frames' own: a recorded flight played at any speed gives what the flight gave. Before a frame is applied,
  every deadline that lies before its time is dealt with.

  Actions, to be carried out in order:

    * `{:snapshot, map}` - what the store is to show
    * `{:observe, observation}` - something for the detector (`Aerie.Vehicle.Detector`)
    * `{:publish, group, %{data: map, time_boot_ms: ms}, at}` - a sampled state group for the fleet
    * `{:send, message, version}` - a message for the vehicle, in the MAVLink version that it speaks
    * `{:heartbeat, version}` - our heartbeat is due on the vehicle's way
    * `{:count, counter}` - something to be counted
    * `{:status, old, new}` - the vehicle is heard again, is silent, is lost

  Only the autopilot's component says anything about the vehicle (H2, H4): the first one that sends an autopilot's
  heartbeat, or component 1 when it does. Frames of gimbals, cameras and ground stations that use the vehicle's system id
  are counted as heard on the link, and change nothing else.
  """

  alias Aerie.Vehicle.{
    BootClock,
    Detector,
    Heard,
    Kind,
    Options,
    Params,
    Sampling,
    State,
    StatusText,
    Streams,
    Twin
  }

  alias MavCodec.Messages, as: M

  defstruct [
    :options,
    :now,
    :last_heard,
    :component,
    :expired,
    :shown,
    :digest,
    :heartbeat,
    status: :online,
    version: 2,
    dirty: false,
    state: %State{},
    heard: Heard.new(),
    clock: BootClock.new(),
    twin: Twin.new(),
    texts: StatusText.new(),
    recent: %{},
    streams: Streams.new(),
    samplers: nil
  ]

  @opaque t :: %__MODULE__{}
  @type event :: {:frames, link :: term(), [struct()]} | {:tick, integer()}
  @type action ::
          {:snapshot, map()}
          | {:observe, Detector.observation()}
          | {:publish, State.group(), map(), integer()}
          | {:send, struct(), 1 | 2}
          | {:heartbeat, 1 | 2}
          | {:count, atom()}
          | {:status, atom(), atom()}

  @heartbeat 0
  @system_time 2
  @param_value 22
  @position 33
  @autopilot_version 148
  @statustext 253
  # HEARTBEAT, SYS_STATUS, GLOBAL_POSITION_INT, MISSION_CURRENT, BATTERY_STATUS, FENCE_STATUS, HIGH_LATENCY2,
  # EXTENDED_SYS_STATE
  @eventful [0, 1, 33, 42, 147, 162, 235, 245]

  # The store is written at most twenty times a second, deadlines are looked at as often.
  @show_us 50_000
  @heartbeat_us 1_000_000
  # HIGH_LATENCY2 comes every five seconds or less; a link of that kind is not lost after five.
  @high_latency_us 60_000_000

  @doc "The state of a vehicle of which nothing is known, or what its last snapshot tells."
  @spec new(Options.t(), map() | nil) :: t()
  def new(options, snapshot \\ nil)
  def new(options, nil), do: %__MODULE__{options: options, samplers: Sampling.new(options.sampling)}

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
        # Shown to the detector again: it was possibly not before the crash, and it knows what it has seen.
        digest: nil
    }
  end

  @doc "One step."
  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(core, {:frames, link, frames}) do
    {core, actions} =
      Enum.reduce(frames, {core, []}, fn frame, {core, actions} ->
        {core, actions} = if due?(core, frame.at), do: expire(core, actions, frame.at), else: {core, actions}
        frame(%{core | now: max(core.now || frame.at, frame.at)}, actions, link, frame)
      end)

    {core, Enum.reverse(actions)}
  end

  def handle(core, {:tick, now}) do
    {core, actions} = expire(%{core | now: max(core.now || now, now)}, [], now)
    {core, Enum.reverse(actions)}
  end

  @doc "The vehicle as faces see it."
  @spec snapshot(t()) :: map()
  def snapshot(%__MODULE__{options: options, state: state} = core) do
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
      groups: state.groups
    }
  end

  # --- frames ---------------------------------------------------------------------------------------------------------

  # Whoever it is that speaks: the way to this system works.
  defp frame(core, actions, link, frame) do
    core = %{core | heard: Heard.frame(core.heard, link, byte_size(frame.bytes), frame.at)}

    cond do
      frame.id == @heartbeat ->
        heartbeat(core, actions, link, frame)

      frame.component == core.component ->
        autopilot(core, actions, link, frame)

      core.component == nil and frame.id == 235 ->
        autopilot(%{core | component: frame.component}, actions, link, frame)

      true ->
        {core, actions}
    end
  end

  defp heartbeat(core, actions, link, frame) do
    {:ok, message} = MavCodec.decode(frame)
    known = core.component

    if Kind.vehicle?(message.type, message.autopilot) and
         (known in [nil, frame.component] or frame.component == 1) do
      {core, actions} = alive(%{core | component: frame.component, version: frame.version}, actions, frame.at)
      message(core, actions, link, frame, message)
    else
      {core, actions}
    end
  end

  defp autopilot(core, actions, link, %{id: id, at: at} = frame) do
    {core, actions} = alive(core, actions, at)

    if State.wants?(core.state, id, at) or id in [@system_time, @param_value, @statustext] do
      case MavCodec.decode(frame) do
        {:ok, message} -> message(core, actions, link, frame, message)
        {:error, _unknown} -> {core, actions}
      end
    else
      {core, actions}
    end
  end

  # Something of the autopilot came.
  defp alive(%{status: :online} = core, actions, at),
    do: {%{core | last_heard: later(core.last_heard, at)}, actions}

  defp alive(core, actions, at) do
    observed = if core.status == :lost, do: [{:observe, {:restored, at, core.state.boot_ms}}], else: []
    core = %{core | last_heard: at, streams: %{core.streams | due: core.streams.due && at + @show_us}}
    status(core, observed ++ actions, :online)
  end

  defp message(core, actions, _link, frame, %{time_boot_ms: boot_ms} = message) do
    {clock, verdict} = BootClock.read(core.clock, boot_ms, frame.at)
    core = %{core | clock: clock}

    case verdict do
      :ok ->
        {core, actions} =
          twin(core, actions, Twin.boot(core.twin, boot_ms, frame.at), "time_boot_ms", frame.at)

        apply_message(%{core | state: State.at_boot(core.state, boot_ms)}, actions, frame, message)

      # Older than what is known, or the first sign of a reboot; either way it is worth a moment's wait.
      :behind ->
        twin(core, actions, Twin.boot(core.twin, boot_ms, frame.at), "time_boot_ms", frame.at)

      :reboot ->
        core = %{
          core
          | state: State.at_boot(core.state, boot_ms),
            twin: Twin.rebooted(core.twin),
            streams: Streams.rebooted(core.streams, frame.at)
        }

        apply_message(core, [{:observe, {:reboot, frame.at, boot_ms}} | actions], frame, message)
    end
  end

  defp message(core, actions, link, %{id: @statustext} = frame, message) do
    {first?, core} = first_copy(core, link, frame)

    if first? do
      {texts, done} = StatusText.push(core.texts, frame.component, message, frame.at)
      {%{core | texts: texts}, observe_texts(core, actions, done)}
    else
      {core, actions}
    end
  end

  defp message(core, actions, _link, %{id: @param_value} = frame, message) do
    case Params.read(message, core.state.autopilot) do
      {:ok, value} -> {core, add_param(actions, frame.at, core.state.boot_ms, value)}
      :ignore -> {core, actions}
    end
  end

  defp message(core, actions, _link, frame, message), do: apply_message(core, actions, frame, message)

  defp apply_message(core, actions, %{id: @system_time}, _message), do: {core, actions}

  defp apply_message(core, actions, %{id: id, at: at}, message) do
    core = %{core | streams: Streams.heard(core.streams, id, at)}

    case State.apply(core.state, id, message, at) do
      {:invalid, _field} ->
        {core, [{:count, :invalid} | actions]}

      {state, groups} ->
        {core, actions} = twin_of(%{core | state: state}, actions, id, message, at)
        {core, actions} = Enum.reduce(groups, {core, actions}, &sample(&2, &1, at))
        core |> changed(actions, id, message, at) |> show(at)
    end
  end

  # --- what follows from a message ------------------------------------------------------------------------------------

  defp sample({core, actions}, group, at) do
    {samplers, samples} = Sampling.push(core.samplers, group, at, State.data(core.state, group))

    {%{core | samplers: samplers, dirty: true},
     Enum.reduce(samples, actions, &[publish(core, group, &1) | &2])}
  end

  defp publish(core, group, {at, data}) do
    {:publish, group, %{data: data, time_boot_ms: core.state.boot_ms}, at}
  end

  defp changed(core, actions, 46, %M.MissionItemReached{seq: seq}, at) do
    {core, [{:observe, {:reached, at, core.state.boot_ms, seq}} | actions]}
  end

  # The others say nothing that events are about.
  defp changed(core, actions, id, _message, _at) when id not in @eventful, do: {core, actions}

  defp changed(core, actions, _id, _message, at) do
    case Detector.digest(core.state) do
      same when same == core.digest ->
        {core, actions}

      digest ->
        observation = {:state, at, core.state.boot_ms, Map.put(digest, :where, where(core.state))}
        # A change of mode or arming is worth showing at once.
        shown = if shown?(core.digest, digest), do: nil, else: core.shown
        {%{core | digest: digest, shown: shown}, [{:observe, observation} | actions]}
    end
  end

  defp shown?(%{mode: mode, armed: armed, in_air: in_air}, %{mode: mode, armed: armed, in_air: in_air}),
    do: false

  defp shown?(_last, _now), do: true

  defp where(state) do
    case State.data(state, :position) do
      %{lat: nil} ->
        nil

      %{lat: lat, lon: lon} = p ->
        %{"lat" => lat, "lon" => lon, "alt_msl" => p.alt_msl, "alt_rel" => p.alt_rel}
    end
  end

  defp twin_of(core, actions, @position, _message, at) do
    case State.data(core.state, :position) do
      %{lat: nil} -> {core, actions}
      %{lat: lat, lon: lon} -> twin(core, actions, Twin.place(core.twin, {lat, lon}, at), "position", at)
    end
  end

  defp twin_of(core, actions, @autopilot_version, _message, at) do
    twin(core, actions, Twin.uid(core.twin, core.state.uid), "uid", at)
  end

  defp twin_of(core, actions, _id, _message, _at), do: {core, actions}

  defp twin(core, actions, {twin, :one}, _sign, _at), do: {%{core | twin: twin}, actions}

  defp twin(core, actions, {twin, :two}, sign, at) do
    {%{core | twin: twin}, [{:observe, {:collision, at, core.state.boot_ms, sign}} | actions]}
  end

  # A second link brings the same frame again: same number, same content, other link. (The number alone would not do, R7.)
  defp first_copy(core, link, frame) do
    key = {frame.component, frame.seq, frame.payload}

    case core.recent do
      %{^key => {other, at}} when other != link and frame.at - at < 5_000_000 ->
        {false, core}

      recent ->
        recent =
          if map_size(recent) < 64,
            do: recent,
            else: Map.filter(recent, fn {_, {_, at}} -> frame.at - at < 5_000_000 end)

        recent = if map_size(recent) < 256, do: recent, else: %{}
        {true, %{core | recent: Map.put(recent, key, {link, frame.at})}}
    end
  end

  defp observe_texts(core, actions, texts) do
    Enum.reduce(texts, actions, fn text, actions ->
      [{:observe, {:text, text.at, core.state.boot_ms, text.severity, text.text}} | actions]
    end)
  end

  # What came in one read is one observation: a list of a thousand parameters is not a thousand steps.
  defp add_param([{:observe, {:params, at, boot_ms, values}} | actions], at, boot_ms, value) do
    [{:observe, {:params, at, boot_ms, values ++ [value]}} | actions]
  end

  defp add_param(actions, at, boot_ms, value), do: [{:observe, {:params, at, boot_ms, [value]}} | actions]

  # --- time -----------------------------------------------------------------------------------------------------------

  defp due?(%{expired: nil}, _at), do: true
  defp due?(core, at), do: at - core.expired >= @show_us or overdue?(StatusText.deadline(core.texts), at)

  defp overdue?(nil, _at), do: false
  defp overdue?(deadline, at), do: at >= deadline

  defp expire(core, actions, now) do
    {texts, done} = StatusText.expire(core.texts, now)
    {samplers, samples} = Sampling.expire(core.samplers, now)
    actions = observe_texts(core, actions, done)

    actions =
      Enum.reduce(samples, actions, fn {group, sample}, actions ->
        [publish(core, group, sample) | actions]
      end)

    {%{core | texts: texts, samplers: samplers, expired: now}, actions}
    |> silence(now)
    |> measure(now)
    |> ask(now)
    |> beat(now)
    |> show(now)
  end

  defp silence({%{last_heard: nil} = core, actions}, _now), do: {core, actions}

  defp silence({core, actions}, now) do
    silent = now - core.last_heard

    lost_us =
      if core.state.high_latency, do: max(core.options.lost_us, @high_latency_us), else: core.options.lost_us

    stale_us = if core.state.high_latency, do: lost_us, else: core.options.stale_us

    cond do
      core.status != :lost and silent >= lost_us ->
        observation = {:lost, core.last_heard + lost_us, core.state.boot_ms, lost_us}
        status(core, [{:observe, observation} | actions], :lost)

      core.status == :online and silent >= stale_us ->
        status(core, actions, :stale)

      true ->
        {core, actions}
    end
  end

  defp status(core, actions, status) do
    show(
      {%{core | status: status, shown: nil, dirty: true}, [{:status, core.status, status} | actions]},
      core.now
    )
  end

  defp measure({core, actions}, now) do
    case Heard.measure(core.heard, now) do
      {heard, nil} ->
        {%{core | heard: heard}, actions}

      {heard, data} ->
        core = %{core | heard: heard, state: State.put(core.state, :link, data, now)}
        sample({core, actions}, :link, now)
    end
  end

  defp ask({%{options: %{request_streams: true}, status: :online, component: component} = core, actions}, now)
       when component != nil do
    {streams, messages} = Streams.expire(core.streams, now, {core.options.system_id, component})
    {%{core | streams: streams}, Enum.reduce(messages, actions, &[{:send, &1, core.version} | &2])}
  end

  defp ask({core, actions}, _now), do: {core, actions}

  # Fed by this loop: no heartbeat from a gateway whose loops stand still (H3). A vehicle that is lost gets it too, its
  # own receiver may be all that works.
  defp beat({%{options: %{heartbeat: true}} = core, actions}, now) do
    if core.heartbeat == nil or now - core.heartbeat >= @heartbeat_us,
      do: {%{core | heartbeat: now}, [{:heartbeat, core.version} | actions]},
      else: {core, actions}
  end

  defp beat({core, actions}, _now), do: {core, actions}

  defp show({%{dirty: true} = core, actions}, now) when core.component != nil do
    if core.shown == nil or now - core.shown >= @show_us,
      do: {%{core | shown: now, dirty: false}, [{:snapshot, snapshot(core)} | actions]},
      else: {core, actions}
  end

  defp show({core, actions}, _now), do: {core, actions}

  defp later(nil, at), do: at
  defp later(last, at), do: max(last, at)
end
