defmodule MavCodec.Msp.Frame do
  @moduledoc """
  A frame of MSP, in any of its three forms (Q1). A reply has the form of its request.

  | form | ids | check |
  |---|---|---|
  | `:v1` | 0 to 254 | XOR of all bytes |
  | `:v2` | 0 to 65,535 | CRC-8/DVB-S2 |
  | `:v2_over_v1` | 0 to 65,535 | both; for programs in between that know only version 1 |

  - `direction`: `:request` to the flight controller; `:reply`, also what it sends unasked; `:error`, its refusal
  - `flags`: of version 2, 0 in the other. Betaflight ignores them. iNav sends no reply if bit 0 is set, and echoes the others.
  """

  @enforce_keys [:id]
  defstruct form: :v1, direction: :request, id: nil, flags: 0, payload: ""

  @type form :: :v1 | :v2 | :v2_over_v1
  @type direction :: :request | :reply | :error
  @type t :: %__MODULE__{
          form: form,
          direction: direction,
          id: 0..0xFFFF,
          flags: byte,
          payload: binary
        }

  @doc "The bytes of a frame. A payload of 255 bytes or more becomes a jumbo frame, which firmware sends and never accepts."
  @spec encode(t) :: binary
  def encode(%__MODULE__{form: :v1, id: id, payload: payload} = frame) when id in 0..254 do
    body = [size(byte_size(payload), <<id>>), payload]
    IO.iodata_to_binary(["$M", letter(frame.direction), body, xor(body)])
  end

  def encode(%__MODULE__{form: :v2, payload: payload} = frame) do
    body = [header(frame), payload]
    IO.iodata_to_binary(["$X", letter(frame.direction), body, crc(body)])
  end

  # All firmware puts the size of a jumbo frame behind the inner header, and leaves it out of the inner check.
  def encode(%__MODULE__{form: :v2_over_v1, payload: payload} = frame) do
    header = header(frame)
    check = crc([header, payload])
    inner = byte_size(payload) + 6

    body =
      if inner < 255,
        do: [<<inner, 255>>, header, payload, check],
        else: [<<255, 255>>, header, <<inner::16-little>>, payload, check]

    IO.iodata_to_binary(["$M", letter(frame.direction), body, xor(body)])
  end

  defp size(size, id) when size < 255, do: [size, id]
  defp size(size, id), do: [255, id, <<size::16-little>>]

  defp header(%{flags: flags, id: id, payload: payload}) when id in 0..0xFFFF,
    do: <<flags, id::16-little, byte_size(payload)::16-little>>

  defp crc(body), do: MavCodec.CRC.DvbS2.of(IO.iodata_to_binary(body))

  defp xor(body) do
    for <<byte <- IO.iodata_to_binary(body)>>, reduce: 0, do: (sum -> Bitwise.bxor(sum, byte))
  end

  defp letter(:request), do: ?<
  defp letter(:reply), do: ?>
  defp letter(:error), do: ?!
end
