defmodule Aerie.Vehicle.Core.Timers do
  @moduledoc """
  What follows from time passing: texts that stay incomplete, samples, silence, rates, and what `Dealings` has to do.
  """

  alias Aerie.Vehicle.{Core, Doubt, Heard, Rivals, Sampling, State, StatusText, Twin}
  alias Aerie.Vehicle.Core.{Dealings, Effects, Reporting}

  # Deadlines are looked at ten times a second.
  @period_us 100_000
  # So long after the last observation the detector is told that there was none since.
  @quiet_us 3_000_000
  # Two links may deliver a little out of order; more than this is another time.
  @back_us 2_000_000

  @doc "What there is to do before a frame that came `at` is looked at."
  @spec before(Core.t(), [Core.action()], integer()) :: {Core.t(), [Core.action()]}
  def before(core, actions, at) do
    cond do
      core.now != nil and at < core.now - @back_us -> rebase(core, actions, at)
      due?(core, at) -> expire(core, actions, at)
      true -> {core, actions}
    end
  end

  @doc "What there is to do when it is `now` and no frame came: nothing, where one has done it just before."
  @spec tick(Core.t(), integer()) :: {Core.t(), [Core.action()]}
  def tick(core, now),
    do: if(due?(core, now) or now < core.expired, do: expire(core, [], now), else: {core, []})

  defp due?(%{expired: nil}, _at), do: true
  defp due?(core, at), do: at - core.expired >= @period_us or overdue?(StatusText.deadline(core.texts), at)

  defp overdue?(nil, _at), do: false
  defp overdue?(deadline, at), do: at >= deadline

  @doc """
  Time goes on from `now`, whatever it was before. What was waited for begins anew, and what was heard counts as heard
  now: how long ago it was can no longer be told.
  """
  @spec rebase(Core.t(), [Core.action()], integer()) :: {Core.t(), [Core.action()]}
  def rebase(core, actions, now) do
    {texts, done} = StatusText.finish(core.texts, now)

    core = %{
      core
      | now: now,
        last_heard: core.last_heard && now,
        expired: nil,
        collision: nil,
        observed: core.observed && now,
        back: nil,
        settle: core.settle && now,
        shown: nil,
        recent: %{},
        texts: texts,
        heard: Heard.new(Heard.links(core.heard), now),
        twin: Twin.rebased(core.twin),
        rivals: Rivals.rebased(core.rivals),
        doubt: Doubt.new(),
        samplers: Sampling.new(core.options.sampling),
        state: State.rebased(core.state, now)
    }

    {core, actions} = Reporting.texts({core, actions}, done)
    {Dealings.rebased(core, now), actions}
  end

  @doc """
  The clock was set by `step`: what is waited for begins anew as in `rebase/3`, and all that was heard was heard as long ago
  as before. Shown at once, for who looks goes by the new time already.
  """
  @spec shift(Core.t(), [Core.action()], integer()) :: {Core.t(), [Core.action()]}
  def shift(core, actions, step) do
    now = core.now + step
    {rebased, actions} = rebase(core, actions, now)

    shifted = %{
      rebased
      | last_heard: core.last_heard && core.last_heard + step,
        collision: core.collision && %{core.collision | at: core.collision.at + step},
        heard: Heard.shifted(core.heard, step),
        rivals: Rivals.shifted(core.rivals, step),
        state: State.shifted(core.state, step),
        dirty: true
    }

    Effects.show({Dealings.shifted(core, shifted, step), actions}, now)
  end

  @doc "It is `now`. The actions come newest first."
  @spec expire(Core.t(), [Core.action()], integer()) :: {Core.t(), [Core.action()]}
  def expire(core, actions, now) do
    {texts, done} = StatusText.expire(core.texts, now)
    {samplers, samples} = Sampling.expire(core.samplers, now)
    {core, actions} = Reporting.texts({core, actions}, done)

    actions =
      Enum.reduce(samples, actions, fn {group, sample}, actions ->
        [Effects.publish(core, group, sample) | actions]
      end)

    {%{core | texts: texts, samplers: samplers, expired: now}, actions}
    |> quiet(now)
    |> Effects.apart(now)
    |> Effects.held(now)
    |> Effects.settled(now)
    |> silence(now)
    |> measure(now)
    |> Dealings.expire(now)
    |> Reporting.expire(now)
    |> Effects.show(now)
  end

  @doc "Remembers when the detector was last shown something by these actions, which come newest first."
  @spec observed(Core.t(), [Core.action()]) :: Core.t()
  def observed(core, actions) do
    case Enum.find(actions, &match?({:observe, _observation}, &1)) do
      nil -> core
      {:observe, {:quiet, _at, _boot_ms}} -> %{core | observed: nil}
      {:observe, observation} -> %{core | observed: elem(observation, 1)}
    end
  end

  # What it did not tell for want of budget it tells then.
  defp quiet({core, actions}, now) do
    case observed(core, actions) do
      %{observed: at} = core when at != nil and now - at >= @quiet_us ->
        {%{core | observed: nil}, [{:observe, {:quiet, at + @quiet_us, core.state.boot_ms}} | actions]}

      core ->
        {core, actions}
    end
  end

  defp silence({%{last_heard: nil} = core, actions}, _now), do: {core, actions}

  defp silence({core, actions}, now) do
    silent = now - core.last_heard

    {stale_us, lost_us} = Dealings.patience(core, now)

    cond do
      core.status != :lost and silent >= lost_us ->
        observation = {:lost, core.last_heard + lost_us, core.state.boot_ms, lost_us}
        Effects.status(core, [{:observe, observation} | actions], :lost)

      core.status == :online and silent >= stale_us ->
        Effects.status(core, actions, :stale)

      true ->
        {core, actions}
    end
  end

  defp measure({core, actions}, now) do
    case Heard.measure(core.heard, now) do
      {heard, nil} ->
        {%{core | heard: heard}, actions}

      {heard, data} ->
        core = %{
          core
          | heard: heard,
            state: State.put(core.state, :link, Map.put(data, :status, core.status), now)
        }

        Effects.sample({core, actions}, :link, now)
    end
  end
end
