defmodule SimVehicle.Firmware.Px4.Internal do
  @moduledoc """
  Commands from PX4 to its own modules that leak onto the link: from itself to its own system id, each four times with a rising
  confirmation. A router that sends them back to the vehicle makes a loop.
  """

  import MavCodec.Command

  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle

  @repeats [{0, 0}, {1_000_000, 1}, {1_512_000, 2}, {2_024_000, 3}]

  @doc "Sends a command to itself, and again three times in the next two seconds."
  @spec send(Vehicle.t(), non_neg_integer, [number | atom]) :: Vehicle.t()
  def send(v, id, params) do
    Enum.reduce(@repeats, v, fn {delay, confirmation}, v ->
      message = message(v, id, params, confirmation)
      if delay == 0, do: Vehicle.emit(v, message), else: Vehicle.later(v, delay, message)
    end)
  end

  @doc "The navigator's command to the gimbal when the mode changes in flight."
  @spec gimbal(Vehicle.t(), String.t()) :: Vehicle.t()
  def gimbal(%{airborne: true} = v, mode) when mode in ["AUTO_RTL", "AUTO_LAND", "AUTO_LOITER"] do
    v
    |> __MODULE__.send(cmd(:DO_GIMBAL_MANAGER_CONFIGURE), [1.0, 1.0, -1.0, -1.0])
    |> Vehicle.emit(message(v, cmd(:DO_GIMBAL_MANAGER_PITCHYAW), [:nan, :nan, :nan, :nan, 2.0], 0))
    |> Vehicle.emit(message(v, cmd(:DO_GIMBAL_MANAGER_CONFIGURE), [-3.0, -3.0, -1.0, -1.0], 0))
  end

  def gimbal(v, _mode), do: v

  defp message(v, id, params, confirmation) do
    [p1, p2, p3, p4, p5, p6, p7] = Enum.take(params ++ List.duplicate(0.0, 7), 7)

    %M.CommandLong{
      target_system: v.system,
      target_component: 0,
      command: id,
      confirmation: confirmation,
      param1: p1,
      param2: p2,
      param3: p3,
      param4: p4,
      param5: p5,
      param6: p6,
      param7: p7
    }
  end
end
