defmodule Aerie.Vehicle.Firmware.Ardupilot.Calibration do
  @moduledoc """
  Calibration as ArduPilot does it. Gyros, level, barometer and airspeed block the firmware until they are done, and
  are then answered. For the accelerometer the vehicle asks in texts for each position, which `calibrate_position` confirms;
  magnetometers report progress and result, and wait for `calibrate_accept`. Compass and motors are calibrated, armed, until
  any acknowledgement comes, of which command does not matter (ArduCopter/compassmot.cpp).
  """

  alias Aerie.Vehicle.Protocol.{Mavlink, Step, Vehicle}
  alias Aerie.Vehicle.Protocol.Mavlink.Commands
  alias MavCodec.Enums.{MagCalStatus, MavCmd}
  alias MavCodec.Messages, as: M

  # ACCELCAL_VEHICLE_POS
  @positions %{"level" => 1, "left" => 2, "right" => 3, "nose_down" => 4, "nose_up" => 5, "back" => 6}
  @blocks_ms 30_000
  @lasts_ms 300_000
  @stop_ms 5_000
  @no_cancel "ArduPilot cannot cancel the calibration of the accelerometer: confirm the positions that it asks for " <>
               "(calibrate_position), or reboot it"
  @mag_success MagCalStatus.value(:MAG_CAL_SUCCESS)

  @doc "The steps of `calibrate`, `calibrate_position`, `calibrate_accept` and `calibrate_cancel`."
  @spec steps(String.t(), map(), Vehicle.t()) :: [Step.t()] | {:gap | :error, String.t()}
  def steps("calibrate", %{sensor: "magnetometer"}, _vehicle) do
    # All magnetometers, with a retry after a failure, and without storing the result by itself.
    [
      Mavlink.long(:MAV_CMD_DO_START_MAG_CAL, %{1 => 0, 2 => 1, 3 => 0},
        confirm: :told,
        watch: :magnetometer,
        holds: "magnetometer",
        within_ms: @lasts_ms,
        cancel: {:long, MavCmd.value(:MAV_CMD_DO_CANCEL_MAG_CAL), [0, 0, 0, 0, 0, 0, 0]}
      )
    ]
  end

  def steps("calibrate", %{sensor: "rc"}, _vehicle),
    do: {:gap, "ArduPilot's remote control is calibrated by its parameters RCn_MIN, RCn_MAX and RCn_TRIM"}

  def steps("calibrate", %{sensor: "accelerometer" = sensor}, _vehicle),
    do: [Commands.preflight(sensor, confirmed_by_text(sensor) ++ [cancel: {:never, @no_cancel}])]

  def steps("calibrate", %{sensor: "compass_motor" = sensor}, _vehicle),
    do: [Commands.preflight(sensor, confirmed_by_text(sensor) ++ [cancel: {:message, acknowledgement()}])]

  def steps("calibrate", %{sensor: sensor}, _vehicle),
    do: [Commands.preflight(sensor, answer_ms: @blocks_ms)]

  def steps("calibrate_position", params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_ACCELCAL_VEHICLE_POS, %{1 => Map.fetch!(@positions, params.position)})]

  def steps("calibrate_accept", _params, _vehicle), do: [Mavlink.long(:MAV_CMD_DO_ACCEPT_MAG_CAL)]

  def steps("calibrate_cancel", _params, %{busy_with: "accelerometer"}), do: {:error, @no_cancel}

  def steps("calibrate_cancel", _params, %{busy_with: "compass_motor"}),
    do: [Mavlink.message(acknowledgement(), confirm: {:armed, false}, within_ms: @stop_ms)]

  def steps("calibrate_cancel", _params, %{busy_with: "magnetometer"}),
    do: [Mavlink.long(:MAV_CMD_DO_CANCEL_MAG_CAL)]

  # Somebody else may have begun one.
  def steps("calibrate_cancel", _params, _vehicle),
    do: [Mavlink.message(acknowledgement()), Mavlink.long(:MAV_CMD_DO_CANCEL_MAG_CAL)]

  defp confirmed_by_text(sensor), do: [confirm: :told, watch: :texts, holds: sensor, within_ms: @lasts_ms]

  # The accelerometer's takes only one of the commands 0 to 6 with TEMPORARILY_REJECTED for a position
  # (AP_AccelCal::handle_command_ack): this one does not disturb it.
  defp acknowledgement,
    do: %M.CommandAck{command: MavCmd.value(:MAV_CMD_PREFLIGHT_CALIBRATION), result: 0}

  @doc "The verdict of a text or a report on the calibration under way."
  @spec read(Step.t(), struct(), Aerie.Vehicle.Protocol.source(), Vehicle.t()) ::
          Aerie.Vehicle.Protocol.answer()
  def read(%Step{watch: :texts}, %M.Statustext{text: text}, {system, _component}, %{system: system}) do
    cond do
      text =~ ~r/calibration successful/i -> :done
      text =~ ~r/calibration failed|\Afailed\z/i -> {:failed, text}
      text =~ ~r/calibration cancelled/i -> :cancelled
      true -> {:progress, nil, text}
    end
  end

  def read(%Step{watch: :magnetometer}, %M.MagCalProgress{} = m, {system, _component}, %{system: system}),
    do: {:progress, min(m.completion_pct, 100) / 100, "magnetometer #{m.compass_id}"}

  def read(%Step{watch: :magnetometer}, %M.MagCalReport{} = m, {system, _component}, %{system: system}) do
    if m.cal_status == @mag_success,
      do: :done,
      else: {:failed, "magnetometer #{m.compass_id}: MAG_CAL_STATUS #{m.cal_status}"}
  end

  def read(_step, _message, _source, _vehicle), do: :ignore

  @doc "The ids of the messages that `read/4` wants."
  @spec listens(Step.t()) :: [non_neg_integer()]
  def listens(%Step{watch: :magnetometer}), do: [M.MagCalProgress.id(), M.MagCalReport.id()]
  def listens(_step), do: []
end
