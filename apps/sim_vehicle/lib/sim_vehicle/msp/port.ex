defmodule SimVehicle.Msp.Port do
  @max_payload 192

  @moduledoc """
  How a flight controller reads a port, with the habits of the real ones: only requests count, a half frame waits for its rest for
  ever and swallows what comes meanwhile, a frame with a wrong checksum is dropped whole, and a payload of more than #{@max_payload} bytes is not taken.
  `#` outside frames opens the command line, which echoes what can be printed.
  """

  alias MavCodec.CRC.DvbS2
  alias MavCodec.Msp.Frame

  defstruct buffer: "", queue: [], cli: false, disabled: false, stale: <<0::size(192 * 8)>>

  @typedoc """
  - `queue`: requests that wait for their turn, oldest first
  - `disabled`: arming was disabled by this port
  - `stale`: the input buffer, in which the bytes of earlier requests stay
  """
  @type t :: %__MODULE__{}

  @doc "Bytes from the client: what is to be sent at once (the echo of a command line), and what happened."
  @spec receive(t, binary) :: {t, echo :: binary, [:exit | {:oversize, non_neg_integer}]}
  def receive(%{cli: true} = port, bytes) do
    echo = for <<byte <- bytes>>, byte in 32..126 or byte in [?\r, ?\n], into: <<>>, do: <<byte>>
    if bytes =~ "exit\r", do: {%{port | cli: false}, echo, [:exit]}, else: {port, echo, []}
  end

  def receive(port, bytes), do: scan(%{port | buffer: port.buffer <> bytes}, [])

  defp scan(port, events) do
    case port.buffer do
      "" ->
        {port, "", events}

      "#" ->
        {%{port | buffer: "", cli: true}, "\r\nEntering CLI Mode, type 'exit' to reboot\r\n\r\n# ", events}

      <<"$", _::binary>> = buffer ->
        head(port, buffer, events)

      <<_other, rest::binary>> ->
        scan(%{port | buffer: rest}, events)
    end
  end

  defp head(port, <<"$X<", flags, id::16-little, n::16-little, rest::binary>>, events) when n > @max_payload,
    do: scan(%{port | buffer: rest, stale: over(port.stale, <<flags, id::16>>)}, events ++ [{:oversize, n}])

  defp head(
         port,
         <<"$X<", flags, id::16-little, n::16-little, payload::binary-size(n), crc, rest::binary>>,
         events
       ) do
    good? = DvbS2.of(<<flags, id::16-little, n::16-little, payload::binary>>) == crc
    taken(port, good?, %Frame{form: :v2, flags: flags, id: id, payload: payload}, rest, events)
  end

  defp head(
         port,
         <<"$M<", outer, 255, flags, id::16-little, n::16-little, payload::binary-size(n), crc, sum,
           rest::binary>>,
         events
       )
       when outer == n + 6 and n <= @max_payload do
    body = <<outer, 255, flags, id::16-little, n::16-little, payload::binary, crc>>
    good? = DvbS2.of(<<flags, id::16-little, n::16-little, payload::binary>>) == crc and xor(body) == sum
    taken(port, good?, %Frame{form: :v2_over_v1, flags: flags, id: id, payload: payload}, rest, events)
  end

  defp head(port, <<"$M<", n, rest::binary>>, events) when n > @max_payload and n < 199,
    do: scan(%{port | buffer: rest}, events)

  defp head(port, <<"$M<", n, id, payload::binary-size(n), sum, rest::binary>>, events) when id != 255,
    do: taken(port, xor(<<n, id, payload::binary>>) == sum, %Frame{id: id, payload: payload}, rest, events)

  # A reply, from a client, is not for a flight controller.
  defp head(port, <<"$", letter, direction, rest::binary>>, events) when letter in ~c"MX" and direction != ?<,
    do: scan(%{port | buffer: rest}, events)

  defp head(port, <<"$", other, rest::binary>>, events) when other not in ~c"MX",
    do: scan(%{port | buffer: <<other, rest::binary>>}, events)

  defp head(port, _half, events), do: {port, "", events}

  defp taken(port, false, _frame, rest, events), do: scan(%{port | buffer: rest}, events)

  defp taken(port, true, frame, rest, events),
    do: scan(%{port | buffer: rest, queue: port.queue ++ [frame]}, events)

  @doc "The payload as Betaflight to API 1.47 reads it: what is missing is what happens to be in the buffer."
  @spec fill(t, binary, non_neg_integer) :: {binary, t}
  def fill(port, payload, size) do
    stale = over(port.stale, payload)
    {binary_part(stale, 0, max(size, byte_size(payload))), %{port | stale: stale}}
  end

  defp over(stale, bytes),
    do: bytes <> binary_part(stale, byte_size(bytes), byte_size(stale) - byte_size(bytes))

  defp xor(bytes), do: for(<<byte <- bytes>>, reduce: 0, do: (sum -> Bitwise.bxor(sum, byte)))
end
