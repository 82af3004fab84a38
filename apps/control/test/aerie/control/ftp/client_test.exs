defmodule Aerie.Control.Ftp.ClientTest do
  use ExUnit.Case, async: true

  alias Aerie.{FtpVehicle, LossyLink}
  alias Aerie.Control.Ftp.Client
  alias MavCodec.Messages.FileTransferProtocol

  @deadline 600_000_000

  defp run(vehicle, operation, options \\ [], more \\ []) do
    client = Client.new(operation, {1, 1}, @deadline, more)
    LossyLink.run(Client, client, vehicle, &FtpVehicle.answer/3, options)
  end

  defp bytes(n), do: for(i <- 1..n//1, into: "", do: <<rem(i * 7919, 251)>>)

  defp opcodes(run),
    do:
      for(
        {_at, %FileTransferProtocol{payload: <<_seq::16, _session, opcode, _::binary>>}} <- run.sent,
        do: opcode
      )

  for style <- [:px4, :ardupilot] do
    test "#{style}: directories, with more entries than fit into an answer" do
      files = for n <- 1..40, into: %{"/fs/sub/x" => ""}, do: {"/fs/file_#{n}.bin", bytes(n)}
      assert {:ok, entries} = run(FtpVehicle.new(unquote(style), files), {:list, "/fs"}).result
      assert length(entries) == 41
      assert %{kind: :file, name: "file_7.bin", size: 7} in entries
      assert %{kind: :directory, name: "sub", size: nil} in entries
      assert run(FtpVehicle.new(unquote(style)), {:list, "/none"}).result == {:ok, []}
    end

    test "#{style}: a file is read in bursts to EOF (T3)" do
      for n <- [0, 1, 239, 240, 20_000] do
        run = run(FtpVehicle.new(unquote(style), %{"/a" => bytes(n)}), {:read, "/a"})
        assert run.result == {:ok, n}
        assert LossyLink.bytes(run) == bytes(n)
        assert run.vehicle.ftp.sessions == %{}
      end

      # 84 pieces in two bursts, an opening and an end.
      run = run(FtpVehicle.new(unquote(style), %{"/a" => bytes(20_000)}), {:read, "/a"})
      assert opcodes(run) == [4, 15, 15, 1]
    end

    test "#{style}: gaps are filled; every byte comes once, at 40 % loss and out of order" do
      for seed <- 1..20 do
        run =
          run(FtpVehicle.new(unquote(style), %{"/a" => bytes(30_001)}), {:read, "/a"},
            loss: 0.4,
            duplicate: 0.1,
            jitter: 30_000,
            seed: seed
          )

        assert run.result == {:ok, 30_001}
        assert LossyLink.bytes(run) == bytes(30_001)
      end
    end

    test "#{style}: a file is written, and its checksum compared" do
      run = run(FtpVehicle.new(unquote(style)), {:write, "/new", bytes(5000)}, loss: 0.2, seed: 3)
      assert run.result == {:ok, :verified}
      assert FtpVehicle.file(run.vehicle, "/new") == bytes(5000)
      assert List.last(run.progress) == {5000, 5000}
      assert run(FtpVehicle.new(unquote(style)), {:write, "/none", ""}).result == {:ok, :verified}
    end

    test "#{style}: a session that is lost by a restart is opened again, and the transfer goes on" do
      script = [{60_000, fn v -> FtpVehicle.reboot(v) end}]
      run = run(FtpVehicle.new(unquote(style), %{"/a" => bytes(50_000)}), {:read, "/a"}, script: script)
      assert run.result == {:ok, 50_000}
      assert LossyLink.bytes(run) == bytes(50_000)

      run =
        run(FtpVehicle.new(unquote(style)), {:write, "/a", bytes(5_000)},
          script: [{300_000, fn v -> FtpVehicle.reboot(v) end}]
        )

      assert run.result == {:ok, :verified}
    end
  end

  test "remove, checksum, and refusals in words" do
    v = FtpVehicle.new(:px4, %{"/a" => bytes(1000)})
    assert run(v, {:crc, "/a"}).result == {:ok, MavCodec.CRC.crc32(bytes(1000))}
    run = run(v, {:remove, "/a"})
    assert run.result == {:ok, nil}
    assert FtpVehicle.file(run.vehicle, "/a") == nil
    assert run(run.vehicle, {:remove, "/a"}, [], seq: 7).result == {:error, :file_not_found}
    assert run(v, {:read, "/none"}).result == {:error, :file_not_found}
    assert run(v, {:crc, "/none"}).result == {:error, :file_not_found}
    assert run(v, {:read, ""}).result == {:error, :bad_path}
    assert run(v, {:read, "a" <> <<0>>}).result == {:error, :bad_path}
    assert run(v, :reset).result == {:ok, nil}
  end

  test "a file that is gone when the first answer was lost is removed" do
    v = FtpVehicle.new(:px4, %{"/a" => "x"})
    # The vehicle's memory of the last answer is gone, too.
    forgets = fn v, message, now ->
      with {v, said} <- FtpVehicle.answer(v, message, now),
           do: {%{v | ftp: %{v.ftp | last: nil}}, if(v.asked == 1, do: [], else: said)}
    end

    assert LossyLink.run(Client, Client.new({:remove, "/a"}, {1, 1}, @deadline), v, forgets).result ==
             {:ok, nil}
  end

  test "PX4's only session is taken back (T4)" do
    v = FtpVehicle.new(:px4, %{"/a" => bytes(500)})
    stuck = run(v, {:read, "/a"}, until: 45_000).vehicle
    assert map_size(stuck.ftp.sessions) == 1
    run = run(stuck, {:read, "/a"})
    assert run.result == {:ok, 500}
    assert Enum.take(opcodes(run), 3) == [4, 2, 4]
  end

  test "a transfer that ended early goes on where it was" do
    v = FtpVehicle.new(:ardupilot, %{"/a" => bytes(40_000)})
    first = LossyLink.run(Client, Client.new({:read, "/a"}, {1, 1}, 130_000), v, &FtpVehicle.answer/3)
    assert first.result == {:error, :deadline}
    at = Client.offset(first.machine)
    assert at > 0
    rest = run(first.vehicle, {:read, "/a"}, [], offset: at, seq: Client.seq(first.machine))
    assert rest.result == {:ok, 40_000}
    assert LossyLink.bytes(rest, at) == binary_part(bytes(40_000), at, 40_000 - at)

    written =
      LossyLink.run(
        Client,
        Client.new({:write, "/b", bytes(9_000)}, {1, 1}, 400_000),
        v,
        &FtpVehicle.answer/3
      )

    at = Client.offset(written.machine)
    assert at in 1..8_999
    rest = run(written.vehicle, {:write, "/b", bytes(9_000)}, [], offset: at)
    assert rest.result == {:ok, :verified}
    refute 6 in opcodes(rest)
  end

  test "a vehicle without FTP, one without bursts, one that does not stop" do
    silent = fn v, _message, _now -> {v, []} end

    assert LossyLink.run(Client, Client.new({:list, "/"}, {1, 1}, @deadline), nil, silent).result ==
             {:error, :no_answer}

    refuses = fn v, %FileTransferProtocol{payload: <<seq::little-16, s, opcode, rest::binary>>} = m, now ->
      if opcode == 15 do
        <<_size, _::binary>> = rest
        payload = <<seq + 1::little-16, s, 129, 1, 15, 0, 0, 0::32, 7>> <> <<0::size(238 * 8)>>
        {v, [{0, %FileTransferProtocol{payload: payload}}]}
      else
        FtpVehicle.answer(v, m, now)
      end
    end

    v = FtpVehicle.new(:px4, %{"/a" => bytes(1000)})
    run = LossyLink.run(Client, Client.new({:read, "/a"}, {1, 1}, @deadline), v, refuses)
    assert run.result == {:ok, 1000}
    assert run(v, {:read, "/a"}, [], max_bytes: 500).result == {:error, :too_large}
  end

  test "on a fast link a vehicle may stand still for seconds before it is given up" do
    client = Client.new({:read, "/a"}, {1, 1}, @deadline, rtt_us: 5_000)
    v = FtpVehicle.new(:px4, %{"/a" => bytes(1000)})
    asleep = LossyLink.still(7_000_000, &FtpVehicle.answer/3)
    assert LossyLink.run(Client, client, v, asleep).result == {:ok, 1000}

    run = LossyLink.run(Client, client, v, fn v, _message, _now -> {v, []} end)
    assert run.result == {:error, :no_answer}
    # 100 ms, 200 ms and 400 ms four times each, then 800 ms.
    assert {run.at, length(run.sent)} == {8_400_000, 19}
  end

  test "an answer to somebody else, or of another vehicle, is not heard" do
    {client, _actions} =
      Client.handle(Client.new({:crc, "/a"}, {1, 1}, @deadline, us: {245, 190}), {:start, 0})

    payload = <<1::little-16, 0, 128, 4, 14, 0, 0, 0::32, 1, 2, 3, 4>> <> <<0::size(235 * 8)>>
    answer = %FileTransferProtocol{target_system: 255, target_component: 190, payload: payload}
    assert {^client, []} = Client.handle(client, {:message, answer, {1, 1}, 1})
    assert {^client, []} = Client.handle(client, {:message, %{answer | target_system: 245}, {2, 1}, 1})

    assert {_c, [{:done, {:ok, 0x04030201}}]} =
             Client.handle(client, {:message, %{answer | target_system: 245}, {1, 1}, 1})
  end

  test "whatever the link does, a read gives the file or an error, and it ends" do
    property =
      :proper.forall(scenario(), fn {n, px4?, seed, loss, duplicate, jitter, reboots} ->
        v = FtpVehicle.new(if(px4?, do: :px4, else: :ardupilot), %{"/a" => bytes(n)})
        script = Enum.map(reboots, &{&1 * 1000, fn v -> FtpVehicle.reboot(v) end})

        options = [
          seed: seed,
          loss: loss / 100,
          duplicate: duplicate / 100,
          jitter: jitter * 1000,
          script: script
        ]

        read = run(v, {:read, "/a"}, options)
        write = run(v, {:write, "/b", bytes(n)}, options)

        read.result == {:ok, n} and LossyLink.bytes(read) == bytes(n) and
          write.result == {:ok, :verified} and FtpVehicle.file(write.vehicle, "/b") == bytes(n)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 150]) == true, inspect(:proper.counterexample())
  end

  defp scenario do
    :proper_types.tuple([
      :proper_types.integer(0, 6000),
      :proper_types.boolean(),
      :proper_types.integer(1, 1_000_000),
      :proper_types.integer(0, 30),
      :proper_types.integer(0, 20),
      :proper_types.integer(0, 200),
      :proper_types.resize(3, :proper_types.list(:proper_types.integer(0, 1000)))
    ])
  end
end
