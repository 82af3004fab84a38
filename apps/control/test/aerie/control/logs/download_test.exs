defmodule Aerie.Control.Logs.DownloadTest do
  use ExUnit.Case, async: true

  alias Aerie.{Flight, FtpVehicle, LossyLink}
  alias Aerie.Control.Logs
  alias Aerie.Control.Transfers.InOrder
  alias MavCodec.Messages, as: M

  @deadline 3_000_000_000

  defp bytes(n), do: for(i <- 1..n//1, into: "", do: <<rem(i * 7919, 251)>>)
  defp vehicle(logs, style \\ :ardupilot), do: FtpVehicle.new(style, %{}, logs: logs)

  defp list(vehicle, options \\ []),
    do: LossyLink.run(Logs.List, Logs.List.new({1, 1}, @deadline), vehicle, &FtpVehicle.answer/3, options)

  defp get(vehicle, entry, options \\ [], more \\ []),
    do:
      LossyLink.run(
        Logs.Download,
        Logs.Download.new(entry, {1, 1}, @deadline, more),
        vehicle,
        &FtpVehicle.answer/3,
        [until: @deadline] ++ options
      )

  test "no logs, and ids from 0 or 1 (X1)" do
    assert list(vehicle([])).result == {:ok, []}
    assert {:ok, [%{id: 1, size: 10}, %{id: 2, size: 20}]} = list(vehicle([bytes(10), bytes(20)])).result
    assert {:ok, [%{id: 0, size: 10, time: 1_795_000_000}]} = list(vehicle([bytes(10)], :px4)).result
  end

  test "one entry: without the others, none where the vehicle has none" do
    one = fn vehicle, id, options ->
      list = Logs.List.new({1, 1}, @deadline, only: id)
      LossyLink.run(Logs.List, list, vehicle, &FtpVehicle.answer/3, options)
    end

    logs = for n <- 1..50, do: bytes(n)
    run = one.(vehicle(logs), 17, [])
    assert {:ok, [%{id: 17, size: 17}]} = run.result
    assert [{_at, %M.LogRequestList{start: 17, end: 17}}] = run.sent
    assert {:ok, [%{id: 17}]} = one.(vehicle(logs), 17, loss: 0.4, seed: 3).result
    assert {:ok, []} = one.(vehicle(logs), 51, []).result
    assert {:ok, []} = one.(vehicle(logs), 0, []).result
    assert {:ok, []} = one.(vehicle([]), 1, []).result
    assert {:ok, [%{id: 0}]} = one.(vehicle(logs, :px4), 0, []).result
  end

  test "pieces in order, each byte once, whatever the order in which they come" do
    property =
      :proper.forall({:proper_types.integer(0, 40), :proper_types.integer(0, 1_000)}, fn {n, seed} ->
        pieces = for i <- 0..(n - 1)//1, do: {7 + 3 * i, <<i, i, i>>}
        {mixed, _rand} = Enum.map_reduce(pieces, :rand.seed_s(:exsss, seed), &shuffled/2)
        mixed = mixed |> Enum.sort() |> Enum.map(&elem(&1, 1))

        {out, order} =
          Enum.reduce(mixed, {[], InOrder.new(7)}, fn {at, bytes}, {out, order} ->
            {more, order} = InOrder.put(order, at, bytes)
            {[out | more], order}
          end)

        IO.iodata_to_binary(out) == Enum.map_join(pieces, &elem(&1, 1)) and order == InOrder.new(7 + 3 * n)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  defp shuffled(piece, rand) do
    {r, rand} = :rand.uniform_s(rand)
    {{r, piece}, rand}
  end

  test "entries that were lost are requested again, alone" do
    run = list(vehicle(for(n <- 1..50, do: bytes(n))), loss: 0.3, seed: 5)
    assert {:ok, entries} = run.result
    assert Enum.map(entries, & &1.size) == Enum.to_list(1..50)
    assert [_first, {_at, %M.LogRequestList{start: start}} | _rest] = Enum.uniq_by(run.sent, &elem(&1, 1))
    assert start > 0
  end

  # Entries `{id, size}`, and what last_log_num says; `lost` entries do not come the first time.
  defp listed(entries, last, options \\ []) do
    count = Keyword.get(options, :count, 3)

    answer = fn lost, %M.LogRequestList{} = asked, _at ->
      entries = for {id, size} <- entries, id in asked.start..asked.end, do: {id, size}
      {gone, entries} = Enum.split_with(entries, fn {id, _size} -> id in lost end)

      {lost -- Enum.map(gone, &elem(&1, 0)),
       for(
         {id, size} <- entries,
         do: {id * 100, %M.LogEntry{id: id, size: size, num_logs: count, last_log_num: last}}
       )}
    end

    list = Logs.List.new({1, 1}, @deadline, Keyword.take(options, [:only]))

    with {:ok, logs} <- LossyLink.run(Logs.List, list, Keyword.get(options, :lost, []), answer).result,
         do: for(log <- logs, do: {log.id, log.size})
  end

  test "X1: an empty entry before the logs costs none of them" do
    logs = [{1, 1000}, {2, 2000}, {3, 3000}]
    assert listed([{0, 0} | logs], 3) == logs
    assert listed([{0, 0} | logs], 3, lost: [2]) == logs
    assert listed([{0, 0} | logs], 3, lost: [3]) == logs
    # A log that was announced is one, however empty.
    assert listed([{1, 1000}, {2, 0}, {3, 3000}], 3) == [{1, 1000}, {2, 0}, {3, 3000}]
    assert listed([{0, 0}, {1, 5}, {2, 6}], 2) == [{0, 0}, {1, 5}, {2, 6}]
  end

  test "X1: a vehicle whose last_log_num says nothing" do
    logs = [{1, 1000}, {2, 2000}, {3, 3000}]

    for last <- [0, 1, 9, 65_535] do
      assert listed(logs, last) == logs
      assert listed([{0, 0} | logs], last) == logs
      assert listed([{0, 0} | logs], last, lost: [1]) == logs
      assert listed([{1, 1000}, {2, 0}, {3, 3000}], last, lost: [3]) == [{1, 1000}, {2, 0}, {3, 3000}]
    end

    assert listed(logs, 0, only: 2, lost: [2]) == [{2, 2000}]
  end

  test "every size, to the last byte" do
    for n <- [0, 1, 89, 90, 91, 180, 23_040, 23_041, 60_000] do
      run = get(vehicle([bytes(n)]), %{id: 1, size: n})
      assert run.result == {:ok, n}
      assert LossyLink.bytes(run) == bytes(n)
      assert match?({_at, %M.LogRequestEnd{}}, List.last(run.sent))
    end

    run = get(vehicle([bytes(60_000)]), %{id: 1, size: 60_000})
    assert Enum.count(run.sent, &match?({_at, %M.LogRequestData{}}, &1)) == 3
    assert [{0, 60_000}, {23_040, 60_000}, {46_080, 60_000}] = run.progress
  end

  test "a log that is smaller than the list said" do
    for n <- [0, 90, 100, 23_040, 30_000] do
      run = get(vehicle([bytes(n)]), %{id: 1, size: 50_000})
      assert run.result == {:ok, n}
      assert LossyLink.bytes(run) == bytes(n)
    end
  end

  test "holes are requested again, and a download goes on where another ended" do
    log = bytes(50_000)
    run = get(vehicle([log]), %{id: 1, size: 50_000}, loss: 0.25, duplicate: 0.1, jitter: 50_000, seed: 3)
    assert run.result == {:ok, 50_000}
    assert LossyLink.bytes(run) == log

    cancel = [{100_000, fn _v -> {:say, {:cancel, 100_000}} end}]
    run = get(vehicle([log]), %{id: 1, size: 50_000}, script: cancel)
    assert run.result == {:error, :cancelled}
    assert %M.LogRequestEnd{} = elem(List.last(run.sent), 1)
    at = Logs.Download.offset(run.machine)
    assert at > 0
    rest = get(vehicle([log]), %{id: 1, size: 50_000}, [], offset: at)
    assert rest.result == {:ok, 50_000}
    assert LossyLink.bytes(rest, at) == binary_part(log, at, 50_000 - at)
  end

  test "every end: no answer, restart, too large" do
    silent = fn v, _message, _now -> {v, []} end
    download = Logs.Download.new(%{id: 1, size: 10}, {1, 1}, @deadline)
    assert LossyLink.run(Logs.Download, download, nil, silent).result == {:error, :no_answer}

    assert LossyLink.run(Logs.List, Logs.List.new({1, 1}, @deadline), nil, silent).result ==
             {:error, :no_answer}

    assert get(vehicle([]), %{id: 1, size: 10}, [], max_bytes: 5).result == {:error, :too_large}
    reboot = [{50_000, fn v -> {:reboot, FtpVehicle.reboot(v)} end}]
    assert get(vehicle([bytes(50_000)]), %{id: 1, size: 50_000}, script: reboot).result == {:error, :rebooted}
  end

  test "on a fast link a vehicle may stand still for seconds before it is given up" do
    silent = fn v, _message, _now -> {v, []} end
    asleep = LossyLink.still(7_000_000, &FtpVehicle.answer/3)

    list = Logs.List.new({1, 1}, @deadline, rtt_us: 5_000)
    assert {:ok, [%{size: 500}]} = LossyLink.run(Logs.List, list, vehicle([bytes(500)]), asleep).result
    run = LossyLink.run(Logs.List, list, nil, silent)
    assert {run.result, run.at, length(run.sent)} == {{:error, :no_answer}, 8_400_000, 19}

    download = Logs.Download.new(%{id: 1, size: 500}, {1, 1}, @deadline, rtt_us: 5_000)
    assert LossyLink.run(Logs.Download, download, vehicle([bytes(500)]), asleep).result == {:ok, 500}
    run = LossyLink.run(Logs.Download, download, nil, silent)
    # The last one ends it.
    assert {run.result, run.at, length(run.sent)} == {{:error, :no_answer}, 8_400_000, 20}
  end

  test "whatever the link does, the log is whole or there is an error" do
    property =
      :proper.forall(scenario(), fn {n, seed, loss, duplicate, jitter} ->
        options = [seed: seed, loss: loss / 100, duplicate: duplicate / 100, jitter: jitter * 1000]
        run = get(vehicle([bytes(n)]), %{id: 1, size: n}, options)
        run.result == {:ok, n} and LossyLink.bytes(run) == bytes(n) and length(run.sent) < 1000
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 100]) == true, inspect(:proper.counterexample())
  end

  defp scenario do
    :proper_types.tuple([
      :proper_types.integer(0, 30_000),
      :proper_types.integer(1, 1_000_000),
      :proper_types.integer(0, 40),
      :proper_types.integer(0, 20),
      :proper_types.integer(0, 300)
    ])
  end

  test "what real PX4 sent: one log, and the beginning of it" do
    messages =
      for %MavCodec.Frame{id: id} = frame <-
            Flight.parse(File.read!("../vehicle/test/fixtures/px4_flight_files.tlog")),
          id in [118, 120],
          do: elem(MavCodec.decode(frame), 1)

    entry = Enum.find(messages, &is_struct(&1, M.LogEntry))
    {list, _asked} = Logs.List.handle(Logs.List.new({1, 1}, @deadline), {:start, 0})

    assert {_list, [{:done, {:ok, [%{size: size} = one]}}]} =
             Logs.List.handle(list, {:message, entry, {1, 1}, 1})

    pieces = Enum.filter(messages, &is_struct(&1, M.LogData))

    {download, _asked} =
      Logs.Download.handle(Logs.Download.new(%{one | size: size}, {1, 1}, @deadline), {:start, 0})

    {download, data} =
      Enum.reduce(pieces, {download, []}, fn m, {d, data} ->
        {d, actions} = Logs.Download.handle(d, {:message, %{m | id: one.id}, {1, 1}, 10})
        {d, data ++ for({:data, offset, bytes} <- actions, do: {offset, bytes})}
      end)

    # The magic bytes of ULog.
    assert [{0, <<"ULog", 1, 0x12, 0x35, _::binary>>} | _more] = data
    assert Logs.Download.offset(download) == data |> Enum.map(&byte_size(elem(&1, 1))) |> Enum.sum()
  end
end
