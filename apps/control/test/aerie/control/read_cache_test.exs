defmodule Aerie.Control.ReadCacheTest do
  @moduledoc "Ground stations that read parameters and plans from the gateway; a simulated vehicle behind a lossy link."
  use Aerie.TransferCase, async: true

  alias Aerie.Control.Missions
  alias MavRouter.{Client, Link}
  alias Protocols.Mission.{Item, Plan}
  alias MavCodec.Ftp.Packet
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser

  @moduletag :tmp_dir
  @moduletag :capture_log

  defp served(dir, firmware, options \\ []) do
    {entry, options} = Keyword.pop(options, :entry, %{role: :operator, permissions: [:maintain]})
    {gateway, port} = start(dir, %{clients: [entry]})
    start_supervised!({Aerie.Control.ReadCache.Supervisor, gateway: gateway})
    {client, options} = Keyword.pop(options, :client, %{served: true})
    sim = fly(gateway, port, [firmware: firmware] ++ options)
    {:ok, "gcs"} = Client.add(gateway, Map.merge(%{url: "udpin:127.0.0.1:0", id: "gcs"}, client))
    eventually(fn -> Aerie.Base.Names.whereis(gateway, :read_cache, {"main", 1}) end)
    %{gateway: gateway, sim: sim, port: Link.snapshot(gateway, "gcs").port}
  end

  defp station(c, system) do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: true, ip: {127, 0, 0, 1}, recbuf: 4_000_000])
    :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, c.port)
    station = %{socket: socket, system: system, parser: Parser.new()}
    say(station, %M.Heartbeat{type: 6, autopilot: 8})
    station
  end

  defp say(station, message),
    do: :ok = :gen_udp.send(station.socket, MavCodec.encode(message, system: station.system, component: 190))

  # Messages of the vehicle until `fun` gives something.
  defp hear(station, fun) do
    heard(station, fun, Aerie.Patience.deadline()) || flunk("the station #{station.system} does not hear it")
  end

  # What is lost on the way is said again.
  defp ask(station, message, fun) do
    eventually(fn ->
      say(station, message)
      heard(station, fun, System.monotonic_time(:millisecond) + 1_000)
    end)
  end

  defp heard(%{socket: socket} = station, fun, until) do
    receive do
      {:udp, ^socket, _ip, _port, bytes} ->
        {frames, _parser} = Parser.push_datagram(station.parser, bytes, nil)

        Enum.find_value(frames, fn frame ->
          with {:ok, message} <- MavCodec.decode(frame), do: fun.(message), else: (_unknown -> nil)
        end) || heard(station, fun, until)
    after
      max(until - System.monotonic_time(:millisecond), 0) -> nil
    end
  end

  # All parameters. A station asks again when some are missing and no more come: a busy machine drops datagrams.
  defp list(station, known \\ %{}, until \\ Aerie.Patience.deadline()) do
    more =
      heard(
        station,
        fn
          %M.ParamValue{param_index: 65_535} -> nil
          %M.ParamValue{} = m -> {Map.put(known, m.param_id, m), m.param_count}
          _other -> nil
        end,
        System.monotonic_time(:millisecond) + 5_000
      )

    case more do
      {known, count} when map_size(known) == count ->
        known

      {known, _count} ->
        list(station, known, until)

      nil ->
        if System.monotonic_time(:millisecond) > until,
          do: flunk("only #{map_size(known)} parameters came to #{station.system}")

        say(station, %M.ParamRequestList{target_system: 1, target_component: 1})
        list(station, known, until)
    end
  end

  defp asks(c, type),
    do: for({{:sent, id}, n} <- Store.counters(c.gateway), id == type.id(), do: n) |> Enum.sum()

  test "viewers, who may not ask the vehicle, are always served", %{tmp_dir: dir} do
    c = served(dir, :ardupilot, client: %{}, entry: %{role: :viewer})
    [one, two] = for system <- [201, 202], do: station(c, system)
    for station <- [one, two], do: say(station, %M.ParamRequestList{target_system: 1, target_component: 1})
    assert map_size(list(one)) > 150
    assert map_size(list(two)) > 150
    assert asks(c, M.ParamRequestList) <= 5
  end

  test "V1: a station that speaks MAVLink 1 is served in it", %{tmp_dir: dir} do
    c = served(dir, :ardupilot, client: %{}, entry: %{role: :viewer}, mavlink: 1)
    old = station(c, 201)
    ask = %M.ParamRequestList{target_system: 1, target_component: 1}
    :ok = :gen_udp.send(old.socket, MavCodec.encode(ask, system: 201, component: 190, version: 1))
    assert versions(old, %{}) == [1]
  end

  # Those in which the whole list comes.
  defp versions(%{socket: socket} = station, known) do
    receive do
      {:udp, ^socket, _ip, _port, bytes} ->
        {frames, _parser} = Parser.push_datagram(station.parser, bytes, nil)

        values =
          for %{version: version} = frame <- frames,
              {:ok, %M.ParamValue{} = m} <- [MavCodec.decode(frame)],
              do: {m, version}

        known = for {m, version} <- values, into: known, do: {m.param_index, version}

        if Enum.any?(values, fn {m, _version} -> m.param_count == map_size(known) end),
          do: known |> Map.values() |> Enum.uniq(),
          else: versions(station, known)
    after
      Aerie.Patience.ms() -> flunk("no whole list came, only #{map_size(known)} parameters")
    end
  end

  for firmware <- [:ardupilot, :px4] do
    test "#{firmware}: twenty stations at once cost one reading; a value that changed is not given", %{
      tmp_dir: dir
    } do
      c = served(dir, unquote(firmware))
      stations = for n <- 1..20, do: station(c, 200 + n)
      for station <- stations, do: say(station, %M.ParamRequestList{target_system: 1, target_component: 1})
      lists = for station <- stations, do: list(station)

      assert [values] =
               lists |> Enum.map(&Map.new(&1, fn {name, m} -> {name, m.param_value} end)) |> Enum.uniq()

      assert map_size(values) > 150
      # One reading, which asks up to five times while the vehicle is silent.
      assert asks(c, M.ParamRequestList) <= 5

      {name, new} =
        if unquote(firmware) == :px4, do: {"MIS_TAKEOFF_ALT", 9.5}, else: {"PILOT_TKOFF_ALT", 150.0}

      [one, two | _] = stations
      type = lists |> hd() |> Map.fetch!(name) |> Map.fetch!(:param_type)

      set = %M.ParamSet{
        target_system: 1,
        target_component: 1,
        param_id: name,
        param_value: new,
        param_type: type
      }

      say(one, set)
      hear(one, &match?(%M.ParamValue{param_id: ^name, param_value: ^new}, &1))
      read = %M.ParamRequestRead{target_system: 1, target_component: 1, param_id: name, param_index: -1}
      say(two, read)

      # By what the vehicle said to the first, or to this one.
      hear(two, &match?(%M.ParamValue{param_id: ^name, param_value: ^new}, &1))

      # What is left of the first list may come before it: the first one was complete with what the vehicle itself sent to all.
      index =
        ask(two, %M.ParamRequestList{target_system: 1, target_component: 1}, fn
          %M.ParamValue{param_id: ^name, param_value: ^new, param_index: index} when index < 65_535 -> index
          _other -> nil
        end)

      # Then by its index.
      say(two, %{read | param_id: "", param_index: index})
      assert %{param_id: ^name} = hear(two, &if(match?(%M.ParamValue{param_index: ^index}, &1), do: &1))
    end

    test "#{firmware}: a plan is read once for all stations, and again when it was changed", %{tmp_dir: dir} do
      c = served(dir, unquote(firmware), loss: 0.05)

      items =
        for n <- 1..12,
            do: %Item{
              command: if(n == 1, do: 22, else: 16),
              frame: 3,
              params: {0.0, 0.0, 0.0, nil},
              x: -353_632_610 + n,
              y: 1_491_652_300,
              z: 20.0
            }

      assert {:ok, %Result{status: status}} =
               Missions.upload(c.gateway, "VID-001", :mission, %Plan{items: items})

      # Whether it can be flown PX4 may say too late for a busy machine.
      assert status in [:completed, :accepted]

      stations = for n <- 1..5, do: station(c, 200 + n)
      plans = for station <- stations, do: read_plan(station)
      assert [plan] = Enum.uniq(plans)
      assert length(plan) == if(unquote(firmware) == :ardupilot, do: 13, else: 12)
      lists = asks(c, M.MissionRequestList)
      assert read_plan(hd(stations)) == plan
      assert asks(c, M.MissionRequestList) == lists

      assert {:ok, %Result{status: status}} =
               Missions.upload(c.gateway, "VID-001", :mission, %Plan{items: Enum.take(items, 5)})

      assert status in [:completed, :accepted]

      assert length(read_plan(hd(stations))) == length(plan) - 7
    end
  end

  test "twenty stations that read ArduPilot's parameter file at once cost one reading; a changed value is in the next one",
       %{
         tmp_dir: dir
       } do
    c = served(dir, :ardupilot, loss: 0.02)
    stations = for n <- 1..20, do: station(c, 200 + n)
    assert [params] = stations |> Enum.map(&file/1) |> Enum.uniq()
    assert map_size(params) > 150

    set = %M.ParamSet{
      target_system: 1,
      target_component: 1,
      param_id: "PILOT_TKOFF_ALT",
      param_value: 150.0,
      param_type: 9
    }

    [one, two | _] = stations
    ask(one, set, &match?(%M.ParamValue{param_id: "PILOT_TKOFF_ALT", param_value: 150.0}, &1))
    # What was open may be refused; what is opened now has the new value.
    assert %{"PILOT_TKOFF_ALT" => 150.0} = file(two)

    # The gateway's own readings: the checksums before and after the file, and the file, twice and a few repetitions.
    assert Map.new(Store.counters(c.gateway))[:served_messages] > 20 * 10
  end

  # As MAVProxy does: opens, reads piece by piece, ends.
  defp file(station, n \\ 0) do
    ack = ftp(station, :open, n, data: "@PARAM/param.pck")
    assert %{opcode: 128, session: 7} = ack
    {bytes, n} = pieces(station, n + 1, 0, "")
    ftp(station, :terminate, n + 1, [])
    {:ok, params} = MavCodec.Ftp.PackedParams.decode(bytes, 5_000)
    Map.new(params, fn {name, _type, value, _default} -> {name, value} end)
  end

  defp pieces(station, n, offset, bytes) do
    case ftp(station, :read, n, size: 239, offset: offset) do
      %{opcode: 128, data: data} -> pieces(station, n + 1, offset + byte_size(data), bytes <> data)
      %{opcode: 129, data: <<6>>} -> {bytes, n}
    end
  end

  # The answer to a request; it is repeated while none comes.
  defp ftp(station, opcode, seq, fields) do
    fields = [opcode: Packet.opcode(opcode), size: byte_size(fields[:data] || "")] |> Keyword.merge(fields)
    message = Packet.message(struct!(%Packet{seq: seq, session: 7}, fields), {1, 1})
    system = station.system

    ask(station, message, fn
      %M.FileTransferProtocol{target_system: ^system} = m ->
        with {_kind, %{seq: at} = packet} when at == seq + 1 <- Packet.answer(m),
             do: packet,
             else: (_other -> nil)

      _other ->
        nil
    end)
  end

  defp read_plan(station) do
    say(station, %M.MissionRequestList{target_system: 1, target_component: 1})
    system = station.system
    count = hear(station, &if(match?(%M.MissionCount{target_system: ^system}, &1), do: &1.count))

    items =
      for seq <- 0..(count - 1)//1 do
        say(station, %M.MissionRequestInt{target_system: 1, target_component: 1, seq: seq})

        hear(
          station,
          &if(match?(%M.MissionItemInt{target_system: ^system, seq: ^seq}, &1), do: {seq, &1.command, &1.x})
        )
      end

    say(station, %M.MissionAck{target_system: 1, target_component: 1})
    items
  end

  test "a client without it asks the vehicle", %{tmp_dir: dir} do
    c = served(dir, :ardupilot, client: %{served: false})
    station = station(c, 201)
    say(station, %M.ParamRequestList{target_system: 1, target_component: 1})
    hear(station, &match?(%M.ParamValue{param_index: 100}, &1))
    assert asks(c, M.FileTransferProtocol) == 0
    assert Map.new(Store.counters(c.gateway))[:served_messages] == nil
  end
end
