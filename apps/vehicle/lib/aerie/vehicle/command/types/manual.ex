defmodule Aerie.Vehicle.Command.Types.Manual do
  @moduledoc """
  Commands that steer by hand or by a stream of set-points: rows of `Aerie.Vehicle.Command.Types`.

  The gateway repeats such a command to the vehicle for as long as `hold` says, and never beyond the deadline; then it stops
  and gives back what it took. So a source has to keep sending: one that died steers nothing (X7).
  """

  import Aerie.Vehicle.Command.Types.Shared

  alias Aerie.Vehicle.Command.{Param, Type}

  @doc false
  @spec rows() :: [Type.t()]
  def rows do
    [
      row("rc_override", "Overrides channels of the pilot's remote control.", [
        Param.list(
          :channels,
          Param.integer(:channel, "µs", 0, 2200, "0: not overridden"),
          18,
          "pulse widths of channels 1 and following; 0: that channel stays the pilot's",
          required: true
        )
      ]),
      row("manual_control", "Steers as with a joystick.", [
        axis(:pitch, "forward is positive"),
        axis(:roll, "to the right is positive"),
        axis(:yaw, "to the right is positive"),
        Param.number(:throttle, "-1..1", -1, 1, "0..1 for what cannot thrust backwards", default: 0.0),
        Param.integer(:buttons, nil, 0, 65_535, "a bit for each button", default: 0)
      ]),
      row(
        "setpoint_position",
        "Off-board set-point: a position.",
        place(required: true) ++
          altitude("height to be at", required: true) ++
          [heading(:yaw, "heading of the nose; without it, the vehicle decides")]
      ),
      row(
        "setpoint_local",
        "Off-board set-point: a position in metres from the origin of its local coordinates.",
        [
          Param.number(:north, "m", -100_000, 100_000, "to the north", required: true),
          Param.number(:east, "m", -100_000, 100_000, "to the east", required: true),
          Param.number(:down, "m", -20_000, 20_000, "down", required: true),
          heading(:yaw, "heading of the nose; without it, the vehicle decides")
        ]
      ),
      row("setpoint_velocity", [:NAV_SET_YAW_SPEED], "Off-board set-point: a velocity.", [
        speed(:vx, "to the north, or forward"),
        speed(:vy, "to the east, or to the right"),
        speed(:vz, "down"),
        Param.choice(:frame, ~w(north body), "whether x is to the north or where its nose points",
          default: "north"
        ),
        Param.number(:yaw_rate, "°/s", -360, 360, "turn to the right at this rate; without it, do not turn")
      ]),
      row("setpoint_attitude", [:NAV_ATTITUDE_TIME], "Off-board set-point: an attitude and a thrust.", [
        Param.number(:roll, "°", -180, 180, "right side down is positive", required: true),
        Param.number(:pitch, "°", -90, 90, "nose up is positive", required: true),
        Param.number(:yaw, "°", -180, 360, "from north", required: true),
        Param.number(:thrust, "0..1", 0, 1, "share of full thrust", required: true)
      ])
    ]
  end

  defp row(name, mav_cmds \\ [], meaning, params) do
    %Type{
      name: name,
      mav_cmds: mav_cmds,
      group: :manual,
      meaning: meaning,
      permission: :manual,
      moves_vehicle?: true,
      cancel?: true,
      # Sticks also arm; a set-point may be stored.
      disarmed: if(String.starts_with?(name, "setpoint_"), do: :refused_unless_first, else: :taken),
      params:
        params ++
          [
            Param.number(:hold, "s", 0.2, 10, "how long it stays in force if it is not sent again",
              default: 1.0
            ),
            Param.integer(:rate, "Hz", 2, 50, "how often the gateway sends it to the vehicle meanwhile",
              default: 10
            )
          ]
    }
  end

  defp axis(name, meaning), do: Param.number(name, "-1..1", -1, 1, meaning, default: 0.0)
  defp speed(name, meaning), do: Param.number(name, "m/s", -100, 100, meaning, required: true)
end
