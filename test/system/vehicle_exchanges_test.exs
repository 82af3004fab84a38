defmodule Aerie.System.VehicleExchangesTest do
  @moduledoc "The gateway's exchanges with simulated autopilots: streams, clocks, ground stations."

  use Aerie.SystemCase, async: true

  alias Aerie.Vehicle.Services.Streams
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir

  @attitude 30
  @key {"main", 1}

  setup %{tmp_dir: folder} = context do
    overrides = %{"mavlink" => Map.merge(%{"local_addr" => "off"}, context[:mavlink] || %{})}

    %{gateway: gateway} =
      start_gateway(folder, links: ["udpin:127.0.0.1:0", "udpin:127.0.0.1:0"], overrides: overrides)

    Aerie.Base.PubSub.subscribe(gateway, :events)

    options = [firmware: :ardupilot, ready_s: 1.0, link: "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"]
    {:ok, sim} = SimVehicle.start_link(Keyword.merge(options, context[:sim] || []))
    eventually(fn -> Store.vehicle(gateway, @key) end, "the vehicle is known")
    %{gateway: gateway, sim: sim}
  end

  defp vehicle(gateway), do: Store.vehicle(gateway, @key)
  defp line(gateway, id), do: vehicle(gateway).streams[id]

  # Whether the clock is known, and the boot that it gives is that of the simulator. One sample will do: the clock of a simulator that gets
  # no time slips, which counts as set, and the samples from before are forgotten.
  defp measured?(%{samples: samples, boot_at: boot_at, error_us: error}, sim) when samples >= 1 do
    before = System.os_time(:microsecond)
    up = round(SimVehicle.state(sim).seconds * 1_000_000)
    boot_at in (before - up - error - 300_000)..(System.os_time(:microsecond) - up + error + 300_000)
  end

  defp measured?(_clock, _sim), do: false

  # Another program's command, as the vehicle receives it.
  defp other(sim, id, hz) do
    command = %M.CommandLong{
      target_system: 1,
      target_component: 1,
      command: 511,
      param1: id * 1.0,
      param2: 1.0e6 / hz
    }

    SimVehicle.happen(sim, {:message, command, {254, 190}})
  end

  # A ground station on the second link, until the test or the caller stops it.
  defp station(gateway, system) do
    port = link_port(gateway, "link-2")
    heartbeat = %M.Heartbeat{type: 6, autopilot: 8, system_status: 4, mavlink_version: 3}
    bytes = MavCodec.encode(heartbeat, system: system, component: 190)

    start_supervised!(
      {Task,
       fn ->
         {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}])

         Stream.repeatedly(fn ->
           :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, bytes)
           receive do: (:stop -> :ok), after: (300 -> :ok)
         end)
         |> Stream.run()
       end},
      id: {:station, system}
    )
  end

  for firmware <- [:ardupilot, :px4] do
    @tag sim: [firmware: firmware]
    test "#{firmware}: the needed streams arrive, also at a client's rate, and the clock is known", %{
      gateway: gateway,
      sim: sim
    } do
      :ok = Streams.want(gateway, @key, self(), @attitude, 25)

      eventually(
        fn -> match?(%{state: :ok, measured: hz} when hz > 17, line(gateway, @attitude)) end,
        "25 a second"
      )

      eventually(
        fn -> Enum.all?(vehicle(gateway).streams, fn {_id, l} -> l.state in [:ok, :missing] end) end,
        fn ->
          inspect(vehicle(gateway).streams)
        end
      )

      # The vehicle's clock counts from its boot. A busy machine makes the simulator late, and an exchange too: what is
      # measured then is right when it is measured again.
      eventually(fn -> measured?(vehicle(gateway).clock, sim) end, fn -> inspect(vehicle(gateway).clock) end)
    end
  end

  test "M2: the gateway gives way to a program that changes a rate twice, and reports it", %{
    gateway: gateway,
    sim: sim
  } do
    :ok = Streams.want(gateway, @key, self(), @attitude, 20)
    eventually(fn -> match?(%{state: :ok, asked: 20}, line(gateway, @attitude)) end, "20 a second")
    :ok = SimVehicle.subscribe(sim)
    other(sim, @attitude, 2)
    # The gateway corrects it once.
    assert_receive {:sim, _sim, {:heard, %M.CommandLong{command: 511, param1: 30.0, param2: 5.0e4}, _gateway}}
    eventually(fn -> match?(%{state: s} when s in [:ok, :yielded], line(gateway, @attitude)) end, "corrected")
    other(sim, @attitude, 2)
    assert_receive {:fleet, :events, %{type: "stream.contested", data: %{"messages" => [message]}}}
    assert %{"name" => "ATTITUDE", "asked_hz" => 20.0, "found_hz" => found, "yielded" => true} = message

    # The interval that the vehicle answers, or what is measured: on a machine that stands still at times any other rate.
    assert found >= 0 and round(found) != 20
    assert %{state: :yielded} = line(gateway, @attitude)
  end

  test "R6: after a reboot the wanted streams are requested again", %{gateway: gateway, sim: sim} do
    :ok = Streams.want(gateway, @key, self(), @attitude, 20)
    eventually(fn -> match?(%{state: :ok, asked: 20}, line(gateway, @attitude)) end, "20 a second")
    :ok = SimVehicle.reboot(sim)
    assert_receive {:fleet, :events, %{type: "reboot"}}
    eventually(fn -> match?(%{state: :ok, asked: 20}, line(gateway, @attitude)) end, "20 a second again")
  end

  @tag sim: [params: %{"FS_GCS_ENABLE" => 1}]
  test "H5: the ground station that the failsafe listens to is known, and its loss is noticed", %{
    gateway: gateway
  } do
    eventually(
      fn -> match?(%{failsafe_gcs: 255, enabled?: true, timeout_s: 5.0}, vehicle(gateway).gcs) end,
      "its parameters are read"
    )

    station(gateway, 253)
    station(gateway, 255)

    eventually(
      fn -> match?(%{known_by: [253, 255], quiet?: true}, vehicle(gateway).gcs) end,
      "both are known"
    )

    stop_supervised!({:station, 255})

    assert_receive {:fleet, :events,
                    %{type: "gcs.lost", data: %{"system" => 255, "failsafe_enabled" => true}}}

    # On a busy machine the other one is quiet for a moment, too.
    eventually(
      fn ->
        with %{quiet?: false, known_by: known} <- vehicle(gateway).gcs,
             do: 253 in known,
             else: (_more_or_less -> false)
      end,
      "the other one is there"
    )

    station(gateway, 255)
    assert_receive {:fleet, :events, %{type: "gcs.restored"}}
  end

  @tag sim: [params: %{"SYSID_MYGCS" => 237}]
  test "H5: a vehicle whose failsafe listens to the gateway's id gets no heartbeat from it", %{
    gateway: gateway
  } do
    eventually(fn -> match?(%{withheld?: true, by_us?: true}, vehicle(gateway).gcs) end, "it is noticed")
    eventually(fn -> Store.counter(gateway, {:identity, :withheld}) > 2 end, "the heartbeat is withheld")
    sent = Store.counter(gateway, {:sent, 0})
    held = Store.counter(gateway, {:identity, :withheld})
    eventually(fn -> Store.counter(gateway, {:identity, :withheld}) > held + 2 end, "and stays so")
    assert Store.counter(gateway, {:sent, 0}) == sent
  end

  @tag sim: [params: %{"SYSID_MYGCS" => 237}], mavlink: %{"i_am_the_gcs" => true}
  test "H5: … unless the gateway is the ground station", %{gateway: gateway} do
    eventually(fn -> match?(%{withheld?: false, by_us?: true}, vehicle(gateway).gcs) end, "it is known")
    sent = Store.counter(gateway, {:sent, 0})
    eventually(fn -> Store.counter(gateway, {:sent, 0}) > sent + 2 end, "heartbeats go out")
  end
end
