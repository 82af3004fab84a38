defmodule Aerie.Vehicle.Core.Effects do
  @moduledoc """
  What follows from a change of the vehicle: samples, observations, snapshots. Each function takes and gives the core and
  the actions so far, newest first.
  """

  alias Aerie.Vehicle.{Core, Detector, Doubt, Heard, Rivals, Sampling, State, Twin}
  alias Aerie.Vehicle.Core.Dealings
  alias MavCodec.Messages.MissionItemReached

  @heartbeat 0
  @position 33
  @mission_item_reached 46
  @autopilot_version 148
  # HEARTBEAT, SYS_STATUS, GPS_RAW_INT, GLOBAL_POSITION_INT, MISSION_CURRENT, BATTERY_STATUS, FENCE_STATUS,
  # EKF_STATUS_REPORT, ESTIMATOR_STATUS, HIGH_LATENCY2, EXTENDED_SYS_STATE
  @eventful [0, 1, 24, 33, 42, 147, 162, 193, 230, 235, 245]
  # For so long a vehicle that was silent may take to show its clock.
  @restarted_us 5_000_000
  # The store is written at most twenty times a second.
  @show_us 50_000

  @type acc :: {Core.t(), [Core.action()]}

  @doc "A group was renewed: what of it goes to the fleet."
  @spec sample(acc(), State.group(), integer()) :: acc()
  def sample({core, actions}, group, at) do
    {samplers, samples} = Sampling.push(core.samplers, group, at, State.data(core.state, group))

    {%{core | samplers: samplers, dirty: true},
     Enum.reduce(samples, actions, &[publish(core, group, &1) | &2])}
  end

  @doc "A sample as an action."
  @spec publish(Core.t(), State.group(), Sampling.sample()) :: Core.action()
  def publish(core, group, {at, data}) do
    {:publish, group, %{data: data, time_boot_ms: core.state.boot_ms}, at}
  end

  @doc "A message was folded in: what the detector is to look at."
  @spec changed(Core.t(), [Core.action()], non_neg_integer(), struct(), integer()) :: acc()
  def changed(core, actions, @mission_item_reached, %MissionItemReached{seq: seq}, at) do
    {core, [{:observe, {:reached, at, core.state.boot_ms, seq}} | actions]}
  end

  # The others say nothing that events are about.
  def changed(core, actions, id, _message, _at) when id not in @eventful, do: {core, actions}

  def changed(core, actions, _id, _message, at), do: looked_at(core, actions, at)

  @doc "What the detector is to look at may have changed."
  @spec looked_at(Core.t(), [Core.action()], integer()) :: acc()
  def looked_at(core, actions, at) do
    digest = Detector.Digest.of(core.state)

    if digest == core.digest do
      {%{core | doubt: Doubt.same(core.doubt)}, actions}
    else
      # What is shown for the first time, or once more after a crash, has nothing to be compared with.
      case Doubt.change(core.doubt, digest, core.digest && why_wait(core, at), at) do
        {:wait, doubt} -> {%{core | doubt: doubt}, actions}
        {:go, since, doubt} -> observe(%{core | doubt: doubt}, actions, digest, since)
      end
    end
  end

  defp observe(core, actions, digest, at) do
    # Shown first: who is killed between the two shows the detector from the snapshot what it did not show it
    # before. The other way round the snapshot would bring back what is over.
    observation = {:state, at, core.state.boot_ms, Map.merge(digest, Detector.Digest.beside(core.state))}
    core = if begins?(core.digest, digest), do: settle(core, at), else: core
    {core, actions} = show({%{core | digest: digest, shown: nil, dirty: true}, actions}, core.now)
    {core, [{:observe, observation} | actions]}
  end

  defp why_wait(core, at) do
    cond do
      core.back != nil and at - core.back < @restarted_us -> :restart
      doubtful?(core, at) -> :two
      true -> nil
    end
  end

  @doc "Whether what comes may be of two vehicles."
  @spec doubtful?(Core.t(), integer()) :: boolean()
  def doubtful?(core, at), do: Doubt.two?(core.doubt, core.twin, core.rivals, at)

  @doc "A change that had to stay for a while, for the doubt that it is another vehicle's, may count now."
  @spec held(acc(), integer()) :: acc()
  def held({%{doubt: %{held: nil}}, _actions} = acc, _now), do: acc
  def held({core, actions}, now), do: looked_at(core, actions, now)

  # What may begin a failsafe, whose cause is perhaps only said a moment later.
  defp begins?(nil, _digest), do: true
  defp begins?(last, now), do: last.failsafe != now.failsafe or last.mode != now.mode

  @doc "The detector is to look again when what has begun `at` had time to be explained."
  @spec settle(Core.t(), integer()) :: Core.t()
  def settle(core, at), do: %{core | settle: at + Detector.Failsafe.settle_us()}

  @doc "That time is over."
  @spec settled(acc(), integer()) :: acc()
  def settled({%{settle: due} = core, actions}, now) when due != nil and now >= due,
    do:
      {%{core | settle: nil},
       [{:observe, {:settle, now, core.state.boot_ms, Detector.Digest.position(core.state)}} | actions]}

  def settled(acc, _now), do: acc

  @doc "What a message of the vehicle tells about there being two."
  @spec twin_of(Core.t(), [Core.action()], {non_neg_integer(), struct()}, integer()) :: acc()
  def twin_of(core, actions, {@position, _message}, at) do
    case State.data(core.state, :position) do
      %{lat: nil} ->
        {core, actions}

      %{lat: lat, lon: lon} ->
        twin(core, actions, Twin.place(core.twin, {lat, lon}, at, core.way), :place, at)
    end
  end

  def twin_of(core, actions, {@heartbeat, message}, at) do
    twin(core, actions, Twin.kind(core.twin, {message.type, message.autopilot}, at, core.way), :kind, at)
  end

  def twin_of(core, actions, {@autopilot_version, _message}, at) do
    twin(core, actions, Twin.uid(core.twin, core.state.uid, core.way), :uid, at)
  end

  def twin_of(core, actions, _other, _at), do: {core, actions}

  @doc "A reading of the vehicle's clock by a kind of message, which is another one's perhaps."
  @spec boot(Core.t(), [Core.action()], id :: non_neg_integer(), non_neg_integer(), integer()) :: acc()
  def boot(core, actions, id, boot_ms, at),
    do: twin(core, actions, Twin.boot(core.twin, id, boot_ms, at, core.way), {:boot, id}, at)

  @signs %{place: "position", kind: "type", uid: "uid"}

  @doc "A verdict on there being two vehicles, by the sign it goes by."
  @spec twin(Core.t(), [Core.action()], {Twin.t(), Twin.verdict()}, Twin.sign(), integer()) :: acc()
  def twin(core, actions, {twin, :one}, _sign, _at), do: {%{core | twin: twin}, actions}

  def twin(core, actions, {twin, :two}, sign, at) do
    {ones, others} = Twin.links(twin, sign)
    {rivals, kept, other} = Rivals.found(core.rivals, ones, others, at)
    links = Rivals.words(kept, other)
    collision = %{at: at, sign: sign(sign), links: links, ways: [kept, other]}
    observation = {:collision, at, core.state.boot_ms, collision.sign, collision.links}

    apart(
      {%{core | twin: twin, rivals: rivals, collision: collision, dirty: true},
       [{:observe, observation} | actions]},
      at
    )
  end

  defp sign({:boot, _id}), do: "time_boot_ms"
  defp sign(sign), do: Map.fetch!(@signs, sign)

  @doc "Tells by which ways another vehicle is heard, when that has changed."
  @spec apart(acc(), integer()) :: acc()
  def apart({%{apart: apart} = core, actions} = acc, now) do
    case Rivals.others(core.rivals, now) do
      ^apart ->
        acc

      others ->
        links = Enum.map(others, &Rivals.link/1) -- Enum.map(core.rivals.kept, &Rivals.link/1)
        {%{core | apart: others, heard: Heard.without(core.heard, links)}, [{:apart, others} | actions]}
    end
  end

  @doc "The vehicle is heard, silent or lost from now on; that is shown at once."
  @spec status(Core.t(), [Core.action()], Core.status()) :: acc()
  def status(core, actions, status) do
    show(
      {%{core | status: status, shown: nil, dirty: true}, [{:status, core.status, status} | actions]},
      core.now
    )
  end

  @doc "Shows the vehicle, if it changed and was not shown just before."
  @spec show(acc(), integer()) :: acc()
  def show({%{dirty: true} = core, actions}, now) when core.component != nil do
    if core.shown == nil or now - core.shown >= @show_us do
      core = Dealings.view(core, now)
      {%{core | shown: now, dirty: false}, [{:snapshot, Core.snapshot(core, core.view)} | actions]}
    else
      {core, actions}
    end
  end

  def show({core, actions}, _now), do: {core, actions}
end
