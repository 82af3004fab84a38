defmodule Aerie.Control.Transfers.Spool do
  @moduledoc """
  Downloads something large from a vehicle into a file of this machine. Until it is complete its name ends with `.part`.
  An interrupted download continues at the first gap if the vehicle's checksum is still the one in `.part.crc`. The
  complete file is compared with it as well.
  """

  alias Aerie.Control.Transfers
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Control.Ftp.Ranges
  alias Aerie.Base.Files.Private
  alias MavCodec.CRC

  @max_bytes 1_073_741_824

  @doc "The largest download: 1 GiB."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc """
  Fills a file by `reading`, which gets the offset to begin at and folds the pieces (`Aerie.Control.Transfers.read/6`).
  Returns the size, or why it is incomplete.

  `same` is the vehicle's checksum (`MavCodec.CRC.crc32/2`); nil if there is none, so that nothing is continued; `:asks`
  if `reading` itself finds out whether it is the same.
  """
  @spec fill(Path.t(), non_neg_integer() | nil | :asks, (non_neg_integer(), acc, (term(), acc -> acc) ->
                                                           {{:ok, term()} | {:error, Result.t()}, acc})) ::
          {:ok, non_neg_integer()} | {:error, Result.t()}
        when acc: term()
  def fill(path, same, reading) do
    part = path <> ".part"

    with :ok <- Private.new_folder(Path.dirname(path)),
         :ok <- begin(part, same),
         {:ok, file} <- File.open(part, [:read, :write, :raw, :binary]) do
      offset = size(part)
      {result, {error, ranges}} = reading.(offset, {nil, Ranges.new(offset)}, &put(&1, &2, file))
      whole = Ranges.contiguous(ranges)
      # Bytes after a gap are read again.
      _ = with {:ok, _at} <- :file.position(file, whole), do: :file.truncate(file)
      :ok = File.close(file)
      result = if offset > 0, do: compared(result, part, same), else: result
      ended(result, error, part, path, whole)
    else
      {:error, reason} -> failed(reason)
    end
  end

  defp begin(_part, :asks), do: :ok

  defp begin(part, crc) do
    if crc != nil and File.read(crc_file(part)) == {:ok, hex(crc)} do
      :ok
    else
      _ = File.rm(part)
      if crc, do: File.write(crc_file(part), hex(crc)), else: :ok
    end
  end

  defp crc_file(part), do: part <> ".crc"
  defp hex(crc), do: Base.encode16(<<crc::32>>)

  # A part may be damaged too: by what ended it, or by somebody else.
  defp compared({:ok, _size} = done, part, crc) when is_integer(crc) do
    if part |> File.stream!(65_536) |> Enum.reduce(0, &CRC.crc32/2) == crc do
      done
    else
      _ = File.rm(part)

      Transfers.error(Refusal.ended(:file_damaged))
    end
  end

  defp compared(result, _part, _same), do: result

  defp size(part) do
    case File.stat(part) do
      {:ok, %{size: size}} -> size
      {:error, _reason} -> 0
    end
  end

  defp put({:data, _offset, _bytes}, {error, _ranges} = acc, _file) when error != nil, do: acc

  defp put({:data, offset, bytes}, {nil, ranges}, file) do
    case :file.pwrite(file, offset, bytes) do
      :ok -> {nil, Ranges.add(ranges, offset, offset + byte_size(bytes))}
      {:error, reason} -> {reason, ranges}
    end
  end

  defp ended({:ok, _size}, nil, part, path, whole) do
    case File.rename(part, path) do
      :ok ->
        _ = File.rm(crc_file(part))
        {:ok, whole}

      {:error, reason} ->
        failed(reason)
    end
  end

  defp ended(_result, error, _part, _path, _whole) when error != nil, do: failed(error)
  defp ended({:error, result}, nil, _part, _path, _whole), do: {:error, result}

  defp failed(reason), do: Transfers.error(Refusal.ended(:no_file_here, error: :file.format_error(reason)))
end
