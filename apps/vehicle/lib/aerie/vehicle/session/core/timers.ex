defmodule Aerie.Vehicle.Session.Core.Timers do
  @moduledoc """
  What follows from time passing: incomplete texts, samples, silence, rates, and what `Services` has to do.
  """

  alias Aerie.Vehicle.{Collision, State}
  alias Aerie.Vehicle.Session.Core
  alias Aerie.Vehicle.State.Sampling
  alias Aerie.Vehicle.Session.Core.{Collisions, Effects, Reporting, Services, SnapshotSchedule, Texts}
  alias Aerie.Vehicle.Services.Links.Reception

  # How long after the last observation the detector learns that there was none since.
  @quiet_us 3_000_000

  @doc "Does what is due before a frame that came `at`."
  @spec before(Core.t(), [Core.action()], integer()) :: {Core.t(), [Core.action()]}
  def before(core, actions, at) do
    # Expired waits count before the frame changes them, whether or not a tick came in between.
    if due?(core, at),
      do: expire(core, actions, at),
      else: {core, actions} |> Effects.held(at) |> Effects.settled(at)
  end

  @doc "Does what is due at `now` without a frame; nothing if a frame has just done it."
  @spec tick(Core.t(), integer()) :: {Core.t(), [Core.action()]}
  def tick(core, now),
    do: if(due?(core, now) or now < core.expired_at, do: expire(core, [], now), else: {core, []})

  defp due?(%{expired_at: nil}, _at), do: true

  defp due?(core, at),
    do:
      at - core.expired_at >= SnapshotSchedule.tick_us(core.shown) or overdue?(Texts.deadline(core.texts), at)

  defp overdue?(nil, _at), do: false
  defp overdue?(deadline, at), do: at >= deadline

  @doc """
  Time goes on from `now`, which is not comparable with the time before. Waiting begins again, and what was heard counts as
  heard now.
  """
  @spec rebase(Core.t(), [Core.action()], integer()) :: {Core.t(), [Core.action()]}
  def rebase(core, actions, now) do
    {texts, done} = Texts.finish(core.texts, now)

    core = %{
      core
      | now: now,
        last_heard: core.last_heard && now,
        expired_at: nil,
        other_vehicle: %{core.other_vehicle | collision: nil, claims: %{}},
        observed_at: core.observed_at && now,
        heard_again_at: nil,
        settle_at: core.settle_at && now,
        shown: SnapshotSchedule.due(core.shown),
        texts: texts,
        reception: Reception.new(Reception.links(core.reception), now),
        collision_detector: Collision.Detector.rebased(core.collision_detector),
        owner: Collision.Owner.new(),
        suspicion: Collision.Suspicion.new(),
        samplers: Sampling.new(core.options.sampling),
        state: State.rebased(core.state, now)
    }

    {core, actions} = Reporting.texts({core, actions}, done)
    {Services.rebased(core, now), actions}
  end

  @doc """
  The clock was set by `step`: waiting begins again as in `rebase/3`, and everything was heard as long ago as before. The
  snapshot is written at once, because its readers go by the new time already.
  """
  @spec shift(Core.t(), [Core.action()], integer()) :: {Core.t(), [Core.action()]}
  def shift(core, actions, step) do
    now = core.now + step
    {rebased, actions} = rebase(core, actions, now)

    shifted = %{
      rebased
      | last_heard: core.last_heard && core.last_heard + step,
        other_vehicle: shifted_other(core.other_vehicle, step),
        reception: Reception.shifted(core.reception, step),
        owner: Collision.Owner.shifted(core.owner, step),
        state: State.shifted(core.state, step),
        dirty: true
    }

    Effects.show({Services.shifted(core, shifted, step), actions}, now)
  end

  defp shifted_other(%{collision: nil} = other_vehicle, _step), do: other_vehicle
  defp shifted_other(other_vehicle, step), do: update_in(other_vehicle.collision.at, &(&1 + step))

  # Handles the deadlines before `now`. Actions are newest first.
  defp expire(core, actions, now) do
    {texts, done} = Texts.expire(core.texts, now)
    {samplers, samples} = Sampling.expire(core.samplers, now)
    {core, actions} = Reporting.texts({core, actions}, done)

    actions =
      Enum.reduce(samples, actions, fn {group, sample}, actions ->
        [Effects.publish(core, group, sample) | actions]
      end)

    {%{core | texts: texts, samplers: samplers, expired_at: now}, actions}
    |> quiet(now)
    |> Collisions.separate(now)
    |> Effects.held(now)
    |> Effects.settled(now)
    |> silence(now)
    |> measure(now)
    |> Services.expire(now)
    |> Reporting.expire(now)
    |> Effects.show(now)
  end

  @doc "Notes when the detector was last given something by these actions, newest first."
  @spec observed(Core.t(), [Core.action()]) :: Core.t()
  def observed(core, actions) do
    case List.keyfind(actions, :observe, 0) do
      nil -> core
      {:observe, %{kind: :quiet}} -> %{core | observed_at: nil}
      {:observe, %{at: at}} -> %{core | observed_at: at}
    end
  end

  # Then the detector reports the events that were over the budget.
  defp quiet({core, actions}, now) do
    case observed(core, actions) do
      %{observed_at: at} = core when at != nil and now - at >= @quiet_us ->
        {%{core | observed_at: nil}, [Effects.observation(core, :quiet, at + @quiet_us) | actions]}

      core ->
        {core, actions}
    end
  end

  defp silence({%{last_heard: nil} = core, actions}, _now), do: {core, actions}

  defp silence({core, actions}, now) do
    silent = now - core.last_heard
    {stale_us, lost_us} = Services.timeouts(core, now)

    cond do
      core.status != :lost and silent >= lost_us ->
        lost = Effects.observation(core, :lost, core.last_heard + lost_us, lost_us)
        Effects.status(core, [lost | actions], :lost)

      core.status == :online and silent >= stale_us ->
        Effects.status(core, actions, :stale)

      true ->
        {core, actions}
    end
  end

  defp measure({core, actions}, now) do
    case Reception.measure(core.reception, now, &Services.lost_us(core, &1)) do
      {reception, nil} ->
        {%{core | reception: reception}, actions}

      {reception, data} ->
        state = State.put(core.state, :link, Map.put(data, :status, core.status), now)
        Effects.sample({%{core | reception: reception, state: state}, actions}, :link, now)
    end
  end
end
