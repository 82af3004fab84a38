defmodule Aerie.Protocol.Px4.Calibration do
  @moduledoc """
  Calibration as PX4 does it: PREFLIGHT_CALIBRATION is accepted at once, and texts that begin with `[cal]` report the rest: what to
  do, the progress, the result.
  """

  alias Aerie.Protocol.{Mavlink, Step, Vehicle}
  alias Aerie.Protocol.Mavlink.Commands
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @lasts_ms 300_000

  @doc "The steps of `calibrate` and `calibrate_cancel`."
  @spec steps(String.t(), map()) :: [Step.t()] | {:error, String.t()}
  def steps("calibrate", %{sensor: "compass_motor"}),
    do: {:error, "PX4 has no calibration of compass and motors"}

  # PX4 sends no texts about these.
  def steps("calibrate", %{sensor: sensor}) when sensor in ["rc", "barometer"],
    do: [Commands.preflight(sensor, [])]

  def steps("calibrate", %{sensor: sensor}) do
    [
      Commands.preflight(sensor,
        confirm: :told,
        watch: :texts,
        within_ms: @lasts_ms,
        cancel: {:long, MavCmd.value(:MAV_CMD_PREFLIGHT_CALIBRATION), [0, 0, 0, 0, 0, 0, 0]}
      )
    ]
  end

  # It must not wait for the calibration that it cancels.
  def steps("calibrate_cancel", _params),
    do: [Mavlink.long(:MAV_CMD_PREFLIGHT_CALIBRATION, %{}, urgent?: true)]

  @doc "What a text says about the calibration under way."
  @spec read(Step.t(), struct(), Aerie.Protocol.source(), Vehicle.t()) :: Aerie.Protocol.answer()
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

  def read(_step, _message, _source, _vehicle), do: :ignore

  defp share(percent) do
    case Integer.parse(percent) do
      {n, _rest} when n in 0..100 -> n / 100
      _odd -> nil
    end
  end
end
