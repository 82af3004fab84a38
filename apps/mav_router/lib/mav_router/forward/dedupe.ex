defmodule MavRouter.Forward.Dedupe do
  @max 8_192
  @window_ms 500
  # How often the same bytes from the same endpoint may pass.
  @repeats 16
  # What comes more slowly is a program that repeats itself, not a loop.
  @slow_ms 150

  @moduledoc """
  Whether the same frame came from another endpoint a moment ago: redundant links deliver everything twice, and a loop between two
  routers delivers it for ever. Sequence numbers cannot tell that (R7); the bytes can.

  A frame is remembered by a 64-bit hash of its bytes, for #{@window_ms} to #{2 * @window_ms} ms, in two tables of at most #{@max}
  entries: when time or room is over, the older one is emptied and becomes the newer one. A frame that came from *another* endpoint
  is a duplicate. One that comes again from the same endpoint is not, up to #{@repeats} times less than #{@slow_ms} ms apart: more often
  than that it goes round in a loop that began before anybody looked for duplicates.

  Frames are compared only with those that had the same scope (`MavRouter.Forward.Gate`): what somebody sends who may
  not command cannot suppress a command, and what a client sends cannot suppress a vehicle's telemetry. What is for
  clients only is compared with what vehicles sent as well, because another router may bring their frames back.
  """

  alias MavRouter.Tables

  @typedoc "What a frame may reach: see `MavRouter.Forward.Gate`."
  @type scope :: :cleared | :clients | :related

  @doc "Notes a frame's bytes from an endpoint (monotonic ms); whether it is a duplicate."
  @spec duplicate?(Tables.t(), binary, term, scope, integer) :: boolean
  def duplicate?(tables, bytes, from, scope, now) do
    {newer, older} = pair(tables, now)
    hash = hash(bytes, scope)

    case known(newer, hash) || known(older, hash) || brought_back({newer, older}, bytes, scope) do
      nil -> not :ets.insert_new(newer, {hash, from, 1, now}) and known(newer, hash) not in [nil, from]
      ^from -> repeated(newer, older, hash, from, now) > @repeats
      _other -> true
    end
  end

  @doc """
  Notes a frame of a component that is heard by one endpoint only, in case it comes back by another: a command must not be given
  twice because of a loop that nobody knew of.
  """
  @spec note(Tables.t(), binary, term, scope, integer) :: :ok
  def note(tables, bytes, from, scope, now) do
    {newer, _older} = pair(tables, now)
    _ = :ets.insert_new(newer, {hash(bytes, scope), from, 1, now})
    :ok
  end

  defp brought_back({newer, older}, bytes, :clients) do
    hash = hash(bytes, :related)
    known(newer, hash) || known(older, hash)
  end

  defp brought_back(_tables, _bytes, _scope), do: nil

  # How often it came within short times.
  defp repeated(newer, older, hash, from, now) do
    {count, last} = counted(newer, hash) || counted(older, hash)
    count = if now - last < @slow_ms, do: count + 1, else: 1
    :ets.insert(newer, {hash, from, count, now})
    count
  end

  defp known(table, hash), do: :ets.lookup_element(table, hash, 2, nil)

  defp counted(table, hash) do
    with [{_hash, _from, count, last}] <- :ets.lookup(table, hash), do: {count, last}, else: ([] -> nil)
  end

  # The hash by which bytes are remembered: two independent ones of 32 bits, apart for each scope.
  defp hash(bytes, scope),
    do: Bitwise.bor(Bitwise.bsl(:erlang.crc32(bytes), 32), :erlang.phash2({scope, bytes}, 4_294_967_296))

  # The newer of the two follows from the number of turns, by time or because a table was full.
  defp pair(%{seen: {a, b}, settings: settings} = tables, now) do
    {turn, until} = :ets.lookup_element(settings, :seen_turn, 2)
    {newer, older} = if rem(turn, 2) == 0, do: {a, b}, else: {b, a}

    if now >= until or :ets.info(newer, :size) >= @max do
      turn(tables, turn, until, older, now)
      {older, newer}
    else
      {newer, older}
    end
  end

  # The first process to see that it is time does it.
  defp turn(%{settings: settings}, turn, until, older, now) do
    next = {turn + 1, now + @window_ms}
    match = [{{:seen_turn, {turn, until}}, [], [{{:seen_turn, {:const, next}}}]}]

    if :ets.select_replace(settings, match) == 1, do: :ets.delete_all_objects(older)
  end
end
