defmodule Aerie.Vehicle.Events.Detector.Failsafe.Px4Reports do
  @moduledoc """
  PX4's reports (EVENT) that begin or end something: failsafes with cause and action, a lost ground station or remote control,
  the kill switch, who armed.

  They come at once, even without a ground station, until which PX4 holds its texts back.
  """

  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.{Failsafe, Losses, Step}

  @causes %{
    "manual_control_loss" => "rc",
    "gcs_connection_loss" => "gcs",
    "low_battery_level" => "battery",
    "critical_battery_level" => "battery",
    "emergency_battery_level" => "battery",
    "low_remaining_flight_time" => "battery"
  }
  @enter ~w(commander_failsafe_enter commander_failsafe_enter_hold commander_failsafe_enter_generic
            commander_failsafe_enter_generic_hold commander_failsafe_enter_autopilot_disengaged)
  @names @enter ++
           ~w(commander_gcs_lost commander_dl_regained commander_rc_lost commander_rc_regained failsafe_rc_override
              commander_kill_sw_engaged commander_kill_sw_disengaged commander_armed_by commander_disarmed_by)

  @doc "Whether a report is one of these."
  @spec known?(String.t() | nil) :: boolean()
  def known?(name), do: name in @names

  @doc "The events that follow from a report and its values."
  @spec steps(Detector.t(), String.t(), list() | nil, Step.moment()) :: {Detector.t(), [Step.t()]}
  def steps(detector, name, values, moment) when name in @enter and is_list(values) do
    {action, delay, cause} = entered(name, values)

    if action in ["none", "warn"],
      do: {detector, []},
      else: enter(detector, %{by: :report, report: name, action: action, delay: delay}, cause, moment)
  end

  def steps(detector, "commander_gcs_lost" = name, _values, %{at: at}) do
    event = Step.event("gcs_failsafe", %{"text" => nil, "report" => name}, gcs_failsafe: true)

    {%{hint(detector, at, "gcs", "gcs_connection_loss") | gcs_reported_at: at},
     if(detector.gcs_failsafe, do: [], else: [event])}
  end

  def steps(detector, "commander_dl_regained", _values, _moment), do: {%{detector | gcs_failsafe: false}, []}

  def steps(detector, "commander_rc_lost", _values, %{at: at}),
    do: detector |> hint(at, "rc", "manual_control_loss") |> Losses.rc(:lost, nil, at)

  def steps(detector, "commander_rc_regained", _values, %{at: at}),
    do: Losses.rc(detector, :back, nil, at)

  # The pilot took over with the sticks.
  def steps(detector, "failsafe_rc_override", _values, moment) do
    {failsafe, steps} = Failsafe.clear(detector.failsafe, :all, "report", detector.last, moment)
    {%{detector | failsafe: failsafe}, steps}
  end

  def steps(detector, "commander_kill_sw_engaged", _values, %{at: at}),
    do: Losses.kill(detector, true, nil, at)

  def steps(detector, "commander_kill_sw_disengaged", _values, %{at: at}),
    do: Losses.kill(detector, false, nil, at)

  def steps(detector, "commander_armed_by", [reason], %{at: at}),
    do: {%{detector | armed_by: {at, true, reason}}, []}

  def steps(detector, "commander_disarmed_by", [reason], %{at: at}),
    do: {%{detector | armed_by: {at, false, reason}}, []}

  def steps(detector, _name, _values, _moment), do: {detector, []}

  defp entered("commander_failsafe_enter", [_mode, action, cause]), do: {label(action), nil, cause}

  defp entered("commander_failsafe_enter_hold", [_mode, action, delay, cause]) when is_number(delay),
    do: {label(action), delay, cause}

  defp entered("commander_failsafe_enter_generic_hold", [_mode, action, delay]) when is_number(delay),
    do: {label(action), delay, nil}

  # The vehicle's own file may have other arguments.
  defp entered(_generic, [_mode, action | _]), do: {label(action), nil, nil}
  defp entered(_generic, _fewer), do: {"unknown", nil, nil}

  defp enter(detector, facts, cause, %{at: at} = moment) do
    {type, reason} = cause(detector, cause, at)
    facts = Map.merge(facts, %{type: type, reason: reason})
    {failsafe, steps} = Failsafe.start(detector.failsafe, facts, detector.last, moment)
    {%{detector | failsafe: failsafe}, steps}
  end

  # PX4 1.18 also gives the loss of manual control as the cause when a fence is broken: the last hint counts.
  defp cause(detector, "manual_control_loss" = cause, at),
    do: Failsafe.last_hint(detector.failsafe, at, ["rc", "fence"]) || {"rc", cause}

  defp cause(_detector, cause, _at) when is_map_key(@causes, cause), do: {@causes[cause], cause}

  defp cause(detector, _generic, at) do
    {type, reason, _text} = Failsafe.why(detector.failsafe, at, Losses.troubles(detector))
    {type, reason}
  end

  defp hint(detector, at, type, reason),
    do: %{detector | failsafe: Failsafe.hint(detector.failsafe, at, type, reason)}

  defp label(value) when is_binary(value), do: value
  # A number that has no label.
  defp label(value) when is_number(value), do: to_string(value)
  defp label(_other), do: "unknown"
end
