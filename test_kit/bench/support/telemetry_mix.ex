defmodule Bench.TelemetryMix do
  @moduledoc """
  The telemetry of three flying vehicles: 33 messages of common and ardupilotmega at their usual rates, 43 bytes a
  frame on average, with values that look like a flight. The same messages each time.

  `flight.txt` has a row for each message: how often a vehicle sends it in a second, and its fields, in which `ms` is
  the time since boot, `near` an integer around a value and `float` a number around it.
  """

  alias MavCodec.Signing

  @table Path.join(__DIR__, "flight.txt")
  @external_resource @table

  rows =
    for row <- @table |> File.read!() |> String.replace(~r/\n +/, " ") |> String.split("\n", trim: true) do
      [rate, name, fields] = String.split(row, ~r/ +/, parts: 3)
      {Float.parse(rate), name, Code.string_to_quoted!("%MavCodec.Messages.#{name}{#{fields}}")}
    end

  @rates for {{rate, ""}, name, _message} <- rows, do: {name, rate}

  for {_rate, name, message} <- rows do
    defp message(unquote(name), var!(ms)) do
      _ = var!(ms)
      unquote(message)
    end
  end

  defp near(value, spread), do: value + :rand.uniform(2 * spread) - spread
  defp float(value, spread), do: value + spread * (:rand.uniform() - 0.5)

  @doc "`count` messages with the system that sends each: `{1..3, message}`."
  def messages(count) do
    :rand.seed(:exsss, {2026, 11, 20})
    names = for {name, rate} <- @rates, _ <- 1..round(rate * 10), do: name
    names = List.to_tuple(Enum.shuffle(names))

    for i <- 0..(count - 1),
        do: {:rand.uniform(3), message(elem(names, rem(i, tuple_size(names))), div(i, 3) * 7)}
  end

  @doc "The frames of `messages`, in order; in version 1 without those that it does not have."
  def frames(messages, version \\ 2) do
    messages
    |> Enum.reject(fn {_, %module{}} -> version == 1 and module.id() > 255 end)
    |> encoded(nil, fn message, options, nil ->
      {MavCodec.encode(message, [version: version] ++ options), nil}
    end)
  end

  @doc "The frames of `messages`, signed with `key`."
  def signed(messages, key),
    do: encoded(messages, Signing.new(key, link_id: 7), &Signing.encode(&3, &1, &2))

  # Each system counts its own frames.
  defp encoded(messages, state, encode) do
    {frames, _} =
      Enum.map_reduce(messages, {%{}, state}, fn {system, message}, {seqs, state} ->
        seq = Map.get(seqs, system, 0)
        {frame, state} = encode.(message, [system: system, component: 1, seq: rem(seq, 256)], state)
        {frame, {Map.put(seqs, system, seq + 1), state}}
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
  The frames with 1 % of their bytes damaged, as a line does it: half overwritten in bursts of 1 to 16 bytes, half
  garbage put in between, 1 to 40 bytes each; and the frames that stayed whole.
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
