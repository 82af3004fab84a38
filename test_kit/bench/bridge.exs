# How much the bridge carries against the real nats-server on this machine, and how long a killed server is missed.
#
#     bin/bench bridge

Code.require_file("harness.exs", __DIR__)
[] = Bench.Options.read(__ENV__.file, [])

defmodule BridgeBench do
  alias Aerie.Base.{Names, PubSub, Store}
  alias Aerie.Fleet.Bridge
  alias Aerie.Fleet.Bridge.Events.Outbox
  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.Events.Journal
  alias Bench.{Gateway, Sample}

  @states 50_000
  @written 20_000

  def main(dir) do
    gateway = make_ref()
    config = Gateway.config(dir, [{"nats.port", 0}])
    Gateway.parts(gateway, config, [Store, PubSub])
    PubSub.subscribe(gateway, :bridge)

    start =
      Sample.ms(fn ->
        Gateway.parts(gateway, config, [Bridge.Supervisor])
        await(&connected?/1)
      end)

    IO.puts("from nothing to connected with streams: #{round(start)} ms")
    states(gateway)
    for {vehicles, each} <- [{1, 3000}, {100, 40}], do: events(gateway, vehicles, each)
    killed(Path.join(dir, "nats/nats-server.pid"))
    outbox(Path.join(dir, "outbox-alone"))
    Supervisor.stop(Names.via(gateway, :bridge))
  end

  defp connected?(info), do: info[:status] == :up and info[:streams] == :ok

  defp await(wanted?) do
    receive do
      {:fleet, :bridge, {:connection, info}} -> wanted?.(info) || await(wanted?)
      {:fleet, :bridge, _other} -> await(wanted?)
    end
  end

  defp states(gateway) do
    data = %{
      data: %{lat: 47.3977419, lon: 8.5455938, alt_msl: 488.1, alt_rel: 10.2, heading: 271.5},
      time_boot_ms: 123_456
    }

    time =
      Sample.ms(fn ->
        for n <- 1..@states, do: Bridge.publish_state(gateway, "V#{rem(n, 250)}", :position, data, n)
      end)

    us = Float.round(time * 1000 / @states, 1)
    IO.puts("state: #{us} us in the vehicle's process for each publish_state/5")
    published = settled(gateway, -1)
    superseded = Gateway.metric(gateway, "gateway_nats_state_superseded_total")

    IO.puts(
      "state: of #{@states} as fast as one process can, #{published} published, #{superseded} superseded by newer ones"
    )
  end

  defp settled(gateway, before) do
    case Gateway.metric(gateway, "gateway_nats_messages_published_total") do
      ^before -> before
      now -> Process.sleep(100) && settled(gateway, now)
    end
  end

  defp events(gateway, vehicles, each) do
    time =
      Sample.ms(fn ->
        for v <- 1..vehicles do
          event =
            &Event.new("V#{v}", "statustext", vehicles * 1_000_000 + &1, &1, &1, %{
              "text" => "PreArm: check #{&1}"
            })

          Journal.commit(gateway, "V#{v}", :state, Enum.map(1..each, event))
        end

        Sample.until(fn -> Journal.pending_size(gateway) == 0 end, 1)
      end)

    count = vehicles * each

    IO.puts(
      "events: #{count} of #{vehicles} vehicles confirmed in #{round(time)} ms, #{round(count / time * 1000)}/s"
    )
  end

  defp killed(pid_file) do
    pid = pid_file |> File.read!() |> String.trim()

    back =
      Sample.ms(fn ->
        System.cmd("kill", ["-KILL", pid])
        await(&(&1[:status] == :down))
        await(&connected?/1)
      end)

    IO.puts("kill -9 of nats-server: connected again with streams after #{round(back)} ms")
  end

  defp outbox(dir) do
    {:ok, outbox} = Outbox.open(dir, max_bytes: 67_108_864, segment_bytes: 1_048_576)

    record = %Outbox.Record{
      id: String.duplicate("a", 32),
      vehicle: "V1",
      subject: "fleet.prod.V1.event.statustext",
      body: String.duplicate("b", 200)
    }

    time =
      Sample.ms(fn ->
        Enum.reduce(1..@written, outbox, fn _, outbox ->
          {:ok, outbox} = Outbox.append(outbox, [record])
          outbox
        end)
      end)

    IO.puts("outbox: #{Float.round(time * 1000 / @written, 1)} us for each event written alone (no fsync)")
  end
end

Bench.Gateway.in_folder("bridge", &BridgeBench.main/1)
