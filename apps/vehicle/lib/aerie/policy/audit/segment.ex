defmodule Aerie.Policy.Audit.Segment do
  @moduledoc "A file of the audit log, named after its first record, and what is found when it is read."

  alias Aerie.Policy.Audit.Record

  # No log writes larger ones, and a damaged file may be a single line.
  @max_bytes 1_073_741_824

  @doc "The file whose first record has a number."
  @spec path(Path.t(), pos_integer()) :: Path.t()
  def path(dir, first), do: Path.join(dir, String.pad_leading("#{first}", 16, "0") <> ".jsonl")

  @doc "The numbers of the first records of all files in a folder, in order."
  @spec all(Path.t()) :: {:ok, [pos_integer()]} | {:error, File.posix()}
  def all(dir) do
    with {:ok, names} <- File.ls(dir) do
      {:ok,
       Enum.sort(
         for(
           name <- names,
           [_, digits] <- [Regex.run(~r/\A(\d{16})\.jsonl\z/, name)],
           do: String.to_integer(digits)
         )
       )}
    end
  end

  @typedoc """
  How a file ends: `:whole`; `{:torn, bytes}`, a last line without its end, as a kill or a power cut leaves it; `{:damaged, line}`,
  a line that was changed or does not follow the one before it, and how many lines there are from it on.
  """
  @type ending :: :whole | {:torn, binary()} | {:damaged, line :: pos_integer(), lines :: pos_integer()}

  @doc """
  Reads a file line by line. `fun` gets each record that follows the one before, from `{n, hash}` on; `{nil, nil}` takes
  the first one as it is. Gives where it ends, how many bytes of it are good, and the accumulator.
  """
  @spec read(Path.t(), {n :: integer() | nil, hash :: String.t() | nil}, acc, (Record.t(), acc -> acc)) ::
          {:ok, {{integer() | nil, String.t() | nil}, good_bytes :: non_neg_integer(), ending()}, acc}
          | {:error, File.posix()}
        when acc: term()
  def read(path, last, acc, fun) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(path),
         {:ok, file} <- :file.open(path, [:read, :raw, :binary, {:read_ahead, 65_536}]) do
      result = lines(file, last, 0, 1, acc, fun)
      _ = :file.close(file)
      result
    else
      {:ok, _too_large} -> {:error, :efbig}
      error -> error
    end
  end

  defp lines(file, last, good, number, acc, fun) do
    case :file.read_line(file) do
      :eof ->
        {:ok, {last, good, :whole}, acc}

      {:error, reason} ->
        {:error, reason}

      {:ok, line} ->
        text = String.trim_trailing(line, "\n")
        ended? = text != line

        case follows(text, last) do
          {:ok, record} when ended? ->
            lines(file, {record.n, record.hash}, good + byte_size(line), number + 1, fun.(record, acc), fun)

          _torn when not ended? and byte_size(text) <= 16_384 ->
            {:ok, {last, good, {:torn, text}}, acc}

          _other ->
            {:ok, {last, good, {:damaged, number, 1 + rest(file, 0)}}, acc}
        end
    end
  end

  defp rest(file, count) do
    case :file.read_line(file) do
      {:ok, _line} -> rest(file, count + 1)
      _end -> count
    end
  end

  defp follows(text, {n, hash}) do
    with {:ok, record} <- Record.decode(text) do
      if n == nil or (record.n == n + 1 and record.prev == hash), do: {:ok, record}, else: :error
    end
  end
end
