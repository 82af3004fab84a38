defmodule Aerie.Vehicle.Core.Timers do
  @moduledoc """
  What follows from time passing: texts that stay incomplete, samples, silence, rates, requests, our heartbeat.
  """

  alias Aerie.Vehicle.{Core, Heard, Sampling, State, StatusText, Twin}
  alias Aerie.Vehicle.Core.Effects
  alias Aerie.Vehicle.Streams.Arbiter

  # Deadlines are looked at twenty times a second.
  @period_us 50_000
  @heartbeat_us 1_000_000
  # Two links may deliver a little out of order; more than this is another time.
  @back_us 2_000_000
  # HIGH_LATENCY2 comes every five seconds or less; a link of that kind is not lost after five.
  @high_latency_us 60_000_000

  @doc "What there is to do before a frame that came `at` is looked at."
  @spec before(Core.t(), [Core.action()], integer()) :: {Core.t(), [Core.action()]}
  def before(core, actions, at) do
    cond do
      core.now != nil and at < core.now - @back_us -> rebase(core, actions, at)
      due?(core, at) -> expire(core, actions, at)
      true -> {core, actions}
    end
  end

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
        shown: nil,
        heartbeat: nil,
        recent: %{},
        texts: texts,
        heard: Heard.new(Heard.links(core.heard), now),
        twin: Twin.rebased(core.twin),
        streams: Arbiter.rebased(core.streams, now),
        samplers: Sampling.new(core.options.sampling),
        state: State.rebased(core.state, now)
    }

    {core, Effects.observe_texts(core, actions, done)}
  end

  @doc "It is `now`. The actions come newest first."
  @spec expire(Core.t(), [Core.action()], integer()) :: {Core.t(), [Core.action()]}
  def expire(core, actions, now) do
    {texts, done} = StatusText.expire(core.texts, now)
    {samplers, samples} = Sampling.expire(core.samplers, now)
    actions = Effects.observe_texts(core, actions, done)

    actions =
      Enum.reduce(samples, actions, fn {group, sample}, actions ->
        [Effects.publish(core, group, sample) | actions]
      end)

    {%{core | texts: texts, samplers: samplers, expired: now}, actions}
    |> silence(now)
    |> measure(now)
    |> ask(now)
    |> beat(now)
    |> Effects.show(now)
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

  defp ask({%{options: %{request_streams: true}, status: :online, component: component} = core, actions}, now)
       when component != nil do
    {streams, messages, notices} = Arbiter.expire(core.streams, now, {core.options.system_id, component})
    actions = if notices == [], do: actions, else: [{:observe, contested(core, notices, now)} | actions]
    {%{core | streams: streams}, Enum.reduce(messages, actions, &[{:send, &1, core.version} | &2])}
  end

  defp ask({core, actions}, _now), do: {core, actions}

  defp contested(core, notices, now), do: {:streams, now, core.state.boot_ms, notices}

  # Fed by this loop: no heartbeat from a gateway whose loops stand still (H3). A vehicle that is lost gets it too, its
  # own receiver may be all that works. One that speaks MAVLink 1 is shown every other time that we speak 2, which is
  # how ArduPilot comes to (V2).
  defp beat({%{options: %{heartbeat: true}} = core, actions}, now) do
    if core.heartbeat == nil or now - core.heartbeat >= @heartbeat_us do
      version = if core.version == 1, do: 3 - core.beat, else: 2
      {%{core | heartbeat: now, beat: version}, [{:heartbeat, version} | actions]}
    else
      {core, actions}
    end
  end

  defp beat({core, actions}, _now), do: {core, actions}
end
