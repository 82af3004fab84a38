defmodule Aerie.Signing.Intake do
  @moduledoc """
  What links do with what they receive: runs in the link's process.

  A read is judged frame by frame (`Aerie.Signing.Guard`), then counted once: who was verified, who came unsigned, what
  was refused and whether that is an alarm. Nothing is kept for the sender of a refused frame but a bounded count.

  Two things are judged beyond a link's own memory. A frame that another link of the network heard of the same stream ten
  seconds ago or longer is a replay, however new it is here (S3; the ten seconds are for redundant radios, of which one is
  slower; a link of high latency may be a minute behind). And a signature that is wrong by the key in force may be right by the one that the vehicle is just being given
  (`Aerie.Signing.Enrolment`): that proves that the vehicle has it.
  """

  alias Aerie.Fleet.Store
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
      guards: %{},
      tally: %{}
    }

    acc = Enum.reduce(frames, acc, &judge/2)

    # Only right signatures change anything (S5).
    for {_slot, {scope, signing, true}} <- acc.guards do
      Guards.put(tables, link, scope, signing)
      Seal.proved(tables, link, source[:peer], scope.id)
    end

    for {_id, {scope, system}} <- acc.behind, do: Wake.refused(gateway, tables, source, scope, system)
    if acc.tally != %{}, do: count(gateway, tables, source, acc.tally, List.last(frames).at)
    Enum.reverse(acc.kept)
  end

  defp judge(frame, acc) do
    case guard(acc, frame.system) do
      {nil, acc} ->
        {verdict, scope} = candidate({:no_scope, nil}, acc, frame)
        told(acc, frame, verdict, scope)

      {{scope, signing, moved?}, acc} ->
        {verdict, signing} = Guard.check(scope, signing, frame, acc.trust)
        acc = put_in(acc.guards[slot(scope)], {scope, signing, moved? or verdict == :verified})
        {verdict, scope} = {elsewhere(verdict, acc, frame), scope} |> candidate(acc, frame)
        acc |> behind(verdict, scope, frame) |> told(frame, verdict, scope)
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

  defp elsewhere(:verified, acc, %{signature: signature} = frame) do
    %{tables: %{newest: newest}} = acc
    stream = {acc.network, signature.link_id, frame.system, frame.component}
    last = :ets.lookup_element(newest, stream, 2, 0)

    cond do
      signature.timestamp > last ->
        :ets.insert(newest, {stream, signature.timestamp})
        :verified

      last - signature.timestamp > acc.lag ->
        {:rejected, :replayed}

      true ->
        :verified
    end
  end

  defp elsewhere(verdict, _acc, _frame), do: verdict

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

  # One look at the tables for each scope in a read. Slots are scopes, and systems that have none.
  defp guard(acc, system) do
    with :error <- Map.fetch(acc.guards, {:of, system}) do
      scope = Tables.scope(acc.tables, {acc.network, system})
      acc = put_in(acc.guards[{:of, system}], scope && slot(scope))

      if scope == nil or is_map_key(acc.guards, slot(scope)) do
        guard(acc, system)
      else
        signing = Guards.get(acc.gateway, acc.tables, acc.link, scope)
        guard(put_in(acc.guards[slot(scope)], {scope, signing, false}), system)
      end
    else
      {:ok, nil} -> {nil, acc}
      {:ok, slot} -> {Map.fetch!(acc.guards, slot), acc}
    end
  end

  defp slot(%Scope{id: {_network, system}}), do: {:scope, system}

  defp note(tally, _frame, verdict) when verdict in [:unchecked, :exempt, :no_scope], do: tally

  defp note(tally, frame, {:rejected, reason}),
    do: add(tally, {frame.system, {:rejected, frame.component, reason}})

  defp note(tally, frame, :secure), do: add(tally, {frame.system, :unsigned})
  defp note(tally, frame, verdict), do: add(tally, {frame.system, verdict})
  defp add(tally, key), do: Map.update(tally, key, 1, &(&1 + 1))

  defp count(gateway, tables, source, tally, at) do
    Enum.each(tally, fn {{system, what}, n} ->
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
