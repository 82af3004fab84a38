defmodule Aerie.Vehicle.Detector.Texts do
  @moduledoc """
  What status texts of ArduPilot and PX4 say about things that no message field shows: why a failsafe came, that the
  ground station was lost, that a fence was broken, that a mission is over.

  A pre-arm complaint is none of these, whatever it is about.
  """

  @reasons [
    {"gcs", ~r/\bgcs\b|ground (control )?station|data ?link/i},
    {"rc", ~r/\b(radio|rc|manual control|throttle)\b.*(fail-?safe|lost|loss)/i},
    {"battery",
     ~r/batter(y|ies)\b.*(fail-?safe|low|critical|emergency|is )|(low|critical|dangerously low) battery/i},
    {"ekf", ~r/\b(ekf|dead ?reckoning|position estimate|velocity estimate|attitude estimate)\b/i},
    {"fence", ~r/fence/i},
    {"terrain", ~r/terrain/i},
    {"vibration", ~r/vibration/i},
    {"leak", ~r/leak/i},
    {"crash", ~r/crash/i},
    {"offboard", ~r/offboard/i}
  ]

  @about_failsafe ~r/fail-?safe|lost|loss|batter|emergency|critical|breach|violat|leak|crash|terminat/i
  @not_a_failsafe ~r/\A(pre-?arm|arm|preflight)\b|denied|cleared|regained|restored|recovered/i
  @gcs ~r/\bgcs\b.*(fail-?safe|lost|loss)|lost connection to gcs|(ground (control )?station|data ?link).*(lost|loss)|failsafe.*\bgcs\b/i
  @gcs_back ~r/\bgcs\b.*(cleared|regained|restored|recovered)|(ground (control )?station|data ?link).*(regained|restored|recovered)/i
  @fence ~r/fence.*(breach|violat|exceed)|(breach|violat).*fence/i
  @mission ~r/\Amission:? (complete|finished)/i

  @typedoc "The reason of a failsafe as a short word."
  @type reason :: String.t()

  @doc "What a text that has to do with a failsafe names as its reason; `\"unknown\"` if none; nil for other texts."
  @spec failsafe(String.t()) :: reason() | nil
  def failsafe(text) do
    if text =~ @about_failsafe and not (text =~ @not_a_failsafe) do
      Enum.find_value(@reasons, "unknown", fn {reason, pattern} -> if text =~ pattern, do: reason end)
    end
  end

  @doc "Whether the vehicle says that it lost its ground station, or has it back."
  @spec gcs(String.t()) :: :lost | :back | nil
  def gcs(text) do
    cond do
      text =~ ~r/\A(pre-?arm|preflight)\b/i -> nil
      text =~ @gcs_back -> :back
      text =~ @gcs -> :lost
      true -> nil
    end
  end

  @doc "Whether the vehicle says that it left a fence."
  @spec fence?(String.t()) :: boolean()
  def fence?(text), do: text =~ @fence and not (text =~ @not_a_failsafe)

  @doc "Whether the vehicle says that its mission is over."
  @spec mission_completed?(String.t()) :: boolean()
  def mission_completed?(text), do: text =~ @mission
end
