defmodule Aerie.Vehicle.Events.Detector.TextConditions do
  @moduledoc """
  What follows from a status text: a failsafe, a lost ground station or remote control, a broken fence, the kill
  switch, a completed mission, who armed.
  """

  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.{Failsafe, Losses, StatusTexts, Step}

  # A report about arming is more precise than a text that comes within this time.
  @reported_us 1_000_000

  @spec steps(Detector.t(), String.t(), Step.moment()) :: {Detector.t(), [Step.t()]}
  def steps(detector, text, %{at: at} = moment) do
    detector = detector |> hint(text, at) |> armed_by(text, at)
    {detector, gcs} = gcs(detector, text)
    {detector, losses} = losses(detector, text, at)
    {detector, failsafe} = failsafe(detector, text, moment)
    {detector, fence} = fence(detector, text, moment)
    {detector, gcs ++ losses ++ failsafe ++ fence ++ mission(detector, text)}
  end

  # The text may name the cause of a failsafe. A general "failsafe activated" does not replace a cause named just
  # before.
  defp hint(detector, text, at) do
    case StatusTexts.failsafe(text) do
      nil ->
        detector

      type ->
        {known, _reason, _text} = Failsafe.why(detector.failsafe, at, [])
        reason = StatusTexts.precisely(type, text)

        if type == "unknown" and known != "unknown",
          do: detector,
          else: %{detector | failsafe: Failsafe.hint(detector.failsafe, at, type, reason, text)}
    end
  end

  # Only for vehicles that send no report about it; texts may be late.
  defp gcs(%{gcs_reported_at: nil} = detector, text) do
    case {StatusTexts.gcs(text), detector.gcs_failsafe} do
      {:lost, false} -> {%{detector | gcs_failsafe: true}, [Step.event("gcs_failsafe", %{"text" => text})]}
      {:back, true} -> {%{detector | gcs_failsafe: false}, []}
      _nothing_new -> {detector, []}
    end
  end

  defp gcs(detector, _text), do: {detector, []}

  # The reports say it at once; PX4 may have held the texts back until a ground station was there.
  defp losses(%{reports: true} = detector, _text, _at), do: {detector, []}

  defp losses(detector, text, at) do
    {detector, rc} = Losses.rc(detector, StatusTexts.rc(text), text, at)
    {detector, kill} = Losses.kill(detector, StatusTexts.kill(text), text, at)
    {detector, rc ++ kill}
  end

  defp armed_by(detector, text, at) do
    case StatusTexts.armed_by(text) do
      {armed, reason}
      when not is_tuple(detector.armed_by) or at - elem(detector.armed_by, 0) > @reported_us ->
        %{detector | armed_by: {at, armed, reason}}

      _nothing_or_reported ->
        detector
    end
  end

  defp failsafe(detector, text, moment) do
    facts = Detector.facts(detector)

    {failsafe, steps} =
      case StatusTexts.activation(text) do
        # The report says more (`Detector.Failsafe.Px4Reports`).
        {begins, _type} when begins != :over and detector.reports ->
          {detector.failsafe, []}

        # ArduPilot says so of an armed vehicle; disarmed it has nothing to act on.
        {:announces, _type} when facts.armed == false ->
          {detector.failsafe, []}

        {begins, type} when begins != :over ->
          named = %{by: :text, type: type, reason: StatusTexts.precisely(type, text), text: text}
          named = named |> Map.merge(StatusTexts.action(text)) |> with_cause(detector, moment.at)
          named = if begins == :announces, do: Map.put(named, :more, true), else: named
          Failsafe.start(detector.failsafe, named, facts, moment)

        {:over, type} ->
          Failsafe.clear(detector.failsafe, {:type, type}, "text", facts, moment)

        nil ->
          {detector.failsafe, []}
      end

    {%{detector | failsafe: failsafe}, steps}
  end

  # "Failsafe activated": the cause was named just before.
  defp with_cause(%{type: "unknown"} = facts, detector, at) do
    {type, reason, _text} = Failsafe.why(detector.failsafe, at, [])
    %{facts | type: type, reason: reason}
  end

  defp with_cause(facts, _detector, _at), do: facts

  defp fence(detector, text, moment) do
    if StatusTexts.fence?(text) do
      {detector, steps} = Losses.fence_acts(detector, nil, text, moment)
      {detector, fence_event(detector, text, moment.at) ++ steps}
    else
      {detector, []}
    end
  end

  # FENCE_STATUS and PX4's checks are better sources, if they come.
  defp fence_event(detector, text, at) do
    if Detector.fence_shown?(detector.last) or Detector.fence_reported?(detector, at),
      do: [],
      else: [Step.event("geofence", %{"text" => text}, fence_event_at: at, fence_open: {at, nil})]
  end

  defp mission(detector, text) do
    last = detector.last[:mission_seq] || :unknown

    if detector.mission_completed == nil and StatusTexts.mission_completed?(text),
      do: [Step.event("mission.completed", %{"text" => text}, mission_completed: last)],
      else: []
  end
end
