defmodule Aerie.Signing.Intake do
  @moduledoc """
  What links do with what they receive, and with what they send: runs in the link's process.

  A read is judged frame by frame (`Aerie.Signing.Guard`), then counted once: who was verified, who came unsigned, what
  was refused and whether that is an alarm. Nothing is kept for the sender of a refused frame but a bounded count.
  """

  alias Aerie.Fleet.Store
  alias Aerie.Names
  alias Aerie.Signing.{Alarm, Guard, Guards, Scope, Tables}
  alias MavCodec.Frame

  @max_sources 4096

  @doc "The frames that are taken in, of those that a link received."
  @spec admit(Names.gateway(), Tables.t(), map, [Frame.t()]) :: [Frame.t()]
  def admit(gateway, tables, %{id: link, network: network} = source, frames) do
    trust = Map.get(source, :trust, :radio)
    start = %{kept: [], guards: %{}, tally: %{}}

    %{kept: kept, guards: guards, tally: tally} =
      Enum.reduce(frames, start, fn frame, acc ->
        judge(acc, gateway, tables, link, network, frame, trust)
      end)

    for {_system, {scope, signing, old}} <- guards,
        signing != nil,
        signing != old,
        do: Guards.put(tables, link, scope, signing)

    if tally != %{}, do: count(gateway, tables, source, tally, List.last(frames).at)
    Enum.reverse(kept)
  end

  defp judge(acc, gateway, tables, link, network, frame, trust) do
    {entry, acc} = guard(acc, gateway, tables, link, {network, frame.system})

    case entry do
      nil ->
        %{acc | kept: [frame | acc.kept]}

      {scope, signing, old} ->
        {verdict, signing} = Guard.check(scope, signing, frame, trust)
        acc = put_in(acc.guards[slot(scope)], {scope, signing, old})
        kept = if match?({:rejected, _}, verdict), do: acc.kept, else: [frame | acc.kept]
        %{acc | kept: kept, tally: note(acc.tally, frame, verdict)}
    end
  end

  # One look at the tables for each scope in a read. Slots are scopes, and systems that have none.
  defp guard(acc, gateway, tables, link, {_network, system} = key) do
    with :error <- Map.fetch(acc.guards, {:of, system}) do
      scope = Tables.scope(tables, key)
      acc = put_in(acc.guards[{:of, system}], scope && slot(scope))

      if scope == nil or is_map_key(acc.guards, slot(scope)) do
        guard(acc, gateway, tables, link, key)
      else
        signing = Guards.get(gateway, tables, link, scope)
        guard(put_in(acc.guards[slot(scope)], {scope, signing, signing}), gateway, tables, link, key)
      end
    else
      {:ok, nil} -> {nil, acc}
      {:ok, slot} -> {Map.fetch!(acc.guards, slot), acc}
    end
  end

  defp slot(%Scope{id: {_network, system}}), do: {:scope, system}

  defp note(tally, _frame, verdict) when verdict in [:unchecked, :exempt], do: tally

  defp note(tally, frame, {:rejected, reason}),
    do: add(tally, {frame.system, {:rejected, frame.component, reason}})

  defp note(tally, frame, :secure), do: add(tally, {frame.system, :unsigned})
  defp note(tally, frame, verdict), do: add(tally, {frame.system, verdict})
  defp add(tally, key), do: Map.update(tally, key, 1, &(&1 + 1))

  defp count(gateway, tables, source, tally, at) do
    for {{system, what}, n} <- tally do
      key = {source.network, system}

      case what do
        {:rejected, component, reason} ->
          heard(tables, key, nil, 6, n, at)
          Store.count(gateway, {:signing, source.id, :rejected}, n)
          Alarm.rejected(gateway, tables, source, {system, component}, reason, n, at)

        :verified ->
          heard(tables, key, 2, 4, n, at)
          Store.count(gateway, {:signing, source.id, :verified}, n)
          tell(tables, key, :verified, source.id)

        :unsigned ->
          heard(tables, key, 3, 5, n, at)
          Store.count(gateway, {:signing, source.id, :unsigned}, n)
          tell(tables, key, :unsigned, source.id)
      end
    end

    :ok
  end

  defp heard(tables, key, time, counter, n, at) do
    if :ets.member(tables.sources, key) or :ets.info(tables.sources, :size) < @max_sources do
      _ = :ets.update_counter(tables.sources, key, {counter, n}, {key, nil, nil, 0, 0, 0})
      if time, do: :ets.update_element(tables.sources, key, {time, at})
    end

    :ok
  end

  defp tell(tables, key, what, link) do
    if :ets.info(tables.waiters, :size) > 0 do
      Enum.each(:ets.lookup(tables.waiters, key), fn {_key, pid, reference} ->
        send(pid, {reference, what, link})
      end)
    end
  end

  @doc """
  The bytes that go out in place of `bytes`, which are for a system of a network (nil: for all of them), or to be signed
  for that very scope.
  """
  @spec seal(Names.gateway(), String.t(), {String.t(), non_neg_integer | nil} | Scope.t(), iodata) :: iodata
  def seal(gateway, link, key, bytes) do
    with tables when is_map(tables) <- Tables.active(gateway),
         %Scope{policy: policy} = scope when policy != :off <- scope(tables, key),
         signing when signing != nil <- Guards.get(gateway, tables, link, scope) do
      own = Tables.setting(tables, :own, nil)
      {bytes, signed, unsigned, signing} = Guard.sign(signing, IO.iodata_to_binary(bytes), own)
      Guards.put(tables, link, scope, signing)
      _ = if signed > 0, do: Store.count(gateway, {:signing, link, :signed}, signed)
      _ = if unsigned > 0, do: Store.count(gateway, {:signing, link, :not_signed}, unsigned)
      bytes
    else
      _no_key -> bytes
    end
  end

  defp scope(_tables, %Scope{} = scope), do: scope
  defp scope(tables, key), do: Tables.scope(tables, key)
end
