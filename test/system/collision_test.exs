defmodule Aerie.System.CollisionTest do
  @moduledoc "Two simulated vehicles with one system id on one network are reported, and never mixed up."

  use Aerie.SystemCase, async: true

  alias MavRouter.Router
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Client.LocalEndpoint
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir

  @key {"main", 1}
  @first {-35.363261, 149.165230, 584.0}
  @second {-35.400000, 149.165230, 584.0}

  defp sim(gateway, link, home) do
    options = [firmware: :ardupilot, ready_s: 1.0, system: 1, home: home]
    url = "udpout:127.0.0.1:#{link_port(gateway, link)}"
    {:ok, sim} = SimVehicle.start_link(options ++ [link: url])
    sim
  end

  defp lat(gateway) do
    with %{groups: %{position: %{data: %{lat: lat}}}} when is_number(lat) <- Store.vehicle(gateway, @key),
         do: Float.round(lat, 3)
  end

  defp home({lat, _lon, _alt}), do: Float.round(lat, 3)

  defp says(client, message) do
    bytes = MavCodec.encode(message, system: 255, component: 190)
    {frames, _} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, System.os_time(:microsecond))
    LocalEndpoint.ingress(client, frames)
  end

  defp metric(gateway) do
    {_name, :gauge, _help, [{[vehicle: "VID-001"], value}]} =
      gateway |> Aerie.Api.Metrics.families() |> Enum.find(&(elem(&1, 0) == "gateway_vehicle_collision"))

    value in [1, true]
  end

  # Latitudes of all positions that the client has received.
  defp seen(client) do
    receive do
      {:forward, bytes, _class} ->
        Endpoint.taken(client, length(bytes))
        {frames, _} = MavCodec.Parser.push(MavCodec.Parser.new(), IO.iodata_to_binary(bytes))

        for(
          %{id: 33} = frame <- frames,
          {:ok, %{lat: lat}} = MavCodec.decode(frame),
          do: Float.round(lat / 1.0e7, 3)
        ) ++
          seen(client)
    after
      0 -> []
    end
  end

  for {where, link} <- [{"two links", "link-2"}, {"two peers of one link", "link-1"}] do
    test "#{where}: event, snapshot and metric report it; the first vehicle keeps the id, its state and its commands",
         %{
           tmp_dir: folder
         } do
      %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0", "udpin:127.0.0.1:0"])
      Aerie.Base.PubSub.subscribe(gateway, :events)
      first = sim(gateway, "link-1", @first)
      eventually(fn -> lat(gateway) == home(@first) end, "the first is there")

      other = sim(gateway, unquote(link), @second)
      assert_receive {:fleet, :events, %{type: "collision", data: %{"links" => [[_ | _], [_ | _]]}}}

      # What a busy machine took for one vehicle at first is told apart as it goes on.
      eventually(
        fn ->
          match?(
            %{collision: %{links: [["link-1" <> _], [unquote(link) <> _]]}},
            Store.vehicle(gateway, @key)
          )
        end,
        fn -> "each is on its link: #{inspect(Store.vehicle(gateway, @key).collision)}" end
      )

      eventually(fn -> metric(gateway) end, "the metric")

      eventually(
        fn -> Enum.any?(Router.endpoints(gateway), &(&1.counters.collided > 10)) end,
        "they are apart"
      )

      # From here on everybody sees one vehicle only.
      {:ok, client} = LocalEndpoint.attach(gateway, id: "gcs", side: :client)
      says(client, %M.Heartbeat{type: 6, autopilot: 8})
      collided = fn -> for %{counters: counters} <- Router.endpoints(gateway), do: counters.collided end
      before = Enum.sum(collided.())
      eventually(fn -> Enum.sum(collided.()) > before + 50 end, "the other one goes on")
      eventually(fn -> lat(gateway) end, "the first one goes on")
      seen = eventually(fn -> with [] <- seen(client), do: nil end, "the client sees the first one")

      assert lat(gateway) == home(@first)
      assert Enum.uniq(seen) == [home(@first)]

      # And only one obeys.
      SimVehicle.await(first, & &1.ready)

      for command <- [
            %M.CommandLong{command: 176, param1: 1.0, param2: 4.0},
            %M.CommandLong{command: 400, param1: 1.0}
          ],
          do: says(client, %{command | target_system: 1, target_component: 1})

      SimVehicle.await(first, & &1.armed)
      refute SimVehicle.state(other).armed

      # When the first one is gone, the other one gets the id.
      GenServer.stop(first)
      eventually(fn -> lat(gateway) == home(@second) end, "the other one has the id")
    end
  end

  for {where, link} <- [{"two links", "link-2"}, {"two peers of one link", "link-1"}] do
    test "#{where}: no event of the second vehicle is reported for the flying one", %{tmp_dir: folder} do
      %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0", "udpin:127.0.0.1:0"])
      Aerie.Base.PubSub.subscribe(gateway, :events)
      first = sim(gateway, "link-1", @first)
      SimVehicle.await(first, & &1.ready)

      for {command, values} <- [
            {176, %{param1: 1.0, param2: 4.0}},
            {400, %{param1: 1.0}},
            {22, %{param7: 20.0}}
          ] do
        command = struct!(%M.CommandLong{target_system: 1, target_component: 1, command: command}, values)
        SimVehicle.happen(first, {:message, command, {254, 190}})
      end

      assert_receive {:fleet, :events, %{type: "takeoff"}}
      _other = sim(gateway, unquote(link), @second)
      assert_receive {:fleet, :events, %{type: "collision"}}

      eventually(
        fn -> Enum.any?(Router.endpoints(gateway), &(&1.counters.collided > 100)) end,
        "they are apart for a while"
      )

      # Texts and parameters do not show which of the two sent them. On a busy machine a simulator is late or silent at times.
      either = ["statustext", "param_changed", "link.lost", "link.restored", "stream.contested"]
      assert told() -- (["armed", "mode_change"] ++ either) == []

      # The second one's heartbeat may have been the last before they were separated: until the first one's next.
      eventually(
        fn -> match?(%{armed: true, in_air: true}, Store.vehicle(gateway, @key).groups.mode.data) end,
        fn -> "the state is the first one's: #{inspect(Store.vehicle(gateway, @key).groups.mode.data)}" end
      )

      assert told() -- either == []
    end
  end

  test "a sender without a right to the id gets neither its commands nor its state, whatever it sends", %{
    tmp_dir: folder
  } do
    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0?gcs=deny"])
    Aerie.Base.PubSub.subscribe(gateway, :events)
    first = sim(gateway, "link-1", @first)
    SimVehicle.await(first, & &1.ready)
    eventually(fn -> lat(gateway) == home(@first) end, "the first is there")
    other = sim(gateway, "link-1", @second)
    assert_receive {:fleet, :events, %{type: "collision", data: %{"sign" => "claim", "links" => [[_], [_]]}}}

    command = fn type, params ->
      fields = [vehicle: "VID-001", type: type, params: params, deadline: System.os_time(:second) + 120]
      {:ok, result} = Aerie.Control.Commands.submit(gateway, fields)
      result
    end

    for {type, params} <- [{"set_mode", %{mode: "GUIDED"}}, {"arm", %{}}],
        do: assert(%{status: :completed} = command.(type, params))

    assert SimVehicle.state(first).armed
    refute SimVehicle.state(other).armed
    assert lat(gateway) == home(@first)

    # When the first one is gone, the other one gets the id.
    GenServer.stop(first)
    eventually(fn -> lat(gateway) == home(@second) end, "the other one has the id")
  end

  # The autopilot and the others have sockets of their own, and speak every so many milliseconds.
  for {name, autopilot, others} <- [{"seldom", 60, 1_000}, {"as often as it", 500, 200}] do
    test "a camera and a gimbal that speak #{name} get their commands, and the autopilot its own (R1, R9)",
         %{tmp_dir: folder} do
      %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"])
      port = link_port(gateway, "link-1")
      beat = %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, system_status: 3, mavlink_version: 3}
      camera = %M.Heartbeat{type: 30, autopilot: 8, mavlink_version: 3}
      manager = %M.GimbalManagerStatus{gimbal_device_id: 154}

      parts =
        for {component, messages, ms} <- [
              {1, [beat, %M.Attitude{time_boot_ms: 1}], unquote(autopilot)},
              {100, [camera], unquote(others)},
              {154, [%{camera | type: 26}, manager], unquote(others)}
            ],
            into: %{},
            do: {component, part(port, component, messages, ms)}

      heard = fn -> for(%{system: 1, component: c} <- Router.routes(gateway), do: c) end
      eventually(fn -> [1, 100, 154] -- heard.() == [] end, "all of them are heard")
      managed = fn -> get_in(Store.vehicle(gateway, "VID-001").memory, [:gimbal_manager]) end
      eventually(fn -> managed.() == 154 end, "the gimbal is known as the manager")

      command = fn type, params ->
        fields = [vehicle: "VID-001", type: type, params: params, deadline: System.os_time(:second) + 120]
        {:ok, result} = Aerie.Control.Commands.submit(gateway, fields)
        result.status
      end

      for n <- 1..8, do: assert({n, :accepted} == {n, command.("set_speed", %{speed: 5.0})})
      for n <- 1..3, do: assert({n, :accepted} == {n, command.("camera_photo", %{component: 100})})
      assert command.("gimbal", %{pitch: -30, yaw: 0}) == :accepted
      assert command.("gimbal", %{pitch: -30, yaw: 0, component: 1}) == :accepted

      got =
        Map.new(parts, fn {component, part} ->
          send(part, {:got, self()})
          assert_receive {:got, ^part, commands}
          {component, commands |> Enum.filter(&(&1 in [178, 1000, 2000])) |> Enum.frequencies()}
        end)

      assert got == %{1 => %{178 => 8, 1000 => 1}, 100 => %{2000 => 3}, 154 => %{1000 => 1}}
    end
  end

  # It says its messages, and acknowledges what is for it.
  defp part(port, component, messages, ms) do
    spawn_link(fn ->
      {:ok, socket} = :gen_udp.open(0, [:binary, active: true])
      :timer.send_interval(ms, :beat)
      say = &:gen_udp.send(socket, {127, 0, 0, 1}, port, MavCodec.encode(&1, system: 1, component: component))
      Enum.each(messages, say)
      part_loop(component, messages, say, [])
    end)
  end

  defp part_loop(component, messages, say, got) do
    receive do
      :beat ->
        Enum.each(messages, say)
        part_loop(component, messages, say, got)

      {:got, from} ->
        send(from, {:got, self(), got})
        part_loop(component, messages, say, got)

      {:udp, _socket, _address, _port, bytes} ->
        {frames, _parser} = MavCodec.Parser.push(MavCodec.Parser.new(), bytes)

        # Whoever it is for: what is not for this part must not come here.
        commands =
          for frame <- frames,
              {:ok, %module{} = command} <- [MavCodec.decode(frame)],
              module in [M.CommandLong, M.CommandInt] do
            if command.target_component == component do
              say.(%M.CommandAck{
                command: command.command,
                result: 0,
                target_system: frame.system,
                target_component: frame.component
              })
            end

            command.command
          end

        part_loop(component, messages, say, commands ++ got)
    end
  end

  defp told do
    receive do
      {:fleet, :events, %{type: type}} -> Enum.uniq([type | told()])
    after
      0 -> []
    end
  end
end
