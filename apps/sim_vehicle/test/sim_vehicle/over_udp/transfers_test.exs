defmodule SimVehicle.OverUdp.TransfersTest do
  @moduledoc "Parameters, files and logs over UDP, on a good and on a bad link."
  use ExUnit.Case, async: true

  import SimVehicle.GroundStation

  alias MavCodec.Ftp.Packet
  alias MavCodec.Message.Value
  alias MavCodec.CRC
  alias MavCodec.Ftp.PackedParams
  alias MavCodec.Messages, as: M
  alias SimVehicle.Peer

  @bytes for n <- 1..3_000, into: "", do: <<rem(n * 7919, 251)>>

  defp lossy(sim, share),
    do: for(direction <- [:out, :in], do: :ok = SimVehicle.fault(sim, :loss, share, direction))

  # The names by index, after one request for the list and one for each that was lost.
  defp list(peer) do
    {first, peer} = ask(peer, %M.ParamRequestList{}, M.ParamValue, &(&1.param_index < 65_535))
    count = first.param_count
    {values, peer} = Peer.collect(peer, M.ParamValue, &(&1.param_index == count - 1), now() + 500)
    got = for m <- [first | values], m.param_index < 65_535, into: %{}, do: {m.param_index, m}

    Enum.reduce(0..(count - 1), {got, peer}, fn
      index, {got, peer} when is_map_key(got, index) ->
        {got, peer}

      index, {got, peer} ->
        request = %M.ParamRequestRead{param_index: index}
        {value, peer} = ask(peer, request, M.ParamValue, &(&1.param_index == index))
        {Map.put(got, index, value), peer}
    end)
  end

  defp now, do: System.monotonic_time(:millisecond)

  describe "parameters" do
    for firmware <- [:ardupilot, :px4] do
      test "#{firmware}: the list has every index once, and what is lost is read by index (P4)" do
        {sim, peer} = start(unquote(firmware), more_params: [{"EXTRA", 7, 6}])
        lossy(sim, 0.25)
        {values, _peer} = list(peer)
        names = for {_index, m} <- values, uniq: true, do: m.param_id
        assert length(names) == map_size(values)
        assert "EXTRA" in names
        assert values |> Enum.map(fn {_index, m} -> m.param_count end) |> Enum.uniq() == [map_size(values)]
      end

      test "#{firmware}: a set is answered with the value that it has, and stays over a reboot (P3)" do
        {sim, peer} = start(unquote(firmware), more_params: [{"EXTRA", 1.5, 9}])
        lossy(sim, 0.25)
        {2.25, peer} = set_param(peer, "EXTRA", 2.25, 9)
        {2.25, peer} = param(peer, "EXTRA")
        :ok = SimVehicle.reboot(sim)
        SimVehicle.await(sim, &(&1.boots == 2))
        {2.25, _peer} = param(peer, "EXTRA")
      end
    end

    test "ArduPilot casts integers, cuts them to their type, and refuses what is not a number" do
      {_sim, peer} = start(:ardupilot, more_params: [{"BYTE", 1, 2}])
      {5.0, peer} = set_param(peer, "BYTE", 5.0, 9)
      {127.0, peer} = set_param(peer, "BYTE", 300.0, 2)
      {-128.0, peer} = set_param(peer, "BYTE", -300.0, 2)
      {3.0, peer} = set_param(peer, "BYTE", 2.6, 2)
      {3.0, peer} = set_param(peer, "BYTE", :nan, 2)
      {3.0, _peer} = set_param(peer, "BYTE", :infinity, 2)
    end

    test "PX4 has integers as bytes, and _HASH_CHECK tells whether anything has changed (P2, P6)" do
      {_sim, peer} = start(:px4, more_params: [{"INTEGER", 1, 6}])
      {hash, peer} = param(peer, "_HASH_CHECK")

      wire = fn value ->
        <<bits::32>> = <<value::signed-32>>
        Value.float32(bits)
      end

      {now, peer} = set_param(peer, "INTEGER", wire.(-77), 6)
      assert Value.bits32(now) == Value.bits32(wire.(-77))
      {other, peer} = param(peer, "_HASH_CHECK")
      assert other != hash
      {_back, peer} = set_param(peer, "INTEGER", wire.(1), 6)
      assert {^hash, _peer} = param(peer, "_HASH_CHECK")
    end

    for {cm_s, fastest} <- [{1000.0, 10.5}, {300.0, 3.5}] do
      test "a parameter is what the vehicle flies by: ArduPilot at WPNAV_SPEED #{cm_s}" do
        {cm_s, fastest} = {unquote(cm_s), unquote(fastest)}
        {sim, peer} = start(:ardupilot, speed: 20)
        {^cm_s, peer} = set_param(peer, "WPNAV_SPEED", cm_s, 9)
        peer = fly(sim, peer)
        target = %M.SetPositionTargetLocalNed{coordinate_frame: 1, type_mask: 0xFF8, x: 100.0, z: -20.0}
        message = Map.merge(target, %{target_system: 1, target_component: 1})
        Peer.say(peer, message)
        assert SimVehicle.await(sim, &(&1.groundspeed > fastest - 2))
        assert SimVehicle.await(sim, &(&1.north > 50 && &1.groundspeed)) < fastest
      end
    end
  end

  describe "files" do
    for firmware <- [:ardupilot, :px4] do
      test "#{firmware}: a file is read whole, though frames are lost, and its checksum is that of its bytes (T2)" do
        {sim, peer} = start(unquote(firmware), files: %{"/log/a.bin" => @bytes})
        lossy(sim, 0.25)
        assert {@bytes, peer} = read_file(peer, "/log/a.bin")
        {{:ack, %{data: <<crc::little-32>>}}, _peer} = ftp(peer, :crc, data: "/log/a.bin")
        assert crc == CRC.crc32(@bytes)
      end

      test "#{firmware}: a burst is a file in one request, and ends; it can go on where something is missing (T3)" do
        {_sim, peer} = start(unquote(firmware), files: %{"/a" => @bytes})
        {{:ack, %{session: session, data: <<3_000::little-32>>}}, peer} = ftp(peer, :open, data: "/a")

        for from <- [0, 239 * 5], reduce: peer do
          peer ->
            {{:ack, first}, peer} = ftp(peer, :burst, session: session, offset: from, size: 239)
            {more, peer} = Peer.collect(peer, M.FileTransferProtocol, &last?/1, now() + 5_000)
            packets = [first | for(m <- more, {:ack, packet} <- [Packet.answer(m)], do: packet)]
            assert Enum.map_join(packets, & &1.data) == binary_part(@bytes, from, 3_000 - from)
            assert Enum.map(packets, & &1.offset) == Enum.to_list(from..2_999//239)
            peer
        end
      end

      test "#{firmware}: what is written is there, in any order of its pieces, until it is removed" do
        {sim, peer} = start(unquote(firmware))
        lossy(sim, 0.25)
        {{:ack, %{session: session}}, peer} = ftp(peer, :create, data: "/new")

        peer =
          for at <- [478, 0, 239], reduce: peer do
            peer ->
              data = binary_part(@bytes, at, 239)
              {{:ack, _written}, peer} = ftp(peer, :write, session: session, offset: at, data: data)
              peer
          end

        {{:ack, _ended}, peer} = ftp(peer, :terminate, session: session)
        assert {read, peer} = read_file(peer, "/new")
        assert read == binary_part(@bytes, 0, 717)
        {{:ack, %{data: "Fnew\t717" <> _rest}}, peer} = ftp(peer, :list, data: "/")
        {{:ack, _removed}, peer} = ftp(peer, :remove, data: "/new")
        {{:nak, gone}, peer} = ftp(peer, :open, data: "/new")
        assert Packet.error(gone) == :file_not_found
        {{:nak, empty}, _peer} = ftp(peer, :list, data: "/")
        assert Packet.error(empty) == :eof
      end

      test "#{firmware}: a reboot ends the sessions, and files stay" do
        {sim, peer} = start(unquote(firmware), files: %{"/a" => @bytes})
        {{:ack, %{session: session}}, peer} = ftp(peer, :open, data: "/a")
        :ok = SimVehicle.reboot(sim)
        SimVehicle.await(sim, &(&1.boots == 2))
        {{:nak, lost}, peer} = ftp(peer, :read, session: session, size: 239)
        assert Packet.error(lost) == :invalid_session
        assert {@bytes, _peer} = read_file(peer, "/a")
      end

      test "#{firmware}: what it does not know is refused by its reason" do
        {_sim, peer} = start(unquote(firmware), files: %{"/a" => "x"})
        {{:nak, unknown}, peer} = ftp(peer, :list, data: "/", opcode: 99)
        assert Packet.error(unknown) == :unknown_command
        {{:nak, nothing}, peer} = ftp(peer, :crc, data: "/none")
        assert Packet.error(nothing) == :file_not_found
        {{:nak, closed}, peer} = ftp(peer, :read, session: 3, size: 10)
        assert Packet.error(closed) == :invalid_session
        {{:ack, %{session: session}}, peer} = ftp(peer, :open, data: "/a")
        {{:nak, to_read}, _peer} = ftp(peer, :write, session: session, data: "y")
        assert Packet.error(to_read) == :failed
      end
    end

    test "ArduPilot's parameter file is its list, with all bits of the integers; a new value is in the next one" do
      {sim, peer} = start(:ardupilot, more_params: [{"BIG", 16_777_217, 6}])
      lossy(sim, 0.2)
      {file, peer} = read_file(peer, PackedParams.path(false))
      {:ok, params} = PackedParams.decode(file, 5_000)
      {listed, peer} = list(peer)

      assert Enum.map(params, &elem(&1, 0)) ==
               for(index <- 0..(map_size(listed) - 1), do: listed[index].param_id)

      assert {"BIG", 6, 16_777_217, nil} in params
      {900.0, peer} = set_param(peer, "WPNAV_SPEED", 900.0, 9)
      {file, _peer} = read_file(peer, PackedParams.path(true))
      {:ok, params} = PackedParams.decode(file, 5_000)
      assert {"WPNAV_SPEED", 9, 900.0, 900.0} in params
    end
  end

  describe "logs" do
    for {firmware, first} <- [ardupilot: 1, px4: 0] do
      test "#{firmware}: are listed and read, though frames are lost; ids begin at #{first}" do
        {sim, peer} = start(unquote(firmware), logs: [@bytes, "short"])
        lossy(sim, 0.25)
        list = %M.LogRequestList{start: 0, end: 65_535}

        for {id, size} <- [{unquote(first), 3_000}, {unquote(first) + 1, 5}] do
          {entry, _peer} = ask(peer, list, M.LogEntry, &(&1.id == id))
          assert {entry.num_logs, entry.last_log_num, entry.size} == {2, unquote(first) + 1, size}
        end

        {bytes, peer} = log(peer, unquote(first), 3_000)
        assert bytes == @bytes
        # A piece that is not full is the end.
        {%{count: 5, data: "short" <> _zeros}, _peer} =
          ask(peer, %M.LogRequestData{id: unquote(first) + 1, count: 90}, M.LogData, &(&1.count == 5))
      end
    end

    test "there are none: an entry says so; a log that is not there is not answered" do
      {_sim, peer} = start(:px4)
      {%{num_logs: 0, size: 0}, _peer} = ask(peer, %M.LogRequestList{end: 65_535}, M.LogEntry)
      {_sim, peer} = start(:px4, logs: ["x"])

      {nil, _peer} =
        peer
        |> Peer.say(%M.LogRequestData{target_system: 1, target_component: 1, id: 7, count: 90})
        |> Peer.within(M.LogData, fn _any -> true end, now() + 200)
    end

    test "LOG_REQUEST_END stops what is being sent" do
      {_sim, peer} = start(:ardupilot, logs: [String.duplicate("x", 4_000_000)], speed: 1)
      {_piece, peer} = ask(peer, %M.LogRequestData{id: 1, count: 4_000_000}, M.LogData)
      peer = Peer.say(peer, %M.LogRequestEnd{target_system: 1, target_component: 1})
      # What answers to a later question came after the end.
      {_value, peer} = param(peer, "WPNAV_SPEED")
      peer = Peer.forget(peer, M.LogData)
      {_heartbeat, peer} = Peer.await(Peer.forget(peer, M.Heartbeat), M.Heartbeat)
      assert {[], _peer} = Peer.take(peer, M.LogData)
    end
  end

  defp last?(message) do
    case Packet.answer(message) do
      {:ack, packet} -> packet.complete
      {:nak, packet} -> Packet.error(packet) == :eof
      :other -> false
    end
  end
end
