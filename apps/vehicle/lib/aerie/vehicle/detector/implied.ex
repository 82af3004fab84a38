defmodule Aerie.Vehicle.Detector.Implied do
  @moduledoc """
  What a status text means beside its words: a failsafe, a lost ground station or remote control, a broken fence, the kill
  switch, a mission that is over, who armed. A part of the detector.
  """

  alias Aerie.Vehicle.Detector
  alias Aerie.Vehicle.Detector.{Failsafe, Losses, Texts}

  @doc "One text."
  @spec events(Detector.t(), String.t(), Detector.moment()) :: {Detector.t(), [Detector.step()]}
  def events(detector, text, {at, _, _} = moment) do
    detector = detector |> noted(text, at) |> armed_by(text, at)
    {detector, gcs} = gcs(detector, text)
    {detector, rc} = Losses.rc(detector, Texts.rc(text), text, at)
    {detector, kill} = Losses.kill(detector, Texts.kill(text), text)
    {detector, failsafe} = failsafe(detector, text, moment)
    {detector, gcs ++ rc ++ kill ++ failsafe ++ fence(detector, text, at) ++ mission(detector, text)}
  end

  # What may be the cause of a failsafe. A general "failsafe activated" does not replace what was said just before it.
  defp noted(detector, text, at) do
    reason = Texts.failsafe(text)

    if reason == nil or
         (reason == "unknown" and Failsafe.why(detector.failsafe, at, []) |> elem(0) != "unknown"),
       do: detector,
       else: %{
         detector
         | failsafe: Failsafe.said(detector.failsafe, at, reason, Texts.precisely(reason, text), text)
       }
  end

  # A vehicle that reports it says it then, and not when its texts come.
  defp gcs(%{gcs_reported: nil} = detector, text) do
    case {Texts.gcs(text), detector.gcs} do
      {:lost, false} -> {%{detector | gcs: true}, [{"gcs_failsafe", %{"text" => text}, []}]}
      {:back, true} -> {%{detector | gcs: false}, []}
      _nothing_new -> {detector, []}
    end
  end

  defp gcs(detector, _text), do: {detector, []}

  defp armed_by(detector, text, at) do
    case Texts.armed_by(text) do
      {armed, reason} when not is_tuple(detector.armed_by) or at - elem(detector.armed_by, 0) > 1_000_000 ->
        %{detector | armed_by: {at, armed, reason}}

      _nothing_or_reported ->
        detector
    end
  end

  defp failsafe(detector, text, moment) do
    facts = Detector.facts(detector)

    {failsafe, steps} =
      case Texts.activation(text) do
        # Who reports it says more with that (`Detector.Reported`); the text is the same once more.
        {:begins, _type} when detector.reports ->
          {detector.failsafe, []}

        {:begins, type} ->
          said = %{by: :text, type: type, reason: Texts.precisely(type, text), text: text}
          said = said |> Map.merge(Texts.hold(text)) |> named(detector, elem(moment, 0))
          Failsafe.begins(detector.failsafe, said, facts, moment)

        {:over, type} ->
          Failsafe.cleared(detector.failsafe, {:type, type}, "text", facts, moment)

        nil ->
          {detector.failsafe, []}
      end

    {%{detector | failsafe: failsafe}, steps}
  end

  # "Failsafe activated": why was said just before.
  defp named(%{type: "unknown"} = said, detector, at) do
    {type, reason, _text} = Failsafe.why(detector.failsafe, at, [])
    %{said | type: type, reason: reason}
  end

  defp named(said, _detector, _at), do: said

  # FENCE_STATUS, or PX4's checks, know better, where they come.
  defp fence(detector, text, at) do
    told? =
      is_map_key(detector.last, :fence_breach) or is_map_key(detector.last, :fence_check) or
        Detector.fence_told?(detector, at)

    if not told? and Texts.fence?(text), do: [{"geofence", %{"text" => text}, fence: at}], else: []
  end

  defp mission(detector, text) do
    if detector.mission == nil and Texts.mission_completed?(text),
      do: [{"mission.completed", %{"text" => text}, mission: detector.last[:mission_seq] || :unknown}],
      else: []
  end
end
