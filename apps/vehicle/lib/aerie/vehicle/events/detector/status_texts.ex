defmodule Aerie.Vehicle.Events.Detector.StatusTexts do
  @moduledoc """
  Reads from status texts of ArduPilot and PX4 what no message field shows: why a failsafe began, that the ground station was
  lost, that a fence was broken, that a mission is over.

  A pre-arm complaint is none of these, whatever it is about.
  """

  @reasons [
    {"gcs", ~r/\bgcs\b|ground (control )?station|data ?link/i},
    # ArduPlane's short and long failsafes are about the remote control; for the ground station it says GCS.
    {"rc", ~r/\b(radio|rc|manual control|throttle)\b.*(fail-?safe|lost|loss)|\b(short|long) fail-?safe/i},
    {"battery",
     ~r/batter(y|ies)\b.*(fail-?safe|low|critical|emergency|is )|(low|critical|emergency) battery/i},
    {"ekf", ~r/\b(ekf\d?|dead ?reckon(ing)?|position estimate|velocity estimate|attitude estimate)\b/i},
    {"fence", ~r/fence/i},
    {"terrain", ~r/terrain/i},
    {"vibration", ~r/vibration/i},
    {"leak", ~r/leak/i},
    {"crash", ~r/crash/i},
    {"offboard", ~r/offboard/i}
  ]

  @about_failsafe ~r/fail-?safe|lost|loss|batter|emergency|critical|breach|violat|exceed|leak|crash|terminat|\bekf variance/i
  # Complaints about a plan ("Geofence violation for waypoint 19") are not failsafes either.
  @not_a_failsafe ~r/\A(pre-?arm|arm|preflight|mission|plan)\b|denied|cleared|regained|restored|recovered|reject|waypoint|\bwp\b|disabled|\boff\b/i
  # AP_BattMonitor::check_failsafes and the ekf_check of each vehicle say so when their failsafe begins. The vehicle's own text
  # about it may follow (ArduCopter) or not (Rover, ArduPlane).
  @battery_text ~r/\Abattery \d{1,2} is (low|critical)\b/i
  @ekf_text ~r/\Aekf variance\b/i
  @failsafe ~r/fail-?safe/i
  @over ~r/cleared|recovered|restored|\boff\b|ended/i
  @gcs ~r/\bgcs\b.*(fail-?safe|lost|loss)|lost connection to gcs|(ground (control )?station|data ?link).*(lost|loss)|failsafe.*\bgcs\b/i
  @gcs_back ~r/\bgcs\b.*(cleared|regained|restored|recovered|fail-?safe off)|(ground (control )?station|data ?link).*(regained|restored|recovered)/i
  @fence ~r/fence.*(breach|violat|exceed)|(breach|violat).*fence/i
  @rc ~r/\b(radio|rc|manual control|throttle)\b.*(fail-?safe|lost|loss)|\b(short|long) fail-?safe/i
  @rc_back ~r/\b(radio|rc|manual control|throttle)\b.*(cleared|regained|restored|recovered|fail-?safe off)|\b(short|long) fail-?safe (cleared|off)/i
  @kill ~r/\bkill(-| )?(switch)?\b.*\b(engaged|on)\b|motor ?e-?stop high/i
  @kill_off ~r/\bkill(-| )?(switch)?\b.*\b(disengaged|off)\b|motor ?e-?stop low/i
  @armed_by ~r/\A(armed|disarmed) by (?:an? |the )?([\w ]{1,40})\z/i
  # PX4's texts and reports use different words for the same thing; these are the reports'.
  @reported %{
    "external_command" => "command_external",
    "internal_command" => "command_internal",
    "auto_preflight_disarming" => "preflight_inaction"
  }
  @levels [
    {"emergency_battery_level", ~r/emergency/i},
    {"critical_battery_level", ~r/critical/i},
    {"low_battery_level", ~r/\blow\b/i}
  ]
  @mission ~r/\Amission:? (complete|finished)/i

  @typedoc "The type of a failsafe: a short word."
  @type reason :: String.t()

  @doc "The reason that a text about a failsafe names; `\"unknown\"` if none; nil for other texts."
  @spec failsafe(String.t()) :: reason() | nil
  def failsafe(text) do
    if text =~ @about_failsafe and not (text =~ @not_a_failsafe) do
      Enum.find_value(@reasons, "unknown", &named(&1, text))
    end
  end

  @doc "Whether the vehicle may do something because of what a text says."
  @spec may_act?(String.t()) :: boolean()
  def may_act?(text), do: activation(text) != nil or fence?(text)

  @doc """
  Whether a text says that a failsafe of some type begins or is over; `:announces` if the vehicle may say more about it in a
  second text; nil for other texts.
  """
  @spec activation(String.t()) :: {:announces | :begins | :over, reason()} | nil
  def activation(text) do
    cond do
      text =~ @battery_text -> {:announces, "battery"}
      text =~ @ekf_text -> {:announces, "ekf"}
      not (text =~ @failsafe) or text =~ ~r/\A(pre-?arm|arm|preflight)\b/i -> nil
      text =~ @over -> {:over, Enum.find_value(@reasons, "unknown", &named(&1, text))}
      reason = failsafe(text) -> {:begins, reason}
      true -> nil
    end
  end

  @doc "The reason more precisely, if the text says more: how low a battery is, in PX4's words."
  @spec precisely(reason(), String.t()) :: String.t()
  def precisely("battery", text), do: Enum.find_value(@levels, "battery", &named(&1, text))
  def precisely(reason, _text), do: reason

  @doc """
  What a text says that the vehicle does: `%{action: \"hold\", delay: seconds}` if PX4 waits before it acts, the action alone for
  ArduPlane ("RC Long Failsafe On: switched to RTL").
  """
  @spec action(String.t()) :: %{optional(:action) => String.t(), optional(:delay) => pos_integer()}
  def action(text) do
    case Regex.run(~r/entering hold for (\d{1,4}) seconds|: switched to (?:mode )?(\w{1,16})/i, text) do
      [_all, seconds] -> %{action: "hold", delay: String.to_integer(seconds)}
      [_all, "", mode] -> %{action: String.downcase(mode)}
      nil -> %{}
    end
  end

  defp named({reason, pattern}, text), do: if(text =~ pattern, do: reason)

  @doc "Whether the text says that the remote control is lost or back."
  @spec rc(String.t()) :: :lost | :back | nil
  def rc(text) do
    cond do
      text =~ ~r/\A(pre-?arm|arm|preflight)\b|denied/i -> nil
      text =~ @rc_back -> :back
      text =~ @rc -> :lost
      true -> nil
    end
  end

  @doc "Whether the text says that the kill switch is engaged (true) or released (false); nil for other texts."
  @spec kill(String.t()) :: boolean() | nil
  def kill(text) do
    cond do
      text =~ ~r/\A(pre-?arm|arm|preflight)\b|denied/i -> nil
      text =~ @kill_off -> false
      text =~ @kill -> true
      true -> nil
    end
  end

  @doc "The cause of arming or disarming, if the text names it: `{armed?, reason}`."
  @spec armed_by(String.t()) :: {boolean(), String.t()} | nil
  def armed_by(text) do
    case Regex.run(@armed_by, text) do
      [_all, what, who] ->
        word = who |> String.downcase() |> String.replace(" ", "_")
        {String.downcase(what) == "armed", Map.get(@reported, word, word)}

      nil ->
        nil
    end
  end

  @doc "Whether the text says that the ground station is lost or back."
  @spec gcs(String.t()) :: :lost | :back | nil
  def gcs(text) do
    cond do
      text =~ ~r/\A(pre-?arm|preflight)\b/i -> nil
      text =~ @gcs_back -> :back
      text =~ @gcs -> :lost
      true -> nil
    end
  end

  @doc "Whether the text says that a fence was broken."
  @spec fence?(String.t()) :: boolean()
  def fence?(text), do: text =~ @fence and not (text =~ @not_a_failsafe)

  @doc "Whether the text says that the mission is over."
  @spec mission_completed?(String.t()) :: boolean()
  def mission_completed?(text), do: text =~ @mission
end
