defmodule Aerie.Vehicle.Core.Reporting do
  @moduledoc """
  What the vehicle has to say in words: STATUSTEXT, and the EVENT messages that are often the same (`Aerie.Vehicle.Reports`).
  """

  alias Aerie.Vehicle.{Core, Detector, Reports, State, StatusText}
  alias Aerie.Vehicle.Core.{Dealings, Effects}
  alias Aerie.Vehicle.Detector.{Reported, Texts}

  @fresh_ms 10_000
  # A clock that was read a second ago says no better; an event of hours ago is one of another clock.
  @late_us 2_000_000
  @believed_us 3_600_000_000

  @type acc :: {Core.t(), [Core.action()]}

  @doc "An EVENT or what belongs to it, of any component of the vehicle. The actions come newest first."
  @spec message(Core.t(), [Core.action()], struct(), struct()) :: acc()
  def message(core, actions, %{component: component, at: at}, message) do
    own = {core.options.own_system, core.options.own_component}
    sure? = not Effects.doubtful?(core, at)
    {reports, given} = Reports.message(core.reports, component, message, own, at, sure?)
    give({%{core | reports: reports}, actions}, given, at)
  end

  @doc "Texts that are complete."
  @spec texts(acc(), [StatusText.text()]) :: acc()
  def texts(acc, texts) do
    Enum.reduce(texts, acc, fn text, {core, actions} ->
      observation = {:text, text.at, core.state.boot_ms, text.severity, text.text}
      core = if Texts.activation(text.text), do: Effects.settle(core, text.at), else: core
      {%{core | reports: Reports.text(core.reports, text)}, [{:observe, observation} | actions]}
    end)
  end

  @doc "What is due at `now`."
  @spec expire(acc(), integer()) :: acc()
  def expire({core, actions}, now) do
    {reports, given} = Reports.expire(core.reports, now)
    {core, actions} = give({%{core | reports: reports}, actions}, given, now)
    if ask?(core, now), do: ask(core, actions, now), else: {core, actions}
  end

  defp ask?(%{options: options, status: status} = core, now),
    do:
      options.request_streams and status == :online and Dealings.open?(core, now) and
        Reports.missing?(core.reports) and not Effects.doubtful?(core, now)

  defp ask(core, actions, now) do
    {reports, requests} = Reports.requests(core.reports, core.options.system_id, now)
    sent = for request <- Enum.reverse(requests), do: {:send, request, core.version}
    {%{core | reports: reports}, sent ++ actions}
  end

  defp give(acc, given, at), do: Enum.reduce(given, acc, &give_one(&1, &2, at))

  defp give_one({:said, report}, {core, actions}, at) do
    if Reported.about?(report.name) and fresh?(core, report) do
      where = Detector.Digest.position(core.state)
      observation = {:said, at, report.boot_ms, report.name, report.values, where}
      {Effects.settle(core, at), [{:observe, observation} | actions]}
    else
      {core, actions}
    end
  end

  defp give_one({:report, report}, {core, actions}, at) do
    words = Reports.words(report)
    late_us = late(core, report, at)

    data = %{
      "id" => words.id,
      "name" => report.name,
      "severity" => report.severity,
      "internal_severity" => report.internal,
      "arguments" => words.arguments,
      "values" => report.values,
      "component" => report.component,
      "sequence" => report.sequence
    }

    data = if late_us > 0, do: Map.put(data, "late_s", Float.round(late_us / 1_000_000, 1)), else: data
    {%{core | dirty: true}, [{:observe, {:report, report.at - late_us, report.boot_ms, data}} | actions]}
  end

  defp give_one({:checks, list}, {core, actions}, at) do
    checks =
      for report <- list, do: %{id: Reports.words(report).id, name: report.name, severity: report.severity}

    core = %{core | state: State.put(core.state, :health, %{arming_checks: checks}, at)}
    {core, actions} = Effects.sample({core, actions}, :health, at)
    Effects.looked_at(core, actions, at)
  end

  # By how much it came after it happened, by the vehicle's clock: that of the autopilot.
  defp late(%{component: component, state: %{boot_ms: boot_ms}}, %{component: component} = report, now)
       when is_integer(boot_ms) do
    late_us = report.at - (now - (boot_ms - report.boot_ms) * 1000)
    if late_us in @late_us..@believed_us, do: late_us, else: 0
  end

  defp late(_core, _report, _now), do: 0

  # What was asked for again after a gap of some length tells what was, not what is.
  defp fresh?(%{state: %{boot_ms: now}}, %{boot_ms: then}) when is_integer(now), do: now - then <= @fresh_ms
  defp fresh?(_core, _report), do: true
end
