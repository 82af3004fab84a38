defmodule MavCodec do
  @moduledoc """
  MAVLink wire formats as pure functions.

      parser = MavCodec.Parser.new()
      {frames, parser} = MavCodec.Parser.push(parser, bytes)
      {:ok, %MavCodec.Messages.Heartbeat{}} = MavCodec.decode(hd(frames))

      MavCodec.encode(%MavCodec.Messages.Heartbeat{type: 6}, system: 237, component: 191, seq: 7)

  `MavCodec.Parser` reads, `MavCodec.Frame.Encoder` writes and counts, `MavCodec.Signing` signs and verifies,
  `MavCodec.Tlog.Reader` reads recordings, and `MavCodec.Tlog` makes their records.
  """

  alias MavCodec.{Dialects, Message}
  alias MavCodec.Frame.Raw
  alias MavCodec.Message.DecodeError

  @typedoc """
    * `:dialect` - the dialect with the message's layout; default `MavCodec.Dialects.All`
    * the options of `t:MavCodec.Frame.Raw.option/0`: `:system` (required), `:component`, `:seq`, `:version`, ...
  """
  @type encode_option :: {:dialect, module()} | Raw.option()

  @doc """
  Decodes a frame to its message struct.

  The frame is a `MavCodec.Frame`, or any map with `id`, `version` and `payload`. Truncated payloads are filled with
  zeros and surplus bytes ignored (F7-F9); only an id that is not in the dialect is an error.
  """
  @spec decode(
          %{:id => non_neg_integer(), :version => 1 | 2, :payload => binary(), optional(atom()) => term()},
          module()
        ) ::
          {:ok, struct()} | {:error, DecodeError.t()}
  def decode(frame, dialect \\ Dialects.All)

  def decode(%{version: 2, id: id, payload: payload}, dialect), do: dialect.decode(id, payload)

  # F9: MAVLink 1 has no extensions; bytes behind the base fields are ignored.
  def decode(%{version: 1, id: id, payload: payload}, dialect) do
    case dialect.length(id) do
      {min, _max} when byte_size(payload) > min -> dialect.decode(id, binary_part(payload, 0, min))
      _length -> dialect.decode(id, payload)
    end
  end

  @doc """
  The frame of a message, unsigned. Version 2 has the extension fields and no trailing zeros (F7); version 1 has no
  extensions and only messages with ids up to 255.

  With `sysid32: true` a target system above 255 is put into the header, and 255 into the payload (N1).

  Raises `MavCodec.Message.EncodeError` for a value that does not fit its field, a message that is not in the dialect or
  not in version 1, or an id out of range.

      iex> MavCodec.encode(%MavCodec.Messages.Ping{seq: 1}, system: 1, seq: 9) |> Base.encode16()
      "FD0900000901010400000000000000000000011B74"
  """
  @spec encode(Message.t(), [encode_option()]) :: binary()
  def encode(message, options) do
    {message, options} = long_target(message, options)
    dialect = Keyword.get(options, :dialect, Dialects.All)

    case Message.encode_payload(message, Raw.version(options), dialect) do
      {:ok, id, crc_extra, payload} -> Raw.frame(id, payload, crc_extra, options)
      {:error, error} -> raise error
    end
  end

  defp long_target(%{target_system: system} = message, options) when is_integer(system) and system > 255 do
    if Keyword.get(options, :sysid32, false),
      do: {%{message | target_system: 255}, Keyword.put(options, :target_system, system)},
      else: {message, options}
  end

  defp long_target(message, options), do: {message, options}
end
