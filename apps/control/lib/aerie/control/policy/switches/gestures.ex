defmodule Aerie.Control.Policy.Switches.Gestures do
  @moduledoc """
  What a pilot's sticks do when they are held in a corner: yaw with the throttle down arms (ArduPilot's ARMING_RUDDER,
  PX4's MAN_ARM_GESTURE), and all
  four sticks down and apart kill PX4's motors where MAN_KILL_GEST_T is set (`ManualControl::processStickArming`).

  Which channel is which stick, and which end of it is low, depends on parameters and calibration: a channel of the
  first four counts as far out at
  either end.
  """

  alias Aerie.Control.Policy.{Intent, Switches}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Firmware

  # Beyond these a stick counts as far out: of a channel in µs, of an axis in thousandths.
  @pulses 1_250..1_750
  @yaw 700
  @down 200
  @kill 850
  @sticks 1..4

  @doc "The gestures that an override, of these channels, or a joystick may make."
  @spec effects(map(), Context.t()) :: [Switches.effect()]
  def effects(%{channels: channels, axes: axes}, context) do
    sticks = for n <- @sticks, is_map_key(channels, n), do: channels[n]
    out = Enum.count(sticks, &(&1 not in @pulses))
    # The others are where the pilot has them.
    possibly_out = if out > 0, do: out + 4 - length(sticks), else: 0

    arms =
      if arms?(axes) or possibly_out >= 2,
        do: [{"the sticks arm it when they are held there", Intent.named("arm")}],
        else: []

    kill? =
      Firmware.reading(context.autopilot).kill_gesture? and not disabled?(context.params) and
        (kills?(axes) or possibly_out == 4)

    if kill?,
      do: [
        {"sticks that are all in their corners stop its motors (MAN_KILL_GEST_T)", Intent.named("terminate")}
        | arms
      ],
      else: arms
  end

  defp disabled?(%{"MAN_KILL_GEST_T" => seconds}), do: seconds <= 0
  defp disabled?(_not_known), do: false

  defp arms?(%{throttle: throttle, yaw: yaw}) when is_integer(yaw),
    do: abs(yaw) >= @yaw and (throttle || 0) <= @down

  defp arms?(_no_yaw), do: false

  # PX4 takes no notice of one that is missing.
  defp kills?(%{throttle: throttle, yaw: yaw, pitch: pitch, roll: roll})
       when is_integer(throttle) and is_integer(yaw) and is_integer(pitch) and is_integer(roll),
       do: throttle <= @down and yaw <= -@kill and pitch <= -@kill and roll >= @kill

  defp kills?(_incomplete), do: false
end
