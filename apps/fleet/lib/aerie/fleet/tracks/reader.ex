defmodule Aerie.Fleet.Tracks.Reader do
  @moduledoc """
  Reads the files of the tracks, in the process that asks, by the index in the store. A group that cannot be read is
  left out.

  With a step of a minute or more only the first block of each group is read, so that a day costs little.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet.Tracks.{Block, Metrics, Sample}

  @max_samples 50_000
  @max_group_bytes 67_108_864

  @typedoc """
  Samples by vehicle, the oldest first (`t:Aerie.Fleet.Tracks.Sample.t/0` shown); `next`: where to go on, if there was
  too much for one answer; `since`: the oldest time that is kept. All times in unix microseconds.
  """
  @type answer :: %{
          vehicles: %{String.t() => [map()]},
          next: integer() | nil,
          since: integer() | nil
        }

  @doc "The most samples of an answer, about: what belongs to one moment is not torn apart."
  @spec max_samples() :: pos_integer()
  def max_samples, do: @max_samples

  @doc """
  The samples of vehicles from one time to another (unix microseconds), each vehicle's first one in each `step_s`
  seconds, all of them with a step of 1. Without tracks an error, which says why.
  """
  @spec read(
          Names.gateway(),
          [String.t()] | :all,
          from :: integer(),
          to :: integer(),
          step_s :: pos_integer(),
          keyword()
        ) ::
          {:ok, answer()} | {:error, String.t()}
  def read(gateway, ids, from, to, step_s, options \\ []) do
    case Metrics.status(gateway) do
      :off ->
        {:error, "this gateway keeps no tracks (tracks.enabled)"}

      nil ->
        {:error, "this gateway keeps no tracks: that part does not run"}

      _runs ->
        {:ok, read(gateway, groups(gateway), ids, div(from, 1000), div(to, 1000), step_s * 1000, options)}
    end
  end

  defp groups(gateway),
    do: Store.with_table(gateway, :tracks, [], &:ets.select(&1, [{{{:_, :_}, :_, :_, :_}, [], [:"$_"]}]))

  defp read(_gateway, groups, ids, from, to, step, options) do
    state = %{
      ids: if(is_list(ids), do: MapSet.new(ids)),
      from: from,
      to: to,
      step: step,
      left: Keyword.get(options, :limit, @max_samples),
      buckets: %{},
      found: %{},
      next: nil
    }

    since = with [{{_file, at}, _path, _offset, _bytes} | _] <- groups, do: at * 1000, else: ([] -> nil)
    state = groups |> spans() |> Enum.filter(&meets?(&1, from, to)) |> Enum.reduce_while(state, &group/2)
    found = Map.new(state.found, fn {id, samples} -> {id, Enum.reverse(samples)} end)
    %{vehicles: found, next: state.next && state.next * 1000, since: since}
  end

  # Each with the beginning of the next one in its file, and the time of the next one at all.
  defp spans([]), do: []

  defp spans([{{file, at}, path, offset, bytes} | rest]) do
    {ends, until} =
      case rest do
        [{{^file, next}, _path, next_offset, _bytes} | _] -> {next_offset, next}
        [{{_other, next}, _path, _offset, _bytes} | _] -> {nil, next}
        [] -> {nil, nil}
      end

    [%{at: at, until: until, path: path, offset: offset, ends: ends, first: bytes} | spans(rest)]
  end

  # Not by the next one's time alone: the clock may have been set back in between.
  defp meets?(%{at: at, until: until}, from, to),
    do: at <= to and (until == nil or until >= from or until < at)

  defp group(span, state) do
    extent = if state.step >= 60_000, do: span.first, else: extent(span)

    with {:ok, bytes} <- bytes(span.path, span.offset, extent),
         {:halted, state} <- Block.fold(Block.new(), bytes, state, &block/3) do
      {:halt, state}
    else
      {:ok, _group, _rest, state} -> {:cont, state}
      {:error, %{} = state} -> {:cont, state}
      {:error, _reason} -> {:cont, state}
    end
  end

  defp extent(%{ends: nil}), do: @max_group_bytes
  defp extent(%{ends: ends, offset: offset}), do: min(ends - offset, @max_group_bytes)

  defp bytes(path, offset, extent) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]) do
      result = :file.pread(file, offset, extent)
      _ = :file.close(file)
      with :eof <- result, do: {:ok, ""}
    end
  end

  defp block(at, _samples, %{from: from} = state) when at < from, do: {:cont, state}
  defp block(at, _samples, %{to: to} = state) when at > to, do: {:cont, state}
  defp block(at, _samples, %{left: left} = state) when left <= 0, do: {:halt, %{state | next: at}}
  defp block(at, samples, state), do: {:cont, Enum.reduce(samples, state, &sample(&1, &2, at))}

  defp sample({id, sample}, %{ids: ids, buckets: buckets} = state, at) do
    bucket = div(at, state.step)

    if (ids == nil or MapSet.member?(ids, id)) and
         (state.step == 1_000 or buckets[id] != bucket) do
      found =
        Map.update(state.found, id, [Sample.show(sample, at * 1000)], &[Sample.show(sample, at * 1000) | &1])

      %{state | found: found, buckets: Map.put(buckets, id, bucket), left: state.left - 1}
    else
      state
    end
  end
end
