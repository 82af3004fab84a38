defmodule Aerie.Control.Params.FetchTest do
  use ExUnit.Case, async: true

  alias Aerie.{Flight, FtpVehicle, LossyLink, ParamsVehicle}
  alias Aerie.Control.Params.{Cache, Fetch, Param, Table}
  alias MavCodec.Ftp.Packet
  alias MavCodec.Messages.FileTransferProtocol
  alias MavCodec.Ftp.PackedParams

  @deadline 300_000_000

  # Both sides of one vehicle: its FTP server and its parameters.
  defp vehicle(params, style \\ :ardupilot) do
    {FtpVehicle.new(style, %{}, params: SimVehicle.Params.new(numbers(params), :c_cast)),
     ParamsVehicle.new(params)}
  end

  # The simulator's file has numbers only.
  defp numbers(params), do: Enum.filter(params, &is_number(elem(&1, 1)))

  defp answer({ftp, params}, %FileTransferProtocol{} = message, now),
    do: with({ftp, said} <- FtpVehicle.answer(ftp, message, now), do: {{ftp, params}, said})

  defp answer({ftp, params}, message, now),
    do: with({params, said} <- ParamsVehicle.answer(params, message, now), do: {{ftp, params}, said})

  defp run(vehicle, options \\ [], more \\ []),
    do:
      LossyLink.run(
        Fetch,
        Fetch.new({1, 1}, @deadline, Keyword.merge([file: true], more)),
        vehicle,
        &answer/3,
        options
      )

  defp kinds(run), do: run.sent |> Enum.map(fn {_at, m} -> m.__struct__ end) |> Enum.uniq()

  defp values(table), do: Map.new(table.params, fn {name, p} -> {name, {p.value, p.type}} end)
  defp values_of(params), do: Map.new(params, fn {name, value, type} -> {name, {value, type}} end)

  test "ArduPilot's file gives the list, with defaults, all bits and a checksum" do
    params = ParamsVehicle.some(600) ++ [{"BIG", 16_777_217, 6}]
    ftp = FtpVehicle.new(:ardupilot, %{}, params: SimVehicle.Params.new(params, :c_cast))
    run = run({ftp, nil})
    assert {:ok, table} = run.result
    assert values(table) == values_of(params)
    assert %{value: 16_777_217, exact: true, default: 0} = table.params["BIG"]
    assert kinds(run) == [FileTransferProtocol]
    assert Cache.freshness(table, %{file_crc: table.file_crc}) == :fresh
    assert length(run.sent) < 12

    assert {:ok, table} = run({ftp, nil}, [], defaults: false).result
    assert table.params["BIG"].default == nil
  end

  test "a list from before is given again while the vehicle's checksum is that of the list" do
    params = ParamsVehicle.some(600)
    assert {:ok, table} = run(vehicle(params)).result
    run = run(vehicle(params), [], stored: table)
    assert {run.result, length(run.sent)} == {{:ok, table}, 1}
    changed = List.replace_at(params, 5, put_elem(Enum.at(params, 5), 1, 99))
    assert {:ok, other} = run(vehicle(changed), [], stored: table).result
    assert values(other) == values_of(changed)

    # PX4's hash, asked for by name.
    px4 = {FtpVehicle.new(:px4), ParamsVehicle.new(params, encoding: :bytewise)}
    more = [file: false, hash: true, encoding: :bytewise]
    assert {:ok, %Table{hash: hash} = table} = run(px4, [], more).result
    assert hash != nil
    run = run(px4, [], [stored: table] ++ more)
    assert {run.result, length(run.sent)} == {{:ok, table}, 1}
    other = {elem(px4, 0), ParamsVehicle.put(elem(px4, 1), "P8", 3)}
    assert {:ok, %{params: %{"P8" => %{value: 3}}}} = run(other, [], [stored: table] ++ more).result
  end

  test "also at 25 % loss" do
    params = ParamsVehicle.some(1000)

    for seed <- 1..5 do
      run = run(vehicle(params), loss: 0.25, duplicate: 0.05, jitter: 20_000, seed: seed)
      assert {:ok, table} = run.result
      assert values(table) == values_of(params)
    end
  end

  test "over a link that takes far longer than measured, also the file, with few repetitions (T2)" do
    params = ParamsVehicle.some(400)

    for delay <- [300_000, 1_000_000, 3_000_000] do
      run = run(vehicle(params), [delay: delay], rtt_us: 5_000)
      assert {:ok, %Table{file_crc: crc} = table} = run.result
      assert values(table) == values_of(params)
      assert crc != nil
      # The first answers show how long it takes.
      assert length(run.sent) <= 24

      assert {:ok, %Table{file_crc: ^crc}} =
               run(vehicle(params), [delay: delay, loss: 0.1], rtt_us: 5_000).result
    end
  end

  test "without the file the list is taken (P4)" do
    params = ParamsVehicle.some(100)
    run = run(vehicle(params, :px4))
    assert {:ok, %Table{file_crc: nil} = table} = run.result
    assert values(table) == values_of(params)
    assert List.last(run.progress) == {100, 100}
  end

  test "also without an answer to FTP; at once if the vehicle does not offer it" do
    params = ParamsVehicle.some(100)

    deaf = fn v, message, now ->
      if is_struct(message, FileTransferProtocol), do: {v, []}, else: answer(v, message, now)
    end

    assert {:ok, table} =
             LossyLink.run(Fetch, Fetch.new({1, 1}, @deadline, file: true), vehicle(params), deaf).result

    assert values(table) == values_of(params)
    refute FileTransferProtocol in kinds(run(vehicle(params), [], file: false))
  end

  test "a vehicle that says it has FTP and does not answer costs seconds, whatever was measured of the link" do
    params = ParamsVehicle.some(1349)

    deaf = fn v, message, now ->
      if is_struct(message, FileTransferProtocol), do: {v, []}, else: answer(v, message, now)
    end

    for rtt <- [nil, 5_000, 900_000] do
      fetch = Fetch.new({1, 1}, @deadline, file: true, rtt_us: rtt)
      run = LossyLink.run(Fetch, fetch, vehicle(params), deaf)
      assert {:ok, table} = run.result
      assert values(table) == values_of(params)
      assert [first, _second | _more] = for({at, %FileTransferProtocol{}} <- run.sent, do: at)
      assert run.at - first < 15_000_000
      assert Fetch.heard?(run.machine) == false
    end

    # One that gives a checksum, and then nothing, is not waited for for minutes either.
    half = fn
      v, %FileTransferProtocol{payload: <<_seq::16, _session, opcode, _rest::binary>>}, _now
      when opcode != 14 ->
        {v, []}

      v, message, now ->
        answer(v, message, now)
    end

    run = LossyLink.run(Fetch, Fetch.new({1, 1}, @deadline, file: true), vehicle(params), half)
    assert {:ok, table} = run.result
    assert values(table) == values_of(params)
    assert run.at < 30_000_000

    assert Fetch.heard?(run(vehicle(params)).machine)
    assert Fetch.heard?(run(vehicle(params), [], file: false).machine) == nil
  end

  for value <- [:nan, :infinity, :neg_infinity] do
    test "a value that is #{value} does not cost the list" do
      params = List.replace_at(ParamsVehicle.some(100), 7, {"BROKEN", unquote(value), 9})
      run = run(vehicle(params, :px4), [], file: false)
      assert {:ok, table} = run.result
      assert Table.count(table) == 100
      assert %{value: nil, exact: false} = table.params["BROKEN"]

      assert %{value: nil, remark: "not a number" <> _} =
               Enum.find(Table.plain(table).params, &(&1.name == "BROKEN"))

      assert run.at < 5_000_000
    end
  end

  test "a file that changes while it is read has no checksum to be trusted by" do
    params = ParamsVehicle.some(400)

    changes = fn {ftp, list} ->
      {:ok, changed} = SimVehicle.Params.put(ftp.params, "P1", 77)
      {%{ftp | params: changed}, list}
    end

    assert {:ok, %Table{file_crc: nil}} = run(vehicle(params), script: [{90_000, changes}]).result
  end

  test "a restart in the middle: the file is not put together of two" do
    params = ParamsVehicle.some(800)
    restart = fn {ftp, list} -> {FtpVehicle.reboot(ftp), list} end
    run = run(vehicle(params), script: [{110_000, restart}], loss: 0.3)
    assert {:ok, table} = run.result
    assert values(table) == values_of(params)
  end

  test "cancelled and late" do
    cancel = [{50_000, fn _v -> {:say, {:cancel, 50_000}} end}]
    assert run(vehicle(ParamsVehicle.some(100)), script: cancel).result == {:error, :cancelled}
    fetch = Fetch.new({1, 1}, 50_000, file: true)

    assert LossyLink.run(Fetch, fetch, vehicle(ParamsVehicle.some(100)), &answer/3).result ==
             {:error, :deadline}
  end

  test "what real ArduPilot's file begins with is what its list said" do
    bytes =
      for %MavCodec.Frame{id: 110} = frame <-
            Flight.parse(File.read!("../vehicle/test/fixtures/arducopter_flight_files.tlog")),
          {:ok, message} = MavCodec.decode(frame),
          {:ack, %{request: 5, data: data}} <- [Packet.answer(message)],
          into: "",
          do: data

    assert byte_size(bytes) == 2000
    <<magic::binary-size(2), 1392::little-16, 1392::little-16, records::binary>> = bytes

    # Cut where a record ends, with the number of records in the header.
    decoded =
      for cut <- 0..40, n <- 100..220, reduce: nil do
        nil ->
          part = binary_part(records, 0, byte_size(records) - cut)

          with {:error, _why} <- PackedParams.decode(magic <> <<n::little-16, n::little-16>> <> part, 5_000),
               do: nil

        found ->
          found
      end

    assert {:ok, packed} = decoded
    params = Enum.map(packed, &Param.unpack/1)

    list =
      for %MavCodec.Frame{id: 22} = frame <- Flight.frames("arducopter_flight"),
          {:ok, m} = MavCodec.decode(frame),
          m.param_index < 65_535,
          into: %{},
          do: {m.param_id, {m.param_value, m.param_type}}

    # Some were calibrated between the two.
    assert Enum.count(params, &({&1.value * 1.0, &1.type} == list[&1.name])) > 0.95 * length(params)
    assert Enum.all?(params, &(elem(list[&1.name], 1) == &1.type))
  end
end
