defmodule Aerie.Vehicle.Detector.Reported do
  @moduledoc """
  What PX4's reports (EVENT) begin and end: failsafes with cause and action, a lost ground station or remote control, the kill
  switch, who armed. Others are no more than reports.

  They come at once and also while no ground station is there, for whom PX4 holds its texts back.
  """

  alias Aerie.Vehicle.Detector
  alias Aerie.Vehicle.Detector.Failsafe

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

  @doc "Whether a report is one that is looked at here."
  @spec about?(String.t() | nil) :: boolean()
  def about?(name), do: name in @names

  @doc "One step."
  @spec observe(Detector.t(), String.t(), list() | nil, Detector.moment()) ::
          {Detector.t(), [Detector.step()]}
  def observe(detector, name, values, moment) when name in @enter and is_list(values) do
    {action, delay, cause} = entered(name, values)

    if action in ["none", "warn"],
      do: {detector, []},
      else: enter(detector, %{by: :report, report: name, action: action, delay: delay}, cause, moment)
  end

  def observe(detector, "commander_gcs_lost" = name, _values, {at, _, _}) do
    steps = if detector.gcs, do: [], else: [{"gcs_failsafe", %{"text" => nil, "report" => name}, gcs: true}]
    {%{said(detector, at, "gcs", "gcs_connection_loss") | gcs_reported: at}, steps}
  end

  def observe(detector, "commander_dl_regained", _values, _moment), do: {%{detector | gcs: false}, []}

  def observe(detector, "commander_rc_lost", _values, {at, _, _}),
    do: detector |> said(at, "rc", "manual_control_loss") |> Detector.Losses.rc(:lost, nil, at)

  def observe(detector, "commander_rc_regained", _values, {at, _, _}),
    do: Detector.Losses.rc(detector, :back, nil, at)

  # The pilot took over by stick.
  def observe(detector, "failsafe_rc_override", _values, moment) do
    {failsafe, steps} = Failsafe.cleared(detector.failsafe, :all, "report", detector.last, moment)
    {%{detector | failsafe: failsafe}, steps}
  end

  def observe(detector, "commander_kill_sw_engaged", _values, _moment),
    do: Detector.Losses.kill(detector, true, nil)

  def observe(detector, "commander_kill_sw_disengaged", _values, _moment),
    do: Detector.Losses.kill(detector, false, nil)

  def observe(detector, "commander_armed_by", [reason], {at, _, _}),
    do: {%{detector | armed_by: {at, true, reason}}, []}

  def observe(detector, "commander_disarmed_by", [reason], {at, _, _}),
    do: {%{detector | armed_by: {at, false, reason}}, []}

  def observe(detector, _name, _values, _moment), do: {detector, []}

  defp entered("commander_failsafe_enter", [_mode, action, cause]), do: {word(action), nil, cause}

  defp entered("commander_failsafe_enter_hold", [_mode, action, delay, cause]),
    do: {word(action), delay, cause}

  defp entered("commander_failsafe_enter_generic_hold", [_mode, action, delay]),
    do: {word(action), delay, nil}

  defp entered(_generic, [_mode, action | _]), do: {word(action), nil, nil}

  defp enter(detector, facts, cause, {at, _, _} = moment) do
    {type, reason} = cause(detector, cause, at)
    facts = Map.merge(facts, %{type: type, reason: reason})
    {failsafe, steps} = Failsafe.begins(detector.failsafe, facts, detector.last, moment)
    {%{detector | failsafe: failsafe}, steps}
  end

  # PX4 1.18 gives the loss of manual control as the cause of a broken fence too: what was said last counts.
  defp cause(detector, "manual_control_loss" = cause, at),
    do: Failsafe.last_said(detector.failsafe, at, ["rc", "fence"]) || {"rc", cause}

  defp cause(_detector, cause, _at) when is_map_key(@causes, cause), do: {@causes[cause], cause}

  defp cause(detector, _generic, at) do
    {type, reason, _text} = Failsafe.why(detector.failsafe, at, Detector.Losses.troubles(detector))
    {type, reason}
  end

  defp said(detector, at, type, reason),
    do: %{detector | failsafe: Failsafe.said(detector.failsafe, at, type, reason)}

  # A value without a label.
  defp word(value) when is_binary(value), do: value
  defp word(value), do: to_string(value)
end
