defmodule Aerie.Vehicle.State.Health do
  @moduledoc "Estimator, vibration, remote control, and the autopilot's version and unique id."
  @behaviour Aerie.Vehicle.State

  import Bitwise

  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.State.Value
  alias MavCodec.Messages, as: M

  @impl State
  def read(%M.EkfStatusReport{} = m, _state, _at) do
    {[],
     health: %{
       ekf: %{
         flags: m.flags,
         velocity: Value.float(m.velocity_variance),
         position_horizontal: Value.float(m.pos_horiz_variance),
         position_vertical: Value.float(m.pos_vert_variance),
         compass: Value.float(m.compass_variance),
         terrain: Value.float(m.terrain_alt_variance)
       }
     }}
  end

  def read(%M.EstimatorStatus{} = m, _state, _at) do
    {[],
     health: %{
       ekf: %{
         flags: m.flags,
         velocity: Value.float(m.vel_ratio),
         position_horizontal: Value.float(m.pos_horiz_ratio),
         position_vertical: Value.float(m.pos_vert_ratio),
         compass: Value.float(m.mag_ratio),
         terrain: Value.float(m.hagl_ratio)
       }
     }}
  end

  def read(%M.Vibration{} = m, _state, _at) do
    {[],
     health: %{
       vibration: [Value.float(m.vibration_x), Value.float(m.vibration_y), Value.float(m.vibration_z)],
       clipping: m.clipping_0 + m.clipping_1 + m.clipping_2
     }}
  end

  def read(%M.RcChannels{} = m, state, _at) do
    channels = [
      m.chan1_raw,
      m.chan2_raw,
      m.chan3_raw,
      m.chan4_raw,
      m.chan5_raw,
      m.chan6_raw,
      m.chan7_raw,
      m.chan8_raw,
      m.chan9_raw,
      m.chan10_raw,
      m.chan11_raw,
      m.chan12_raw,
      m.chan13_raw,
      m.chan14_raw,
      m.chan15_raw,
      m.chan16_raw,
      m.chan17_raw,
      m.chan18_raw
    ]

    {[],
     rc: %{
       channels: channels |> Enum.take(m.chancount) |> Enum.map(&channel/1),
       rssi: rssi(m.rssi, state.autopilot)
     }}
  end

  def read(%M.RcChannelsRaw{port: 0} = m, state, _at) do
    channels = [
      m.chan1_raw,
      m.chan2_raw,
      m.chan3_raw,
      m.chan4_raw,
      m.chan5_raw,
      m.chan6_raw,
      m.chan7_raw,
      m.chan8_raw
    ]

    {[], rc: %{channels: Enum.map(channels, &channel/1), rssi: rssi(m.rssi, state.autopilot)}}
  end

  # RC_CHANNELS has the other ports, too.
  def read(%M.RcChannelsRaw{}, _state, _at), do: {[], []}

  def read(%M.AutopilotVersion{} = m, _state, _at) do
    {[firmware: version(m.flight_sw_version), uid: uid(m), capabilities: m.capabilities], []}
  end

  @doc "A firmware version as it is written, `\"4.6.3\"`, `\"1.18.0-beta\"`; nil for none."
  @spec version(non_neg_integer()) :: String.t() | nil
  def version(0), do: nil

  def version(number) do
    plain = "#{number >>> 24 &&& 0xFF}.#{number >>> 16 &&& 0xFF}.#{number >>> 8 &&& 0xFF}"

    case number &&& 0xFF do
      255 -> plain
      type when type >= 192 -> plain <> "-rc"
      type when type >= 128 -> plain <> "-beta"
      type when type >= 64 -> plain <> "-alpha"
      _type -> plain <> "-dev"
    end
  end

  # The long unique id if there is one, else the short one; a vehicle may have neither.
  defp uid(%{uid2: uid2, uid: uid}) do
    cond do
      String.trim(uid2, <<0>>) != "" -> Base.encode16(uid2, case: :lower)
      uid != 0 -> Integer.to_string(uid, 16)
      true -> nil
    end
  end

  defp channel(0), do: nil
  defp channel(0xFFFF), do: nil
  defp channel(microseconds), do: microseconds

  # PX4 sends percent (input_rc.rssi, 0 to 100; -1 for unknown), where the definition has 0 to 254.
  defp rssi(value, :px4), do: Value.up_to(value, 100, 100)
  defp rssi(value, _autopilot), do: Value.up_to(value, 254, 254)
end
