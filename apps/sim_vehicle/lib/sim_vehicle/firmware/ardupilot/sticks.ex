defmodule SimVehicle.Firmware.Ardupilot.Sticks do
  @moduledoc """
  RC_CHANNELS_OVERRIDE and MANUAL_CONTROL as ArduPilot takes them: of the ground station SYSID_MYGCS only
  (`GCS_MAVLINK::handle_rc_channels_override`, `handle_manual_control`), for three seconds (RC_OVERRIDE_TIME). RC_CHANNELS shows them, and the
  mode channel changes the mode when it comes to another of its six positions (`RC_Channel::read_6pos_switch`).
  """

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Params, Vehicle}

  @bands [1231, 1361, 1491, 1621, 1750]

  @doc "Takes one from a system; `switch` names the parameters of the mode channel, `enter` changes to a mode by its number."
  @spec take(Vehicle.t(), struct, integer, {String.t(), String.t()}, (Vehicle.t(), integer -> Vehicle.t())) ::
          Vehicle.t()
  def take(v, message, system, switch, enter) do
    if system == Params.get(v.params, "SYSID_MYGCS"),
      do: v |> override(channels(message)) |> mode(switch, enter),
      else: v
  end

  defp channels(%M.RcChannelsOverride{} = m) do
    for n <- 1..18,
        us = Map.fetch!(m, String.to_existing_atom("chan#{n}_raw")),
        us != 65_535,
        n <= 8 or us != 0,
        do: {n, us}
  end

  # Roll, pitch, throttle and yaw.
  defp channels(%M.ManualControl{} = m),
    do: [{1, 1500 + div(m.y, 2)}, {2, 1500 - div(m.x, 2)}, {3, 1000 + m.z}, {4, 1500 + div(m.r, 2)}]

  # 0, and 65534 from the ninth on, gives a channel back.
  defp override(v, channels) do
    overrides =
      Enum.reduce(channels, Vehicle.own(v, :overrides, %{}), fn
        {n, us}, all when us == 0 or us == 65_534 -> Map.delete(all, n)
        {n, us}, all -> Map.put(all, n, {us, v.now})
      end)

    Vehicle.put_own(v, :overrides, overrides)
  end

  defp mode(v, {channel, slot}, enter) do
    with n when is_number(n) <- known(v, channel),
         us when us != nil <- Vehicle.overridden(v, trunc(n)),
         true <- us in 801..2199,
         position = Enum.find_index(@bands ++ [:infinity], &(us < &1)) + 1,
         true <- position != Vehicle.own(v, :switch),
         number when is_number(number) <- known(v, "#{slot}#{position}") do
      v |> Vehicle.put_own(:switch, position) |> enter.(trunc(number))
    else
      _as_before -> v
    end
  end

  defp known(v, name), do: if(Params.member?(v.params, name), do: Params.get(v.params, name))
end
