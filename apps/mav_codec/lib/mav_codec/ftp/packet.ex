defmodule MavCodec.Ftp.Packet do
  @moduledoc """
  The payload of FILE_TRANSFER_PROTOCOL: a header of 12 bytes and up to 239 bytes of data (T1).

  `decode/1` and `encode/1` are for both sides; `answer/1` is what a client makes of a message, `request/1` what a server does.
  """

  alias MavCodec.Enums.{MavFtpErr, MavFtpOpcode}
  alias MavCodec.Messages.FileTransferProtocol

  @max_data 239
  @ack MavFtpOpcode.value(:MAV_FTP_OPCODE_ACK)
  @nak MavFtpOpcode.value(:MAV_FTP_OPCODE_NAK)
  @opcodes %{
    terminate: MavFtpOpcode.value(:MAV_FTP_OPCODE_TERMINATESESSION),
    reset: MavFtpOpcode.value(:MAV_FTP_OPCODE_RESETSESSION),
    list: MavFtpOpcode.value(:MAV_FTP_OPCODE_LISTDIRECTORY),
    open: MavFtpOpcode.value(:MAV_FTP_OPCODE_OPENFILERO),
    read: MavFtpOpcode.value(:MAV_FTP_OPCODE_READFILE),
    create: MavFtpOpcode.value(:MAV_FTP_OPCODE_CREATEFILE),
    write: MavFtpOpcode.value(:MAV_FTP_OPCODE_WRITEFILE),
    remove: MavFtpOpcode.value(:MAV_FTP_OPCODE_REMOVEFILE),
    open_to_write: MavFtpOpcode.value(:MAV_FTP_OPCODE_OPENFILEWO),
    crc: MavFtpOpcode.value(:MAV_FTP_OPCODE_CALCFILECRC),
    burst: MavFtpOpcode.value(:MAV_FTP_OPCODE_BURSTREADFILE)
  }
  @operations Map.new(@opcodes, fn {name, opcode} -> {opcode, name} end)
  @errno MavFtpErr.value(:MAV_FTP_ERR_FAILERRNO)
  # errno's "no such file".
  @enoent 2
  @errors %{
    failed: MavFtpErr.value(:MAV_FTP_ERR_FAIL),
    invalid_size: MavFtpErr.value(:MAV_FTP_ERR_INVALIDDATASIZE),
    invalid_session: MavFtpErr.value(:MAV_FTP_ERR_INVALIDSESSION),
    no_sessions: MavFtpErr.value(:MAV_FTP_ERR_NOSESSIONSAVAILABLE),
    eof: MavFtpErr.value(:MAV_FTP_ERR_EOF),
    unknown_command: MavFtpErr.value(:MAV_FTP_ERR_UNKNOWNCOMMAND),
    file_exists: MavFtpErr.value(:MAV_FTP_ERR_FILEEXISTS),
    file_protected: MavFtpErr.value(:MAV_FTP_ERR_FILEPROTECTED),
    file_not_found: MavFtpErr.value(:MAV_FTP_ERR_FILENOTFOUND)
  }
  @error_names Map.new(@errors, fn {name, code} -> {code, name} end)

  defstruct seq: 0, session: 0, opcode: 0, size: 0, request: 0, complete: false, offset: 0, data: ""

  @typedoc "`request`: the opcode that is answered; `complete`: the end of a burst; `size` may ask for more than `data` has"
  @type t :: %__MODULE__{}

  @typedoc "Why the server refuses: MAV_FTP_ERR by name, `{:errno, n}`, or the number of an unknown one"
  @type error ::
          :eof
          | :file_not_found
          | :file_exists
          | :file_protected
          | :invalid_session
          | :no_sessions
          | :unknown_command
          | :invalid_size
          | :failed
          | {:errno, byte()}
          | {:error, byte()}

  @type target :: {system :: non_neg_integer(), component :: 0..255}

  @doc "The number of data bytes that fit."
  @spec max_data() :: pos_integer()
  def max_data, do: @max_data

  @doc "The opcode of an operation."
  @spec opcode(atom()) :: byte()
  def opcode(name), do: Map.fetch!(@opcodes, name)

  @doc "The operation that a packet asks for; nil for an unknown one."
  @spec operation(t()) :: atom()
  def operation(packet), do: @operations[packet.opcode]

  @doc "A server's answer to a request, with data."
  @spec ack(t(), binary()) :: t()
  def ack(request, data), do: reply(request, @ack, data)

  @doc "A server's refusal of a request."
  @spec nak(t(), error()) :: t()
  def nak(request, {:errno, errno}), do: reply(request, @nak, <<@errno, errno>>)
  def nak(request, {:error, code}), do: reply(request, @nak, <<code>>)
  def nak(request, error), do: reply(request, @nak, <<Map.fetch!(@errors, error)>>)

  defp reply(request, opcode, data) do
    %__MODULE__{
      seq: Bitwise.band(request.seq + 1, 0xFFFF),
      session: request.session,
      opcode: opcode,
      size: byte_size(data),
      request: request.opcode,
      offset: request.offset,
      data: data
    }
  end

  @doc "The payload of a packet, padded with zeros. A packet with more data than fits raises."
  @spec encode(t()) :: <<_::2008>>
  def encode(%__MODULE__{data: data} = p) when byte_size(data) <= @max_data do
    complete = if p.complete, do: 1, else: 0
    padding = (@max_data - byte_size(data)) * 8

    <<p.seq::little-16, p.session, p.opcode, p.size, p.request, complete, 0, p.offset::little-32,
      data::binary, 0::size(padding)>>
  end

  @doc "The packet in a payload; `data` is cut to `size`, if the payload has so much. `:error` for one without a header."
  @spec decode(binary()) :: {:ok, t()} | :error
  def decode(
        <<seq::little-16, session, opcode, size, request, complete, _padding, offset::little-32,
          data::binary>>
      ) do
    {:ok,
     %__MODULE__{
       seq: seq,
       session: session,
       opcode: opcode,
       size: size,
       request: request,
       complete: complete != 0,
       offset: offset,
       data: binary_part(data, 0, min(size, byte_size(data)))
     }}
  end

  def decode(payload) when is_binary(payload), do: :error

  @doc "The message that carries a packet to a target."
  @spec message(t(), target()) :: struct()
  def message(packet, {system, component}),
    do: %FileTransferProtocol{
      target_system: system,
      target_component: component,
      payload: encode(packet)
    }

  @doc "The answer in a message: `{:ack | :nak, packet}`; `:other` for anything else."
  @spec answer(struct()) :: {:ack | :nak, t()} | :other
  def answer(message) do
    case request(message) do
      {:ok, %{opcode: @ack, size: size, data: data} = packet} when size == byte_size(data) -> {:ack, packet}
      {:ok, %{opcode: @nak, size: size, data: data} = packet} when size == byte_size(data) -> {:nak, packet}
      _other -> :other
    end
  end

  @doc "The request in a message."
  @spec request(struct()) :: {:ok, t()} | :error
  def request(%FileTransferProtocol{payload: payload}), do: decode(payload)
  def request(_message), do: :error

  @doc "The reason of a NAK."
  @spec error(t()) :: error()
  def error(%{data: <<@errno, @enoent, _rest::binary>>}), do: :file_not_found
  def error(%{data: <<@errno, errno, _rest::binary>>}), do: {:errno, errno}
  def error(%{data: <<@errno>>}), do: :failed
  def error(%{data: <<code, _rest::binary>>}), do: Map.get(@error_names, code, {:error, code})
  def error(_packet), do: :failed
end
