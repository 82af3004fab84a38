defmodule MavCodec.Bench.TelemetryMix do
  @moduledoc """
  The telemetry of three flying vehicles as the benchmarks use it: 33 messages of common and ardupilotmega at their usual rates,
  43 bytes a frame on average, with values that look like a flight. The same messages each time.
  """

  alias MavCodec.Bench.FlightMessages
  alias MavCodec.Signing

  # Messages per second and vehicle.
  @rates [
    attitude: 25,
    highres_imu: 20,
    global_position_int: 10,
    local_position_ned: 10,
    vfr_hud: 10,
    raw_imu: 10,
    gps_raw_int: 5,
    rc_channels: 5,
    servo_output_raw: 5,
    scaled_pressure: 5,
    ahrs2: 5,
    nav_controller_output: 5,
    esc_telemetry: 5,
    distance_sensor: 5,
    param_value: 4,
    sys_status: 2,
    battery_status: 2,
    vibration: 2,
    ekf_status_report: 2,
    wind: 2,
    heartbeat: 1,
    power_status: 1,
    meminfo: 1,
    system_time: 1,
    timesync: 1,
    terrain_report: 1,
    extended_sys_state: 1,
    mission_current: 1,
    statustext: 0.5,
    home_position: 0.2,
    mission_item_int: 0.2,
    command_ack: 0.2,
    autopilot_version: 0.1
  ]

  @doc "`count` messages with the system that sends each: `{1..3, message}`."
  def messages(count) do
    :rand.seed(:exsss, {2026, 11, 20})
    kinds = for {kind, rate} <- @rates, _ <- 1..round(rate * 10), do: kind
    kinds = List.to_tuple(Enum.shuffle(kinds))

    for i <- 0..(count - 1),
        do: {:rand.uniform(3), FlightMessages.message(elem(kinds, rem(i, tuple_size(kinds))), div(i, 3) * 7)}
  end

  @doc "The frames of `messages`, in order; in version 1 without those that it does not have."
  def frames(messages, version \\ 2) do
    messages =
      if version == 1, do: Enum.reject(messages, fn {_, %module{}} -> module.id() > 255 end), else: messages

    {frames, _} =
      Enum.map_reduce(messages, %{}, fn {system, message}, seqs ->
        seq = Map.get(seqs, system, 0)
        frame = MavCodec.encode(message, system: system, component: 1, seq: rem(seq, 256), version: version)
        {frame, Map.put(seqs, system, seq + 1)}
      end)

    frames
  end

  @doc "The frames of `messages`, signed with `key`."
  def signed(messages, key) do
    {frames, _} =
      Enum.map_reduce(messages, {%{}, Signing.new(key, link_id: 7)}, fn {system, message}, {seqs, signing} ->
        seq = Map.get(seqs, system, 0)
        {frame, signing} = Signing.encode(signing, message, system: system, component: 1, seq: rem(seq, 256))
        {frame, {Map.put(seqs, system, seq + 1), signing}}
      end)

    frames
  end

  @doc "Bytes in reads of `size`, as TCP or a serial port gives them."
  def cut(data, size) when byte_size(data) <= size, do: [data]

  def cut(data, size) do
    <<read::binary-size(^size), rest::binary>> = data
    [read | cut(rest, size)]
  end

  @doc """
  The frames with 1 % of their bytes damaged, as a line does it: half overwritten in bursts of 1 to 16 bytes, half garbage put
  in between, 1 to 40 bytes each; and the frames that stayed whole.
  """
  def damage(frames) do
    :rand.seed(:exsss, {1, 2, 3})

    {parts, whole} =
      Enum.map_reduce(frames, [], fn frame, whole ->
        # A burst of 8.5 bytes and garbage of 20.5 bytes on average, half a per cent each.
        burst? = :rand.uniform() < byte_size(frame) / 200 / 8.5
        garbage? = :rand.uniform() < byte_size(frame) / 200 / 20.5
        damaged = if burst?, do: overwrite(frame), else: frame
        damaged = if garbage?, do: insert(damaged), else: damaged
        {damaged, if(damaged == frame, do: [frame | whole], else: whole)}
      end)

    {IO.iodata_to_binary(parts), Enum.reverse(whole)}
  end

  defp overwrite(frame) do
    at = :rand.uniform(byte_size(frame)) - 1
    size = min(:rand.uniform(16), byte_size(frame) - at)
    <<before::binary-size(^at), burst::binary-size(^size), rest::binary>> = frame
    burst = for <<byte <- burst>>, into: <<>>, do: <<Bitwise.bxor(byte, :rand.uniform(255))>>
    <<before::binary, burst::binary, rest::binary>>
  end

  defp insert(frame) do
    at = :rand.uniform(byte_size(frame)) - 1
    <<before::binary-size(^at), rest::binary>> = frame
    <<before::binary, :rand.bytes(:rand.uniform(40))::binary, rest::binary>>
  end
end
