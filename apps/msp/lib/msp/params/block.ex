defmodule Msp.Params.Block do
  @moduledoc """
  Configuration blocks of Betaflight: what is written so that one field of them changes and nothing else. A block is written as it was just
  read, with as many bytes, in the layout of its write.
  """

  import Bitwise

  @writes %{
    "MSP2_GET_LED_STRIP_CONFIG_VALUES" => "MSP2_SET_LED_STRIP_CONFIG_VALUES",
    "MSP2_BATTERY_PROFILE" => "MSP2_SET_BATTERY_PROFILE"
  }

  # The same value in tenths of a volt, rounded, from before API 1.41.
  @rounded %{cell_min_cv: :cell_min, cell_max_cv: :cell_max, cell_warning_cv: :cell_warning}
  # Not in the table of items: the general part.
  @osd_general -1

  @typedoc "The values of a block, as `MavCodec.Msp.decode/2` gives them."
  @type values :: %{atom => term}

  @doc "The message that writes a block."
  @spec write_name(String.t()) :: String.t()
  def write_name(block), do: Map.get(@writes, block, "SET_" <> block)

  @doc "The block with another number in a field, in all places where it stands."
  @spec put(values, atom, integer) :: values
  def put(values, :gyro_lpf1_static_hz = field, hz) do
    values = Map.put(values, field, hz)
    # The low byte of it, from before it had two.
    if is_map_key(values, :gyro_lpf1_static_hz_low8),
      do: %{values | gyro_lpf1_static_hz_low8: hz &&& 0xFF},
      else: values
  end

  def put(values, field, number) when is_map_key(@rounded, field),
    do: values |> Map.put(field, number) |> Map.put(@rounded[field], min(div(number + 5, 10), 255))

  def put(values, field, number), do: Map.put(values, field, number)

  @doc "The values of the message that writes a block."
  @spec writing(String.t(), values) :: values
  def writing("VTX_CONFIG", v) do
    # Up to 63 it is a band and a channel, from there on a frequency.
    frequency = if v[:band] in 1..8, do: (v.band - 1) * 8 + v.channel - 1, else: v.frequency

    v
    |> Map.take([:power, :pit_mode, :low_power_disarm, :pit_frequency, :band, :channel])
    |> Map.merge(%{frequency: frequency, exact_frequency: v.frequency})
    |> without_rest(v)
  end

  def writing("OSD_CONFIG", v) do
    base =
      <<v.video_system, v.units, v.rssi_alarm, v.cap_alarm::16-little, 0::16, v.alt_alarm::16-little,
        v.warnings16::16-little>>

    %{address: @osd_general, data: base <> osd_more(v)}
  end

  def writing(_block, values), do: values

  # Before API 1.42 there was no pit frequency, and nothing behind it.
  defp without_rest(write, %{pit_frequency: _there}), do: write
  defp without_rest(write, _old), do: Map.drop(write, [:band, :channel, :exact_frequency])

  defp osd_more(v) do
    fields = [
      enabled_warnings: 32,
      profile: 8,
      overlay_radio_mode: 8,
      camera_frame_width: 8,
      camera_frame_height: 8,
      link_quality_alarm: 16,
      rssi_dbm_alarm: 16
    ]

    fields
    |> Enum.take_while(fn {key, _bits} -> is_map_key(v, key) end)
    |> Enum.map(fn {key, bits} -> <<Map.fetch!(v, key)::size(bits)-little>> end)
    |> IO.iodata_to_binary()
  end
end
