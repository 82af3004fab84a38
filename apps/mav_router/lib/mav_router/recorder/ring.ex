defmodule MavRouter.Recorder.Ring do
  @overhead 200

  @moduledoc """
  The last minutes of each vehicle, in memory: the frames that it sent and got, as records of a tlog, without signatures and keys (S9).

  The vehicle's session and links write it directly, without a process in between, so that it survives their deaths. It is bounded by
  age, by bytes per vehicle, and by bytes of all: each vehicle's part gets smaller when there are many. An entry counts for its bytes
  and #{@overhead} more, which is about what it takes.
  """

  alias MavRouter.Recorder.{Settings, Tables}
  alias MavCodec.{Frame, Tlog}

  @type key :: {String.t(), non_neg_integer}
  @type size :: %{bytes: non_neg_integer, entries: non_neg_integer}

  @doc "Adds frames, in order, at a monotonic time in ms; gives the number of their entry."
  @spec push(Tables.t(), Settings.t(), key, [Frame.t(), ...], integer) :: pos_integer
  def push(tables, settings, key, frames, now) do
    # Copied, so that a few frames do not keep a link's read in memory.
    records = frames |> Tlog.records(signatures: false) |> IO.iodata_to_binary()
    size = byte_size(records) + @overhead
    [n, bytes] = :ets.update_counter(tables.rings, key, [{2, 1}, {3, size}], {key, 0, 0})
    :ets.insert(tables.ring, {{key, n}, now, size, records, length(frames)})
    trim(tables, key, bytes, limit(tables, settings), now - settings.ring_ms)
    n
  end

  @doc "Whether there is a ring for a vehicle."
  @spec known?(Tables.t(), key) :: boolean
  def known?(tables, key), do: :ets.member(tables.rings, key)

  defp limit(tables, settings) do
    vehicles = max(:ets.info(tables.rings, :size), 1)
    min(settings.ring_bytes, div(settings.ring_total, vehicles))
  end

  # The process that takes an entry subtracts it, so that two may trim at once.
  defp trim(tables, key, bytes, limit, oldest) do
    with {^key, _n} = first <- :ets.next(tables.ring, {key, 0}),
         # Only the time: the records would be copied.
         true <- bytes > limit or :ets.lookup_element(tables.ring, first, 2, :infinity) < oldest do
      case :ets.take(tables.ring, first) do
        [{_first, _at, size, _records, _frames}] ->
          trim(tables, key, subtract(tables, key, size), limit, oldest)

        [] ->
          trim(tables, key, :ets.lookup_element(tables.rings, key, 3, 0), limit, oldest)
      end
    else
      _young_or_empty -> :ok
    end
  end

  defp subtract(tables, key, size) do
    :ets.update_counter(tables.rings, key, {3, -size})
  rescue
    # The vehicle was forgotten meanwhile; the writer goes on.
    ArgumentError -> 0
  end

  @doc "All entries of a vehicle, oldest first: `{n, records, how many}`."
  @spec entries(Tables.t(), key) :: [{pos_integer, binary, pos_integer}]
  def entries(tables, key) do
    :ets.select(tables.ring, [{{{key, :"$1"}, :_, :_, :"$2", :"$3"}, [], [{{:"$1", :"$2", :"$3"}}]}])
  end

  @doc "The size of a vehicle's ring: `%{bytes, entries}`; nil for an unknown vehicle."
  @spec size(Tables.t(), key) :: size | nil
  def size(tables, key), do: tables |> sizes(:ets.lookup(tables.rings, key)) |> Map.get(key)

  @doc "The sizes of all rings. A vehicle that is forgotten meanwhile is in it whole or not at all."
  @spec sizes(Tables.t()) :: %{key => size}
  def sizes(tables), do: sizes(tables, :ets.tab2list(tables.rings))

  defp sizes(tables, rings) do
    for {key, _n, bytes} <- rings, into: %{} do
      {key,
       %{bytes: bytes, entries: :ets.select_count(tables.ring, [{{{key, :_}, :_, :_, :_, :_}, [], [true]}])}}
    end
  end

  @doc "Forgets a vehicle."
  @spec forget(Tables.t(), key) :: :ok
  def forget(tables, key) do
    :ets.delete(tables.rings, key)
    true = :ets.match_delete(tables.ring, {{key, :_}, :_, :_, :_, :_})
    :ok
  end
end
