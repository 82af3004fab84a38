defmodule Aerie.Vehicle.Session.Core.Reporting do
  @moduledoc """
  Texts (STATUSTEXT) and reports (EVENT) of the vehicle, which often say the same (`Aerie.Vehicle.Services.Reports`).
  """

  alias Aerie.Vehicle.{Firmware, State}
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Session.Core
  alias Aerie.Vehicle.Services.Reports
  alias Aerie.Vehicle.Session.Core.{Collisions, Effects, Services}
  alias Aerie.Vehicle.Events.Detector.{Observation, StatusTexts}
  alias Aerie.Vehicle.Events.Detector.Failsafe.Px4Reports
  alias Protocols.StatusText

  @fresh_ms 10_000
  # The vehicle's clock is known to about a second; a report that seems hours old is one of another clock.
  @late_us 2_000_000
  @max_late_us 3_600_000_000

  @type acc :: {Core.t(), [Core.action()]}

  @doc "EVENT, CURRENT_EVENT_SEQUENCE or RESPONSE_EVENT_ERROR of a component of the vehicle. Actions are newest first."
  @spec message(Core.t(), [Core.action()], struct(), struct()) :: acc()
  def message(core, actions, %{component: component, at: at}, message) do
    own = {core.options.own_system, core.options.own_component}
    sure? = not Collisions.suspected?(core, at)
    {reports, outputs} = Reports.message(core.reports, component, message, own, at, sure?)
    outputs({%{core | reports: reports}, actions}, outputs, at)
  end

  @doc "The vehicle's own event definitions."
  @spec definitions(Core.t(), Reports.Definitions.t()) :: Core.t()
  def definitions(core, own), do: %{core | reports: Reports.define(core.reports, own)}

  @doc "Complete texts."
  @spec texts(acc(), [StatusText.text()]) :: acc()
  def texts(acc, texts) do
    Enum.reduce(texts, acc, fn text, {core, actions} ->
      text({%{core | reports: Reports.text(core.reports, text)}, actions}, text)
    end)
  end

  defp text({%{component: component} = core, actions}, %{source: component} = text) do
    observe = Effects.observation(core, :text, text.at, Map.take(text, [:severity, :text]))
    core = if StatusTexts.may_act?(text.text), do: Effects.settle(core, :text, text.at), else: core
    arming({core, [observe | actions]}, text)
  end

  # A part of the vehicle is heard, and says nothing about the autopilot's state (H2).
  defp text({core, actions}, text) do
    data = %{severity: text.severity, text: text.text, component: text.source}
    {core, [Effects.observation(core, :part_text, text.at, data) | actions]}
  end

  # SYS_STATUS says when nothing keeps it from being armed any more.
  defp arming({core, _actions} = acc, %{text: "Arming disabled: " <> names} = text) do
    checks = for name <- String.split(names, ", "), do: %{id: nil, name: name, severity: text.severity}
    if Firmware.telemetry(core.state.autopilot).arming_texts?, do: checks(acc, checks, text.at), else: acc
  end

  defp arming(acc, _text), do: acc

  defp checks({core, actions}, checks, at) do
    core = %{core | state: State.put(core.state, :health, %{arming_checks: checks}, at)}
    {core, actions} = Effects.sample({core, actions}, :health, at)
    Effects.check_digest(core, actions, at)
  end

  @doc "Does what is due at `now`."
  @spec expire(acc(), integer()) :: acc()
  def expire({core, actions}, now) do
    {reports, outputs} = Reports.expire(core.reports, now)
    {core, actions} = outputs({%{core | reports: reports}, actions}, outputs, now)
    if ask?(core, now), do: ask(core, actions, now), else: {core, actions}
  end

  defp ask?(%{options: options, status: status} = core, now),
    do:
      options.request_streams and status == :online and Reports.missing?(core.reports) and
        Services.requests?(core, now) and not Collisions.suspected?(core, now)

  defp ask(core, actions, now) do
    {reports, requests} = Reports.requests(core.reports, core.options.system_id, now)
    sent = for request <- Enum.reverse(requests), do: {:send, request, core.version}
    {%{core | reports: reports}, sent ++ actions}
  end

  defp outputs(acc, outputs, at), do: Enum.reduce(outputs, acc, &output(&1, &2, at))

  defp output({:new, report}, acc, at) do
    {core, actions} = describe(acc, report, at)
    fresh? = fresh?(core, report)
    actions = if fresh?, do: [{:reported, report} | actions], else: actions

    if Px4Reports.known?(report.name) and fresh? do
      data = %{name: report.name, values: report.values, where: Detector.Digest.position(core.state)}
      observation = Observation.new(:px4_report, at, report.boot_ms, data)
      {Effects.settle(core, :report, at), [{:observe, observation} | actions]}
    else
      {core, actions}
    end
  end

  defp output({:report, report}, {core, actions}, at) do
    hex = Reports.hex(report)
    late_us = late(core, report, at)

    data = %{
      "id" => hex.id,
      "name" => report.name,
      "severity" => report.severity,
      "internal_severity" => report.internal,
      "arguments" => hex.arguments,
      "values" => report.values,
      "component" => report.component,
      "sequence" => report.sequence
    }

    data = if late_us > 0, do: Map.put(data, "late_s", Float.round(late_us / 1_000_000, 1)), else: data
    observation = Observation.new(:report, report.at - late_us, report.boot_ms, data, report.at)
    {%{core | dirty: true}, [{:observe, observation} | actions]}
  end

  defp output({:checks, list}, acc, at) do
    checks =
      for report <- list, do: %{id: Reports.hex(report).id, name: report.name, severity: report.severity}

    checks(acc, checks, at)
  end

  # With its first event since its boot, the autopilot is asked what it says about its events.
  defp describe(
         {%{reports: %{asked?: false}, component: component} = core, actions},
         %{component: component},
         at
       ) do
    if core.options.request_streams and Services.requests?(core, at) and not Collisions.suspected?(core, at),
      do: {%{core | reports: %{core.reports | asked?: true}}, [:describe_events | actions]},
      else: {core, actions}
  end

  defp describe(acc, _report, _at), do: acc

  # How long after the event the report came, by the autopilot's clock.
  defp late(%{component: component, state: %{boot_ms: boot_ms}}, %{component: component} = report, now)
       when is_integer(boot_ms) do
    late_us = report.at - (now - (boot_ms - report.boot_ms) * 1000)
    if late_us in @late_us..@max_late_us, do: late_us, else: 0
  end

  defp late(_core, _report, _now), do: 0

  # A report that was requested after a long gap tells what was, not what is.
  defp fresh?(%{state: %{boot_ms: now}}, %{boot_ms: then}) when is_integer(now), do: now - then <= @fresh_ms
  defp fresh?(_core, _report), do: true
end
