defmodule Aerie.Vehicle.Session.Core.Effects do
  @moduledoc """
  What follows from a change of the vehicle: samples, observations, snapshots. Each function takes and returns the core with
  the actions so far, newest first.
  """

  alias Aerie.Vehicle.{Collision, State}
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Session.Core
  alias Aerie.Vehicle.State.Sampling
  alias Aerie.Vehicle.Session.Core.{Collisions, SnapshotSchedule}
  alias Aerie.Vehicle.Events.Detector.Observation
  alias MavCodec.Messages, as: M

  # The messages that a digest is made of.
  @eventful Enum.map(
              [
                M.Heartbeat,
                M.SysStatus,
                M.GpsRawInt,
                M.GlobalPositionInt,
                M.MissionCurrent,
                M.BatteryStatus,
                M.FenceStatus,
                M.EkfStatusReport,
                M.EstimatorStatus,
                M.HighLatency2,
                M.ExtendedSysState
              ],
              & &1.id()
            )
  # How long a vehicle that was silent may take to show its clock.
  @restarted_us 5_000_000

  @type acc :: {Core.t(), [Core.action()]}

  @doc "Groups were updated: publishes what their samplers give."
  @spec samples(acc(), [State.group()], integer()) :: acc()
  def samples(acc, [], _at), do: acc
  def samples(acc, [group | groups], at), do: acc |> sample(group, at) |> samples(groups, at)

  @doc "A group was updated."
  @spec sample(acc(), State.group(), integer()) :: acc()
  def sample({core, actions}, group, at) do
    {samplers, samples} = Sampling.push(core.samplers, group, at, State.data(core.state, group))
    {%{core | samplers: samplers, dirty: true}, published(samples, actions, core, group)}
  end

  defp published([], actions, _core, _group), do: actions

  defp published([sample | rest], actions, core, group),
    do: published(rest, [publish(core, group, sample) | actions], core, group)

  @doc "A sample as an action."
  @spec publish(Core.t(), State.group(), Sampling.sample()) :: Core.action()
  def publish(core, group, {at, data}) do
    {:publish, group, %{data: data, time_boot_ms: core.state.boot_ms}, at}
  end

  @doc "A message was applied to the state: gives the detector what it has to see of it."
  @spec changed(Core.t(), [Core.action()], non_neg_integer(), struct(), integer()) :: acc()
  def changed(core, actions, _id, %M.MissionItemReached{seq: seq}, at),
    do: {core, [observation(core, :reached, at, seq) | actions]}

  def changed(core, actions, id, _message, _at) when id not in @eventful, do: {core, actions}
  def changed(core, actions, _id, _message, at), do: check_digest(core, actions, at)

  @doc "Shows the detector the digest of the state, if it has changed."
  @spec check_digest(Core.t(), [Core.action()], integer()) :: acc()
  def check_digest(core, actions, at) do
    digest = Detector.Digest.of(core.state)

    if digest == core.digest do
      {%{core | suspicion: Collision.Suspicion.unchanged(core.suspicion)}, actions}
    else
      # The first digest, and the first after a crash, has nothing to be compared with.
      why_wait = core.digest && why_wait(core, at)

      case Collision.Suspicion.change(core.suspicion, digest, why_wait, at) do
        {:wait, suspicion} -> {%{core | suspicion: suspicion}, actions}
        {:go, since, suspicion} -> show_digest(%{core | suspicion: suspicion}, actions, digest, since)
      end
    end
  end

  defp show_digest(core, actions, digest, at) do
    data = Map.merge(digest, Detector.Digest.beside(core.state))
    sign = failsafe_sign(core.digest, digest)
    core = if sign, do: settle(core, sign, at), else: core

    # The snapshot comes first: after a crash between the two, the session shows the detector from the snapshot what it
    # had not shown before. The other way round the snapshot would bring back a state that is over.
    {core, actions} =
      show(
        {%{core | digest: digest, shown: SnapshotSchedule.due(core.shown), dirty: true}, actions},
        core.now
      )

    {core, [observation(core, :state, at, data) | actions]}
  end

  defp why_wait(core, at) do
    cond do
      core.heard_again_at != nil and at - core.heard_again_at < @restarted_us -> :restart
      Collisions.suspected?(core, at) -> :two
      true -> nil
    end
  end

  @doc "Shows the detector a change that had to wait because it might have been another vehicle's, if it may count now."
  @spec held(acc(), integer()) :: acc()
  def held({%{suspicion: %{held: nil}}, _actions} = acc, _now), do: acc
  def held({core, actions}, now), do: check_digest(core, actions, now)

  # Possible signs of a failsafe.
  defp failsafe_sign(last, %{fence_breach: true}) when last == nil or last.fence_breach != true, do: :fence
  defp failsafe_sign(nil, _digest), do: :status

  defp failsafe_sign(last, now),
    do: if(last.failsafe != now.failsafe or last.mode != now.mode, do: :status)

  @doc "Makes the detector look again when there was time to learn the cause of what began `at`."
  @spec settle(Core.t(), Detector.Failsafe.sign(), integer()) :: Core.t()
  def settle(core, kind, at),
    do: %{core | settle_at: max(core.settle_at || 0, at + Detector.Failsafe.settle_us(kind))}

  @doc "Makes the detector look again, if that time is over."
  @spec settled(acc(), integer()) :: acc()
  def settled({%{settle_at: due} = core, actions}, now) when due != nil and now >= due do
    where = Detector.Digest.position(core.state)
    {%{core | settle_at: nil}, [observation(core, :settle, now, where) | actions]}
  end

  def settled(acc, _now), do: acc

  @doc "An observation with the vehicle's clock, as an action."
  @spec observation(Core.t(), Observation.kind(), integer(), term()) :: Core.action()
  def observation(core, kind, at, data \\ nil),
    do: {:observe, Observation.new(kind, at, core.state.boot_ms, data)}

  @doc "The vehicle is online, stale or lost from now on; the snapshot shows it at once."
  @spec status(Core.t(), [Core.action()], Core.status()) :: acc()
  def status(core, actions, status) do
    next = %{core | status: status, shown: SnapshotSchedule.due(core.shown), dirty: true}
    show({next, [{:status, core.status, status} | actions]}, core.now)
  end

  @doc "Writes the snapshot, if something changed and the last one is old enough."
  @spec show(acc(), integer()) :: acc()
  def show({%{dirty: true} = core, actions}, now) when core.component != nil do
    if SnapshotSchedule.due?(core.shown, now) do
      shown = SnapshotSchedule.write(core.shown, now, fn -> Core.view(core) end)

      {%{core | shown: shown, dirty: false},
       [{:snapshot, SnapshotSchedule.snapshot(core, shown.view)} | actions]}
    else
      {core, actions}
    end
  end

  def show({core, actions}, _now), do: {core, actions}
end
