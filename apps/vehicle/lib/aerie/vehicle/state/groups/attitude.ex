defmodule Aerie.Vehicle.State.Groups.Attitude do
  @moduledoc "The vehicle's attitude, from angles or a quaternion."

  alias Aerie.Vehicle.State.{Group, Value}
  alias MavCodec.Messages, as: M

  use Group,
    name: :attitude,
    title: "The vehicle's attitude.",
    sampling: {:time, 1.0, %{}, 30.0},
    messages: [M.Attitude, {M.AttitudeQuaternion, M.Attitude}],
    fields: [
      {:roll, 2, "°", "right side down is positive", "ATTITUDE, ATTITUDE_QUATERNION"},
      {:pitch, 2, "°", "nose up is positive", "ATTITUDE, ATTITUDE_QUATERNION"},
      {:yaw, 2, "°", "-180..180 from north", "ATTITUDE, ATTITUDE_QUATERNION"},
      {:rollspeed, 2, "°/s", "body rate", "ATTITUDE, ATTITUDE_QUATERNION"},
      {:pitchspeed, 2, "°/s", "body rate", "ATTITUDE, ATTITUDE_QUATERNION"},
      {:yawspeed, 2, "°/s", "body rate", "ATTITUDE, ATTITUDE_QUATERNION"}
    ]

  @impl Group
  def read(%M.Attitude{} = m, _state, _at) do
    {[], attitude: attitude(Value.degrees(m.roll), Value.degrees(m.pitch), Value.degrees(m.yaw), m)}
  end

  def read(%M.AttitudeQuaternion{q1: w, q2: x, q3: y, q4: z} = m, _state, _at)
      when is_float(w) and is_float(x) and is_float(y) and is_float(z) do
    roll = :math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = :math.asin(min(1.0, max(-1.0, 2 * (w * y - z * x))))
    yaw = :math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    {[], attitude: attitude(Value.degrees(roll), Value.degrees(pitch), Value.degrees(yaw), m)}
  end

  def read(%M.AttitudeQuaternion{}, _state, _at), do: {:invalid, :attitude_quaternion}

  defp attitude(roll, pitch, yaw, rates) do
    %{
      roll: roll,
      pitch: pitch,
      yaw: yaw,
      rollspeed: Value.degrees(rates.rollspeed),
      pitchspeed: Value.degrees(rates.pitchspeed),
      yawspeed: Value.degrees(rates.yawspeed)
    }
  end
end
