defmodule Aerie.Ftp.Packet do
  @moduledoc "The payload of FILE_TRANSFER_PROTOCOL: a header of 12 bytes and up to 239 bytes of data (T1)."

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

  defstruct seq: 0, session: 0, opcode: 0, size: 0, request: 0, complete: false, offset: 0, data: ""

  @typedoc "`request`: the opcode that is answered; `complete`: the end of a burst; `size` may ask for more than `data` has"
  @type t :: %__MODULE__{}
  @type target :: {system :: non_neg_integer(), component :: 0..255}

  @doc "The number of data bytes that fit."
  @spec max_data() :: pos_integer()
  def max_data, do: @max_data

  @doc "The opcode of an operation."
  @spec opcode(atom()) :: byte()
  def opcode(name), do: Map.fetch!(@opcodes, name)

  @doc "The message that carries a packet to a vehicle."
  @spec message(t(), target()) :: struct()
  def message(%__MODULE__{data: data} = p, {system, component}) when byte_size(data) <= @max_data do
    header =
      <<p.seq::little-16, p.session, p.opcode, p.size, p.request, if(p.complete, do: 1, else: 0), 0,
        p.offset::little-32>>

    padding = <<0::size((@max_data - byte_size(data)) * 8)>>

    %FileTransferProtocol{
      target_system: system,
      target_component: component,
      payload: header <> data <> padding
    }
  end

  @doc "The answer in a message: `{:ack | :nak, packet}`; `:other` for anything else. `data` is cut to its size."
  @spec read(struct()) :: {:ack | :nak, t()} | :other
  def read(%FileTransferProtocol{
        payload:
          <<seq::little-16, session, opcode, size, request, complete, _padding, offset::little-32,
            data::binary>>
      })
      when opcode in [@ack, @nak] and size <= byte_size(data) do
    packet = %__MODULE__{
      seq: seq,
      session: session,
      opcode: opcode,
      size: size,
      request: request,
      complete: complete != 0,
      offset: offset,
      data: binary_part(data, 0, size)
    }

    {if(opcode == @ack, do: :ack, else: :nak), packet}
  end

  def read(_message), do: :other

  @doc "The request in a message. `data` is cut to its size if it has so much."
  @spec request(struct()) :: {:ok, t()} | :error
  def request(%FileTransferProtocol{
        payload:
          <<seq::little-16, session, opcode, size, _request, _complete, _padding, offset::little-32,
            data::binary>>
      }) do
    data = binary_part(data, 0, min(size, byte_size(data)))
    {:ok, %__MODULE__{seq: seq, session: session, opcode: opcode, size: size, offset: offset, data: data}}
  end

  def request(_message), do: :error

  @typedoc "Why the vehicle refuses: MAV_FTP_ERR in words, `{:errno, n}`, or the number of an unknown one"
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

  @doc "The reason of a NAK."
  @spec error(t()) :: error()
  def error(%{data: <<2, errno, _rest::binary>>}),
    do: if(errno == 2, do: :file_not_found, else: {:errno, errno})

  def error(%{data: <<code, _rest::binary>>}), do: error_name(MavFtpErr.name(code), code)
  def error(_packet), do: :failed

  defp error_name(:MAV_FTP_ERR_FAIL, _code), do: :failed
  defp error_name(:MAV_FTP_ERR_FAILERRNO, _code), do: :failed
  defp error_name(:MAV_FTP_ERR_INVALIDDATASIZE, _code), do: :invalid_size
  defp error_name(:MAV_FTP_ERR_INVALIDSESSION, _code), do: :invalid_session
  defp error_name(:MAV_FTP_ERR_NOSESSIONSAVAILABLE, _code), do: :no_sessions
  defp error_name(:MAV_FTP_ERR_EOF, _code), do: :eof
  defp error_name(:MAV_FTP_ERR_UNKNOWNCOMMAND, _code), do: :unknown_command
  defp error_name(:MAV_FTP_ERR_FILEEXISTS, _code), do: :file_exists
  defp error_name(:MAV_FTP_ERR_FILEPROTECTED, _code), do: :file_protected
  defp error_name(:MAV_FTP_ERR_FILENOTFOUND, _code), do: :file_not_found
  defp error_name(_unknown, code), do: {:error, code}

  @doc "CRC-32 without inversions, as both firmwares calculate it for files; goes on from `crc`."
  @spec crc32(iodata(), non_neg_integer()) :: non_neg_integer()
  def crc32(data, crc \\ 0),
    do: Bitwise.bxor(:erlang.crc32(Bitwise.bxor(crc, 0xFFFF_FFFF), data), 0xFFFF_FFFF)
end
