defmodule Aerie.Control.Policy.Audit.Chain do
  @moduledoc "Reads the files of an audit log, and finds where the records of one do not follow each other."

  alias Aerie.Control.Policy.Audit.Record
  alias Aerie.Base.Segments
  alias Aerie.Base.Segments.Segment

  @typedoc "Number and hash of a record; nil before the first."
  @type link :: {n :: integer() | nil, hash :: String.t() | nil}

  @typedoc """
  How a file ends: `:whole`; `{:torn, bytes}`, a last line without its end, as a kill or a power cut leaves it; `{:damaged, line}`,
  a line that was changed or does not follow the one before it, and how many lines there are from it on.
  """
  @type ending :: :whole | {:torn, binary()} | {:damaged, line :: pos_integer(), lines :: pos_integer()}

  @doc "The files of a log."
  @spec files(Path.t()) :: {:ok, Segments.t()} | {:error, File.posix()}
  def files(dir), do: Segments.open(dir, ".jsonl")

  @doc """
  Reads a file line by line. `fun` gets each record that follows the one before, from `{n, hash}` on; `{nil, nil}` takes
  the first one as it is.
  """
  @spec read(Segment.t(), link(), acc, (Record.t(), acc -> acc)) ::
          {:ok, Segment.t(), link(), ending(), acc} | {:error, File.posix()}
        when acc: term()
  def read(segment, last \\ {nil, nil}, acc \\ nil, fun \\ fn _record, acc -> acc end) do
    start = %{last: last, lines: 0, damaged: nil, acc: acc}

    with {:ok, segment, ending, state} <- Segment.fold(segment, &Segment.line/1, start, &line(&1, &2, fun)) do
      {:ok, segment, state.last, ending(ending, state), state.acc}
    end
  end

  defp line(text, %{damaged: nil, lines: lines} = state, fun) do
    case follows(text, state.last) do
      {:ok, record} ->
        %{state | last: {record.n, record.hash}, lines: lines + 1, acc: fun.(record, state.acc)}

      :error ->
        %{state | lines: lines + 1, damaged: lines + 1}
    end
  end

  defp line(_text, state, _fun), do: %{state | lines: state.lines + 1}

  defp ending(:eof, %{damaged: nil}), do: :whole
  defp ending(:eof, state), do: {:damaged, state.damaged, state.lines - state.damaged + 1}

  defp ending({:torn, text}, %{damaged: nil} = state) do
    if byte_size(text) <= Record.max_bytes(), do: {:torn, text}, else: {:damaged, state.lines + 1, 1}
  end

  defp ending({:torn, _text}, state), do: ending(:eof, %{state | lines: state.lines + 1})

  defp follows(text, {n, hash}) do
    with {:ok, record} <- Record.decode(text) do
      if n == nil or (record.n == n + 1 and record.prev == hash), do: {:ok, record}, else: :error
    end
  end
end
