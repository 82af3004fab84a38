defmodule Aerie.Control.Policy.Audit.Verify do
  @moduledoc """
  Checks an audit log from its first record to its last, without changing it: whether every line is what was written, and
  none is missing.

  What a hash chain cannot show: that somebody who may write the files rewrote all of them, or cut records off the end and
  the head with them. For that, keep the head (`Aerie.Control.Policy.Audit.status/1`) somewhere else, and give it here.
  """

  alias Aerie.Control.Policy.Audit.{Chain, Log, Record}

  @max_problems 20

  @typedoc "`notes`: what the log says of itself, such as repairs; each line is a sentence."
  @type report :: %{
          records: non_neg_integer(),
          first: pos_integer() | nil,
          last: non_neg_integer(),
          hash: String.t(),
          notes: [String.t()],
          problems: [String.t()]
        }

  @doc "A report on a folder; it is intact if there are no problems. `known` is a head that was kept elsewhere."
  @spec folder(Path.t(), {pos_integer(), String.t()} | nil) :: {:ok, report()} | {:error, String.t()}
  def folder(dir, known \\ nil) do
    with {:ok, %{segments: segments}} <- Chain.files(dir) do
      start = %{
        records: 0,
        first: nil,
        prev: nil,
        last: {nil, nil},
        pruned: %{},
        heads: for({n, hash} <- [known, Log.safe(dir)], into: %{}, do: {n, hash}),
        notes: [],
        problems: []
      }

      {:ok, segments |> Enum.reduce(start, &segment/2) |> beginning() |> ends() |> report()}
    else
      {:error, reason} -> {:error, "#{dir}: #{:file.format_error(reason)}"}
    end
  end

  defp segment(segment, state) do
    name = Path.basename(segment.path)

    case Chain.read(segment, state.last, state, &record/2) do
      {:ok, _segment, last, :whole, state} ->
        %{state | last: last}

      {:ok, _segment, last, {:torn, bytes}, state} ->
        problem(
          %{state | last: last},
          "#{name}: ends within a line (#{byte_size(bytes)} bytes); the log repairs that when it is opened"
        )

      {:ok, _segment, last, {:damaged, line, lines}, state} ->
        # The records behind it, if there are any, begin a file of their own.
        problem(
          %{state | last: skip(last, lines)},
          "#{name} line #{line}: was changed, or is not the record that follows the one before it"
        )

      {:error, reason} ->
        problem(state, "#{name}: #{:file.format_error(reason)}")
    end
  end

  defp skip({nil, nil}, _lines), do: {nil, nil}
  defp skip({n, hash}, lines), do: {n + lines, hash}

  defp record(%{n: n, hash: hash, fields: fields} = record, state) do
    state = if state.first, do: state, else: %{state | first: n, prev: record.prev}

    state =
      if state.heads[n] in [nil, hash],
        do: state,
        else: problem(state, "record #{n}: is not the one that was known to be safe")

    note(fields, %{state | records: state.records + 1, heads: Map.delete(state.heads, n)})
  end

  defp note(%{"type" => "pruned"} = fields, state),
    do: %{state | pruned: Map.put(state.pruned, fields["n_before"], fields["hash_before"])}

  defp note(%{"type" => "repaired"} = fields, state),
    do: add(state, "record #{fields["n"]}: a line of #{fields["bytes"]} bytes was torn and set aside")

  defp note(%{"type" => "missed"} = fields, state),
    do:
      add(
        state,
        "record #{fields["n"]}: #{fields["records"]} records could not be written since #{fields["since"]}"
      )

  defp note(%{"type" => "missing"} = fields, state),
    do:
      problem(
        state,
        "record #{fields["n"]}: the log had been shortened; it had reached record #{fields["n_before"]}"
      )

  defp note(%{"type" => "damaged"} = fields, state),
    do:
      problem(
        state,
        "record #{fields["n"]}: #{fields["file"]} had been damaged from line #{fields["line"]} on"
      )

  defp note(_entry, state), do: state

  # A log that does not begin with record 1 must say itself that what was before was removed.
  defp beginning(%{first: nil} = state), do: state

  defp beginning(%{first: first, prev: prev} = state) do
    cond do
      first == 1 and prev == Record.start() ->
        state

      state.pruned[first - 1] == prev ->
        state

      true ->
        problem(
          state,
          "record #{first}: is the first one, and no record says that those before it were removed"
        )
    end
  end

  # The known head was not found: it is behind the end, or before the beginning.
  defp ends(state) do
    Enum.reduce(state.heads, state, fn {n, _hash}, state ->
      if n >= (state.first || 1),
        do: problem(state, "record #{n}: is missing, though it had been written"),
        else: state
    end)
  end

  defp report(state) do
    {last, hash} = state.last

    state
    |> Map.take([:records, :first])
    |> Map.merge(%{
      last: last || 0,
      hash: hash || Record.start(),
      notes: Enum.reverse(state.notes),
      problems: Enum.reverse(state.problems)
    })
  end

  defp add(%{notes: notes} = state, _text) when length(notes) >= @max_problems, do: state
  defp add(state, text), do: %{state | notes: [text | state.notes]}

  defp problem(%{problems: problems} = state, _text) when length(problems) >= @max_problems, do: state
  defp problem(state, text), do: %{state | problems: [text | state.problems]}
end
