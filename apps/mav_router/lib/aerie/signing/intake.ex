defmodule Aerie.Signing.Intake do
  @moduledoc """
  What links do with what they receive: runs in the link's process.

  A read is judged frame by frame (`Aerie.Signing.Guard`), then counted once: who was verified, who came unsigned, what
  was refused and whether that is an alarm. Nothing is kept for the sender of a refused frame but a bounded count.

  Two things are judged beyond a link's own memory. A frame that another link of the network heard of the same stream ten
  seconds ago or longer is a replay, however new it is here (S3; the ten seconds are for redundant radios, of which one is
  slower; a link of high latency may be a minute behind). And a signature that is wrong by the key in force may be right by the one that the vehicle is just being given
  (`Aerie.Enrolment`): that proves that the vehicle has it.
  """

  alias Aerie.Store
  alias Aerie.Names
  alias Aerie.Signing.{Alarm, Guard, Guards, Scope, Seal, Tables, Vault, Wake}
  alias MavCodec.Frame

  @max_sources 4096
  # 10 s in units of 10 us, and for links of high latency the minute of S4.
  @other_link 1_000_000
  @slow_link 6_000_000

  @doc "The frames that are taken in, of those that a link received."
  @spec admit(Names.gateway(), Tables.t(), map, [Frame.t()]) :: [Frame.t()]
  def admit(gateway, tables, %{id: link, network: network} = source, frames) do
    acc = %{
      gateway: gateway,
      tables: tables,
      link: link,
      network: network,
      trust: Map.get(source, :trust, :radio),
      lag: if(source[:high_latency], do: @slow_link, else: @other_link),
      waited_for: :ets.info(tables.waiters, :size) > 0,
      kept: [],
      behind: %{},
      slots: %{},
      guards: %{},
      newest: %{},
      tally: []
    }

    acc = Enum.reduce(frames, acc, &judge/2)

    # Only right signatures change anything (S5).
    for {_slot, {scope, signing, true}} <- acc.guards do
      Guards.put(tables, link, scope, signing)
      Seal.proved(tables, link, source[:peer], scope.id)
    end

    for {stream, {last, true}} <- acc.newest, do: :ets.insert(tables.newest, {stream, last})
    for {_id, {scope, system}} <- acc.behind, do: Wake.refused(gateway, tables, source, scope, system)
    if acc.tally != [], do: count(gateway, tables, source, acc.tally, List.last(frames).at)
    Enum.reverse(acc.kept)
  end

  defp judge(frame, acc) do
    case slot(acc, frame.system) do
      {nil, acc} ->
        {verdict, scope} = candidate({:no_scope, nil}, acc, frame)
        told(acc, frame, verdict, scope)

      {slot, %{guards: guards} = acc} ->
        %{^slot => {scope, signing, moved?}} = guards
        {verdict, signing} = Guard.check(scope, signing, frame, acc.trust)
        guards = %{guards | slot => {scope, signing, moved? or verdict == :verified}}
        {verdict, newest} = elsewhere(verdict, acc, frame)
        {verdict, scope} = candidate({verdict, scope}, acc, frame)

        %{acc | guards: guards, newest: newest}
        |> behind(verdict, scope, frame)
        |> told(frame, verdict, scope)
    end
  end

  # Its signature was looked at first: it has the key.
  defp behind(acc, {:rejected, reason}, scope, frame) when reason in [:replayed, :stale],
    do: %{acc | behind: Map.put(acc.behind, scope.id, {scope, frame.system})}

  defp behind(acc, _verdict, _scope, _frame), do: acc

  defp told(acc, frame, verdict, scope) do
    _ = if acc.waited_for, do: tell(acc, frame, verdict, scope)
    kept = if match?({:rejected, _}, verdict), do: acc.kept, else: [frame | acc.kept]
    %{acc | kept: kept, tally: note(acc.tally, frame, verdict)}
  end

  # What other links heard is looked up once a read for each stream, and what this one heard is told once.
  defp elsewhere(
         :verified,
         %{newest: newest} = acc,
         %{signature: %{timestamp: timestamp} = signature} = frame
       ) do
    stream = {acc.network, signature.link_id, frame.system, frame.component}

    {last, moved?} =
      case newest do
        %{^stream => known} -> known
        _first -> {:ets.lookup_element(acc.tables.newest, stream, 2, 0), false}
      end

    cond do
      timestamp > last -> {:verified, Map.put(newest, stream, {timestamp, true})}
      last - timestamp > acc.lag -> {{:rejected, :replayed}, Map.put(newest, stream, {last, moved?})}
      true -> {:verified, Map.put(newest, stream, {last, moved?})}
    end
  end

  defp elsewhere(verdict, acc, _frame), do: {verdict, acc.newest}

  # Only where the key in force does not fit, so this costs nothing as long as all is well.
  defp candidate({verdict, scope}, acc, %Frame{signature: signature} = frame)
       when signature != nil and verdict in [:no_scope, {:rejected, :wrong_signature}, {:rejected, :no_key}] do
    with %Scope{} = candidate <- Tables.candidate(acc.tables, {acc.network, frame.system}),
         true <- Guards.proves?(acc.tables, acc.link, candidate, frame) do
      Vault.proven(acc.gateway, candidate)
      {:verified, candidate}
    else
      _other -> {verdict, scope}
    end
  end

  defp candidate(judged, _acc, _frame), do: judged

  # Where in `guards` the one of a system's scope is, nil when it has none: one look at the tables for each in a read.
  defp slot(%{slots: slots} = acc, system) do
    case slots do
      %{^system => slot} ->
        {slot, acc}

      _first ->
        scope = Tables.scope(acc.tables, {acc.network, system})
        slot = if scope, do: scope.id
        {slot, %{acc | slots: Map.put(slots, system, slot), guards: guard(acc, slot, scope)}}
    end
  end

  defp guard(%{guards: guards}, slot, scope) when scope == nil or is_map_key(guards, slot), do: guards

  defp guard(acc, slot, scope),
    do: Map.put(acc.guards, slot, {scope, Guards.get(acc.gateway, acc.tables, acc.link, scope), false})

  # Frames of one vehicle that follow each other are counted together.
  defp note(tally, _frame, verdict) when verdict in [:unchecked, :exempt, :no_scope], do: tally

  defp note(tally, frame, {:rejected, reason}),
    do: add(tally, frame.system, {:rejected, frame.component, reason})

  defp note(tally, frame, :secure), do: add(tally, frame.system, :unsigned)
  defp note(tally, frame, verdict), do: add(tally, frame.system, verdict)

  defp add([{system, what, n} | tally], system, what), do: [{system, what, n + 1} | tally]
  defp add(tally, system, what), do: [{system, what, 1} | tally]

  defp count(gateway, tables, source, tally, at) do
    sums =
      Enum.reduce(tally, %{}, fn {system, what, n}, sums -> Map.update(sums, {system, what}, n, &(&1 + n)) end)

    Enum.each(sums, fn {{system, what}, n} ->
      key = {source.network, system}

      case what do
        {:rejected, component, reason} ->
          heard(tables, key, nil, 6, n, at)
          _ = Store.count(gateway, {:signing, source.id, :rejected}, n)
          Alarm.rejected(gateway, tables, source, {system, component}, reason, n, at)

        :verified ->
          heard(tables, key, 2, 4, n, at)
          _ = Store.count(gateway, {:signing, source.id, :verified}, n)

        :unsigned ->
          heard(tables, key, 3, 5, n, at)
          _ = Store.count(gateway, {:signing, source.id, :unsigned}, n)
      end
    end)
  end

  defp heard(tables, key, time, counter, n, at) do
    if :ets.member(tables.sources, key) or :ets.info(tables.sources, :size) < @max_sources do
      _ = :ets.update_counter(tables.sources, key, {counter, n}, {key, nil, nil, 0, 0, 0})
      _ = if time, do: :ets.update_element(tables.sources, key, {time, at})
    end

    :ok
  end

  # Enrolments are told by which key it was verified, so that the last frames under the old one prove nothing.
  defp tell(acc, frame, verdict, scope) do
    what =
      case verdict do
        :verified -> {:verified, scope.generation}
        verdict when verdict in [:unsigned, :secure, {:rejected, :unsigned}] -> :unsigned
        :no_scope when frame.signature == nil -> :unsigned
        _other -> nil
      end

    if what do
      for {_key, pid, reference} <- :ets.lookup(acc.tables.waiters, {acc.network, frame.system}) do
        send(pid, {reference, what, acc.link, frame.component})
      end
    end
  end
end
