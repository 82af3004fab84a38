defmodule Aerie.Vehicle.Firmware.Px4.Calibration do
  @moduledoc """
  Calibration as PX4 does it: PREFLIGHT_CALIBRATION is accepted at once, and texts that begin with `[cal]` report the rest: what to
  do, the progress, the result.
  """

  alias Aerie.Vehicle.Protocol.{Mavlink, Step, Vehicle}
  alias Aerie.Vehicle.Protocol.Mavlink.Commands
  alias MavCodec.Enums.{MavCmd, MavResult}
  alias MavCodec.Messages, as: M

  @lasts_ms 300_000
  @preflight MavCmd.value(:MAV_CMD_PREFLIGHT_CALIBRATION)
  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)

  @doc "The steps of `calibrate` and `calibrate_cancel`."
  @spec steps(String.t(), map(), Vehicle.t()) :: [Step.t()] | {:gap | :error, String.t()}
  def steps("calibrate", %{sensor: "compass_motor"}, _vehicle),
    do: {:gap, "PX4 has no calibration of compass and motors"}

  # PX4 sends no texts about these.
  def steps("calibrate", %{sensor: sensor}, _vehicle) when sensor in ["rc", "barometer"],
    do: [Commands.preflight(sensor, [])]

  def steps("calibrate", %{sensor: sensor}, _vehicle) do
    [
      Commands.preflight(sensor,
        confirm: :told,
        watch: :texts,
        within_ms: @lasts_ms,
        cancel: {:long, @preflight, [0, 0, 0, 0, 0, 0, 0]}
      )
    ]
  end

  # The worker of a calibration looks for it between two readings, and then at the last command only that came
  # (calibrate_cancel_check in calibration_routines.cpp): it is sent until a text says that it was seen. It does not wait for
  # the calibration that it cancels.
  def steps("calibrate_cancel", _params, %{armed: true}),
    do: {:error, "it is armed, and PX4 calibrates nothing then"}

  def steps("calibrate_cancel", _params, _vehicle) do
    [
      Mavlink.long(:MAV_CMD_PREFLIGHT_CALIBRATION, %{},
        key: {nil, :calibrate_cancel},
        ends: {nil, {:command, @preflight}},
        acked?: false,
        confirm: :told,
        watch: :cancel,
        answer_ms: 3_000
      )
    ]
  end

  @doc "The verdict of a text on the calibration under way."
  @spec read(Step.t(), struct(), Aerie.Vehicle.Protocol.source(), Vehicle.t()) ::
          Aerie.Vehicle.Protocol.answer()
  def read(%Step{watch: :texts}, %M.Statustext{text: "[cal] " <> text}, {system, _component}, %{
        system: system
      }) do
    case String.trim(text) do
      "calibration done" <> _sensor -> :done
      "calibration failed" <> _why = text -> {:failed, text}
      "calibration cancelled" <> _rest -> :cancelled
      "progress <" <> percent -> {:progress, share(percent), nil}
      prompt -> {:progress, nil, prompt}
    end
  end

  def read(%Step{watch: :cancel}, %M.Statustext{text: "[cal] calibration " <> text}, {system, _component}, %{
        system: system
      }) do
    if String.starts_with?(text, ["cancelled", "done", "failed"]), do: :done, else: :ignore
  end

  # Commander accepts it if nothing is calibrated, and answers TEMPORARILY_REJECTED while something is; the text comes later.
  def read(%Step{watch: :cancel}, %M.CommandAck{command: @preflight} = ack, {system, _component}, %{
        system: system
      }) do
    if ack.result == @accepted, do: {:accepted, "it calibrated nothing"}, else: :ignore
  end

  def read(_step, _message, _source, _vehicle), do: :ignore

  @doc "The ids of the messages that `read/4` wants besides texts."
  @spec listens(Step.t()) :: [non_neg_integer()]
  def listens(%Step{watch: :cancel}), do: [M.CommandAck.id()]
  def listens(_step), do: []

  defp share(percent) do
    case Integer.parse(percent) do
      {n, _rest} when n in 0..100 -> n / 100
      _odd -> nil
    end
  end
end
