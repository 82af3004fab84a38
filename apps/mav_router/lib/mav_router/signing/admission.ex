defmodule MavRouter.Signing.Admission do
  @moduledoc """
  Verifies what a link receives, in the link's process.

  Each frame of a read gets a verdict (`MavRouter.Signing.Verifiers.Verifier`); then the read is counted once:
  verified, unsigned and refused frames, and whether the refused ones are an alarm. For the sender of a refused frame
  nothing is kept but a bounded count.

  Two verdicts need more than the link's own memory. A frame of a stream that another link of the network heard at least ten
  seconds ago is a replay, however new it is here (S3). The ten seconds allow for the slower one of redundant radios; a link of high
  latency may be a minute behind. And a signature that is wrong by the key in force may be right by the key that the vehicle is
  being given (`Aerie.Vehicle.Enrolment`), which proves that the vehicle has it.
  """

  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavRouter.Signing.Alarm
  alias MavRouter.Signing.Admission.ClockRecovery
  alias MavRouter.Signing.KeyStore
  alias MavRouter.Signing.Signer
  alias MavRouter.Signing.Tables
  alias MavRouter.Signing.Verifiers.Verifier
  alias MavRouter.Signing.Verifiers
  alias MavCodec.{Frame, Signing}

  @max_sources 4096
  # 10 s in units of 10 µs; for links of high latency the minute of S4.
  @other_link 1_000_000
  @slow_link 6_000_000

  @doc "Those of the frames that a link received which are trusted."
  @spec admit(Names.gateway(), Tables.t(), map, [Frame.t()]) :: [Frame.t()]
  def admit(gateway, tables, %{id: link, network: network} = origin, frames) do
    acc = %{
      gateway: gateway,
      tables: tables,
      link: link,
      network: network,
      trust: Map.get(origin, :trust, :radio),
      lag: if(origin[:high_latency], do: @slow_link, else: @other_link),
      waiters?: :ets.info(tables.waiters, :size) > 0,
      kept: [],
      behind: %{},
      candidates: %{},
      slots: %{},
      verifiers: %{},
      newest: %{},
      counts: [],
      notices: []
    }

    acc = Enum.reduce(frames, acc, &verify/2)

    # Only right signatures change a state (S5).
    for {_slot, {scope, signing, true}} <- acc.verifiers do
      {leads, signing} = Signing.leads(signing)
      if leads, do: Alarm.ahead(gateway, origin, leads, List.last(frames).at)
      Verifiers.put(tables, link, scope, signing)
      Signer.proved(tables, link, origin[:peer], scope.id)
    end

    for {stream, {last, true}} <- acc.newest, do: :ets.insert(tables.newest, {stream, last})

    for {_id, {scope, system}} <- Map.to_list(acc.behind),
        do: ClockRecovery.refused(gateway, tables, origin, scope, system)

    if acc.counts != [], do: count(gateway, tables, origin, acc.counts, List.last(frames).at)
    # Last, so that an enrolment that ends by a frame finds it in the vehicle's state.
    acc.notices |> Enum.reverse() |> Enum.each(fn {pid, notice} -> send(pid, notice) end)
    Enum.reverse(acc.kept)
  end

  defp verify(frame, acc) do
    case slot(acc, frame.system) do
      {nil, acc} ->
        {verdict, scope, acc} = candidate({:no_scope, nil}, acc, frame)
        verdict(acc, frame, verdict, scope)

      {slot, %{verifiers: verifiers} = acc} ->
        %{^slot => {scope, signing, moved?}} = verifiers
        {verdict, signing} = Verifier.check(scope, signing, frame, acc.trust)
        verifiers = %{verifiers | slot => {scope, signing, moved? or verdict == :verified}}
        {verdict, newest} = elsewhere(verdict, acc, frame, signing)
        {verdict, scope, acc} = candidate({verdict, scope}, acc, frame)

        %{acc | verifiers: verifiers, newest: newest}
        |> behind(verdict, scope, frame)
        |> verdict(frame, verdict, scope)
    end
  end

  # The signature was checked before the time stamp: the sender has the key.
  defp behind(acc, {:rejected, reason}, scope, frame) when reason in [:replayed, :stale],
    do: %{acc | behind: Map.put(acc.behind, scope.id, {scope, frame.system})}

  defp behind(acc, _verdict, _scope, _frame), do: acc

  defp verdict(acc, frame, verdict, scope) do
    acc = if acc.waiters?, do: notify(acc, frame, verdict, scope), else: acc
    kept = if match?({:rejected, _}, verdict), do: acc.kept, else: [frame | acc.kept]
    %{acc | kept: kept, counts: note(acc.counts, frame, verdict)}
  end

  # Other links' time stamps are looked up once a read for each stream, and this link's are written once.
  defp elsewhere(
         :verified,
         %{newest: newest} = acc,
         %{signature: %{timestamp: timestamp}} = frame,
         signing
       ) do
    stream = Tuple.insert_at(Signing.stream(signing, frame), 0, acc.network)

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

  defp elsewhere(verdict, acc, _frame, _signing), do: {verdict, acc.newest}

  # Only where the key in force does not fit, so it costs nothing as long as all is well.
  defp candidate({verdict, scope}, acc, %Frame{signature: signature} = frame)
       when signature != nil and verdict in [:no_scope, {:rejected, :wrong_signature}, {:rejected, :no_key}] do
    {candidate, acc} = staged(acc, frame.system)

    if candidate != nil and Verifiers.proves?(acc.tables, acc.link, candidate, frame) do
      KeyStore.proven(acc.gateway, candidate)
      {:verified, candidate, acc}
    else
      {verdict, scope, acc}
    end
  end

  defp candidate({verdict, scope}, acc, _frame), do: {verdict, scope, acc}

  # Read once for each system of a read: its first frame puts the key in force, and the others of the read are signed with it as well.
  defp staged(%{candidates: candidates} = acc, system) do
    case candidates do
      %{^system => candidate} ->
        {candidate, acc}

      _first ->
        candidate = Tables.candidate(acc.tables, {acc.network, system})
        {candidate, %{acc | candidates: Map.put(candidates, system, candidate)}}
    end
  end

  # The key of a system's scope in `verifiers`, nil for no scope; the tables are read once for each system of a read.
  defp slot(%{slots: slots} = acc, system) do
    case slots do
      %{^system => slot} ->
        {slot, acc}

      _first ->
        scope = Tables.scope(acc.tables, {acc.network, system})
        slot = if scope, do: scope.id
        {slot, %{acc | slots: Map.put(slots, system, slot), verifiers: verifier(acc, slot, scope)}}
    end
  end

  defp verifier(%{verifiers: verifiers}, slot, scope) when scope == nil or is_map_key(verifiers, slot),
    do: verifiers

  defp verifier(acc, slot, scope),
    do: Map.put(acc.verifiers, slot, {scope, Verifiers.get(acc.gateway, acc.tables, acc.link, scope), false})

  # Frames of one vehicle that follow each other are counted together.
  defp note(counts, _frame, verdict) when verdict in [:unchecked, :exempt, :no_scope], do: counts

  defp note(counts, frame, {:rejected, reason}),
    do: add(counts, frame.system, {:rejected, frame.component, reason})

  defp note(counts, frame, :secure), do: add(counts, frame.system, :unsigned)
  defp note(counts, frame, verdict), do: add(counts, frame.system, verdict)

  defp add([{system, what, n} | counts], system, what), do: [{system, what, n + 1} | counts]
  defp add(counts, system, what), do: [{system, what, 1} | counts]

  defp count(gateway, tables, origin, counts, at) do
    Enum.each(sums(counts), fn {system, what, n} ->
      key = {origin.network, system}

      case what do
        {:rejected, component, reason} ->
          count_heard(tables, key, nil, 6, n, at)
          _ = Store.count(gateway, {:signing, origin.id, :rejected}, n)
          Alarm.rejected(gateway, tables, origin, {system, component}, reason, n, at)

        :verified ->
          count_heard(tables, key, 2, 4, n, at)
          _ = Store.count(gateway, {:signing, origin.id, :verified}, n)

        :unsigned ->
          count_heard(tables, key, 3, 5, n, at)
          _ = Store.count(gateway, {:signing, origin.id, :unsigned}, n)
      end
    end)
  end

  # Nearly always there is one.
  defp sums([_one] = counts), do: counts

  defp sums(counts) do
    counts
    |> Enum.group_by(fn {system, what, _n} -> {system, what} end, &elem(&1, 2))
    |> Enum.map(fn {{system, what}, numbers} -> {system, what, Enum.sum(numbers)} end)
  end

  defp count_heard(tables, key, time, counter, n, at) do
    if :ets.member(tables.sources, key) or :ets.info(tables.sources, :size) < @max_sources do
      _ = :ets.update_counter(tables.sources, key, {counter, n}, {key, nil, nil, 0, 0, 0})
      _ = if time, do: :ets.update_element(tables.sources, key, {time, at})
    end

    :ok
  end

  # Enrolments learn by which key a frame was verified, so that the last frames under the old key prove nothing.
  defp notify(acc, frame, verdict, scope) do
    what =
      case verdict do
        :verified -> {:verified, scope.generation}
        verdict when verdict in [:unsigned, :secure, {:rejected, :unsigned}] -> :unsigned
        :no_scope when frame.signature == nil -> :unsigned
        _other -> nil
      end

    if what do
      waiters = :ets.lookup(acc.tables.waiters, {acc.network, frame.system})
      new = for {_key, pid, reference} <- waiters, do: {pid, {reference, what, acc.link, frame.component}}
      %{acc | notices: new ++ acc.notices}
    else
      acc
    end
  end
end
