defmodule Aerie.System.KillTest do
  @moduledoc """
  `kill -9` of each process of a vehicle's and a link's tree, and of nats-server, while three vehicles fly on links of
  their own: the others lose no frame, what was killed comes back, and no event is lost or doubled in the stream.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.Base.Names

  @moduletag :tmp_dir
  # Killed processes are logged; the log is captured.
  @moduletag :capture_log

  setup %{tmp_dir: folder} do
    %{gateway: gateway} =
      start_gateway(folder, links: for(_n <- 1..3, do: "udpin:127.0.0.1:#{free_udp_port()}"))

    sims =
      for n <- 1..3 do
        link = "udpout:127.0.0.1:#{link_port(gateway, "link-#{n}")}"

        start_supervised!(
          {SimVehicle, firmware: :ardupilot, system: n, link: link, ready_s: 1.0, script: pattern(n)},
          id: {:sim, n}
        )
      end

    for n <- 1..3 do
      eventually(
        fn -> get_in(Store.vehicle(gateway, "VID-00#{n}"), flight()) == true end,
        "vehicle #{n} is in the air"
      )
    end

    %{gateway: gateway, sims: sims}
  end

  test "a killed process of a vehicle or link comes back; the others lose nothing", context do
    %{gateway: gateway, sims: [_first | others]} = context
    key = {"main", 1}

    # The boot text of the firmware is outside any frame: counted as skipped bytes before the first one, and no more after.
    boot_text = for n <- 2..3, into: %{}, do: {n, Store.link(gateway, "link-#{n}").counters.resync_bytes}

    for {role, id} <- [session: key, events: key, tree: key, link: "link-1", link_tree: "link-1"],
        _round <- 1..3 do
      victim = eventually(fn -> Names.whereis(gateway, role, id) end, "#{role} runs")
      reference = Process.monitor(victim)
      Process.exit(victim, :kill)
      assert_receive {:DOWN, ^reference, :process, ^victim, :killed}
      back = eventually(fn -> new_process(gateway, role, id, victim) end, "#{role} is back")
      assert back != victim
    end

    # It does not only exist, it hears its vehicle again.
    before = Store.vehicle(gateway, "VID-001").last_heard
    eventually(fn -> Store.vehicle(gateway, "VID-001").last_heard > before end, "vehicle 1 is heard again")

    for {sim, n} <- Enum.with_index(others, 2) do
      SimVehicle.fault(sim, :freeze, true)
      %{sent: sent} = SimVehicle.stats(sim)
      counters = fn -> Store.link(gateway, "link-#{n}").counters end

      eventually(
        fn -> counters.().frames_in == sent end,
        "link #{n} has all of #{sent} frames: #{inspect(counters.())}"
      )

      assert %{lost: 0, crc_errors: 0, dropped_out: 0, overload: 0} = counters.()
      assert counters.().resync_bytes == boot_text[n]
    end

    assert_events(gateway)
  end

  test "nats-server is killed while events are made: none is lost or doubled, state goes on", context do
    %{gateway: gateway} = context

    for _round <- 1..3 do
      os_pid = nats_os_pid(gateway)
      {_output, 0} = System.cmd("kill", ["-KILL", os_pid])

      eventually(
        fn ->
          nats_os_pid(gateway) not in [nil, os_pid] and
            match?(%{connected: true, server: %{status: :up}}, Aerie.Fleet.Bridge.info(gateway))
        end,
        "nats-server is back and connected"
      )
    end

    published = published(gateway, "state.position")
    eventually(fn -> published(gateway, "state.position") > published end, "state is published again")
    assert_events(gateway)
  end

  # The journal has the events that the gateway made; the stream must have the same ones, in order, once.
  defp assert_events(gateway) do
    # First: what a vehicle that is lost just now adds is not awaited.
    recent =
      for n <- 1..3, name = "VID-00#{n}", into: %{} do
        {name, for(e <- Aerie.Vehicle.Events.Journal.recent(gateway, name), do: {e.seq, e.id, e.type})}
      end

    eventually(
      fn ->
        Aerie.Vehicle.Events.Journal.pending_size(gateway) == 0 and
          Aerie.Fleet.Bridge.info(gateway).outbox.events == 0
      end,
      "every event is confirmed"
    )

    conn = nats_client(gateway)
    events = stream_events(conn)
    assert events != []
    by_vehicle = Enum.group_by(events, & &1["vehicle"])

    for n <- 1..3 do
      name = "VID-00#{n}"
      told = for event <- by_vehicle[name], do: {event["seq"], event["id"], event["type"]}
      assert Enum.map(told, &elem(&1, 0)) == Enum.to_list(1..length(told))
      assert told == Enum.uniq_by(told, &elem(&1, 1))

      assert recent[name] -- told == []

      # Level events alternate: a restart that reported an armed vehicle's arming again would break this.
      for {on, off} <- [{"armed", "disarmed"}, {"takeoff", "landed"}, {"link.lost", "link.restored"}] do
        types = for {_seq, _id, type} <- told, type in [on, off], do: type
        assert types == Enum.take(Stream.cycle([on, off]), length(types))
      end

      assert Enum.count(told, &(elem(&1, 2) == "reboot")) == 0
    end
  end

  defp nats_os_pid(gateway) do
    case File.read(Path.join(Aerie.Fleet.Bridge.info(gateway).server.store_dir, "nats-server.pid")) do
      {:ok, text} -> String.trim(text)
      {:error, :enoent} -> nil
    end
  end

  defp pattern(n), do: SimVehicle.Pilot.pattern(n)

  defp flight,
    do: [Access.key(:groups, %{}), Access.key(:mode, %{}), Access.key(:data, %{}), Access.key(:in_air)]

  defp new_process(gateway, role, id, old) do
    case Names.whereis(gateway, role, id) do
      pid when is_pid(pid) and pid != old -> pid
      _not_yet -> nil
    end
  end

  defp published(gateway, subject) do
    for %{name: "gateway_nats_messages_published_total", samples: samples} <-
          Aerie.Fleet.Bridge.metrics(gateway),
        {[subject: ^subject], n} <- samples,
        reduce: 0,
        do: (sum -> sum + n)
  end
end
