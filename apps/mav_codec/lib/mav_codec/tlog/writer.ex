defmodule MavCodec.Tlog.Writer do
  @moduledoc """
  Writes frames to a tlog file, as QGroundControl and MAVProxy do (G1).

      {:ok, writer} = MavCodec.Tlog.Writer.open("flight.tlog")
      :ok = MavCodec.Tlog.Writer.write(writer, frames)
      :ok = MavCodec.Tlog.Writer.close(writer)

  Keys of signed links never get into the file (S9, `MavCodec.Signing.Redact`). The file belongs to the process that opened it and
  is closed with it. `records/2` is the pure part.
  """

  alias MavCodec.Frame
  alias MavCodec.Signing.Redact

  @enforce_keys [:file, :signatures]
  defstruct @enforce_keys

  @opaque t :: %__MODULE__{file: :file.io_device(), signatures: boolean()}

  @typedoc """
    * `:append` - append to an existing file instead of emptying it; default `false`
    * `:signatures` - keep the signatures of signed frames; default `true`
    * `:delay` - milliseconds for which small writes are collected; default 1000. `close/1` and `sync/1` write them.
  """
  @type option :: {:append, boolean()} | {:signatures, boolean()} | {:delay, non_neg_integer()}

  @buffer 65_536

  @doc "Opens a file for writing."
  @spec open(Path.t(), [option()]) :: {:ok, t()} | {:error, File.posix()}
  def open(path, options \\ []) do
    options = Keyword.validate!(options, append: false, signatures: true, delay: 1000)
    mode = if options[:append], do: :append, else: :write

    case :file.open(path, [mode, :raw, :binary, {:delayed_write, @buffer, options[:delay]}]) do
      {:ok, file} -> {:ok, %__MODULE__{file: file, signatures: options[:signatures]}}
      {:error, reason} -> {:error, reason}
    end
  end

  @doc """
  Appends frames. A frame without a time of arrival gets that of the call. An error may belong to an earlier write, because
  writes are collected.
  """
  @spec write(t(), Frame.t() | [Frame.t()]) :: :ok | {:error, File.posix() | :terminated}
  def write(%__MODULE__{} = writer, frames),
    do: :file.write(writer.file, records(List.wrap(frames), signatures: writer.signatures))

  @doc "Hands everything written so far to the file system."
  @spec sync(t()) :: :ok | {:error, File.posix() | :terminated}
  def sync(%__MODULE__{file: file}), do: :file.datasync(file)

  @doc "Writes the rest and closes the file."
  @spec close(t()) :: :ok | {:error, File.posix() | :terminated}
  def close(%__MODULE__{file: file}), do: :file.close(file)

  @doc "The records of `frames` as iodata, without secrets."
  @spec records([Frame.t()], [{:signatures, boolean()}]) :: iodata()
  def records(frames, options \\ []) do
    for frame <- frames do
      [<<frame.at || System.os_time(:microsecond)::64>>, Redact.frame(frame, options).bytes]
    end
  end
end
