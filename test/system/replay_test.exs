defmodule Aerie.System.ReplayTest do
  @moduledoc "The recordings of a flight, replayed, give the same events as the live gateway."

  use Aerie.SystemCase, async: true

  alias Aerie.Fleet.Replay
  alias MavRouter.Recorder
  alias MavCodec.Messages

  @moduletag :tmp_dir
  # An unusual id: frames that another program sends to this port by mistake make another vehicle.
  @key {"main", 77}
  @vehicle "VID-077"
  @lost_us 5_000_000
  @silences [~w(gcs.lost gcs.restored), ~w(link.lost link.restored)]
  @flight [:ready, {:wait, 1}, :arm, {:takeoff, 6}, {:wait, 1}, :land, :landed, {:wait, 60}]

  for firmware <- [:ardupilot, :px4] do
    test "#{firmware}: the same events", %{tmp_dir: folder} do
      %{gateway: gateway} =
        start_gateway(folder,
          links: ["udpin:127.0.0.1:0", "udpin:127.0.0.1:0"],
          overrides: %{
            "recorder" => %{
              "dir" => Path.join(folder, "recordings"),
              "links" => "always",
              "vehicles" => "always",
              "min_free_mb" => 0
            }
          }
        )

      :ok = Aerie.Base.PubSub.subscribe(gateway, :events)
      link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
      station = station(gateway)

      sim =
        start_supervised!(
          {SimVehicle, firmware: unquote(firmware), system: 77, ready_s: 2.0, link: link, script: @flight}
        )

      events = await([], ["takeoff"])
      # Its operator disconnects while it flies.
      stop_supervised!(station)
      events = await(events, ["landed", "disarmed", "gcs.lost"])
      SimVehicle.fault(sim, :freeze, true)
      recordings = for what <- [{:link, "link-1"}, {:vehicle, @key}], do: complete(gateway, what)
      events = events ++ waiting()

      [link, vehicle] = recordings
      assert_same(events, link, unheard(gateway))
      # Broadcasts are in no vehicle's recording, so it does not show whether a ground station is there.
      assert_same(events, vehicle, ["gcs.lost", "gcs.restored"])
    end
  end

  # What comes before the vehicle has its processes, or while they are full, is in the link's recording, and reaches nobody: on a busy
  # machine some texts of its start, without which reports are told, and the report of who armed it. It is counted.
  defp unheard(gateway) do
    %{unclaimed: unclaimed, overload: overload} = Aerie.Base.Store.link(gateway, "link-1").counters
    dropped = Aerie.Base.Store.counter(gateway, {:vehicle, @vehicle, :inbox_dropped})
    if unclaimed + overload + dropped > 0, do: ["statustext", "report"], else: []
  end

  # A disk that does not answer in time costs frames of a recording, which says so: there is nothing to compare then.
  defp assert_same(_events, %{dropped: dropped, errors: errors}, _without) when dropped > 0,
    do: assert(errors > 0)

  defp assert_same(events, recording, without) do
    assert {:ok, %{summary: %{to: to, damaged_bytes: 0}} = flight} = Replay.run(recording.file)
    # A report waits for its text or for those before it, up to six seconds.
    over = fn e -> if e.type == "report", do: e.time + 6_000_000, else: e.time end
    told = fn events -> for e <- events, e.type not in without, over.(e) <= to, do: e end
    {live, replayed} = {told.(events), told.(Enum.filter(flight.events, &(&1.vehicle == @vehicle)))}
    types = Enum.map(replayed, & &1.type)
    assert ~w(armed takeoff landed disarmed) -- types == [], inspect({types, recording})

    # What waits is looked at ten times a second, so that a report and what came meanwhile may change places. What clients asked for is
    # in no recording, so that a replay may take it for another program's doing (README of Aerie.Fleet.Replay).
    exact = fn events ->
      exact =
        for e <- events,
            e.type not in List.flatten(["stream.contested" | @silences]),
            do: {e.type, facts(e, "report" in without), e.time, e.vehicle_time_ms}

      Enum.sort_by(exact, fn {_type, _data, time, _vehicle_time_ms} -> time end)
    end

    assert exact.(replayed) == exact.(live)
    assert lasting(replayed) == lasting(live)
    # A replay makes up no silence.
    assert Enum.count(replayed, &(&1.type == "link.lost")) <= silences(recording.file, to)
  end

  # Who armed it is told by a report.
  defp facts(%{type: "armed", data: data}, true = _without_reports), do: Map.delete(data, "reason")
  defp facts(%{data: data}, _without_reports), do: data

  # The gateway checks for silence once a second, so those events come up to a second later, and of a silence that is over one of the
  # two may know nothing: that of a machine that stood still for some seconds is only in the recording.
  defp lasting(events) do
    for silence <- @silences,
        %{type: type} = last <- [events |> Enum.filter(&(&1.type in silence)) |> List.last()],
        type == hd(silence),
        do: {type, last.data}
  end

  # The silences of the vehicle in a recording that ends at `to`.
  defp silences(file, to) do
    heard = for %{system: 77, at: at} <- MavCodec.Tlog.Reader.frames!(file), do: at

    (heard ++ [to])
    |> Enum.chunk_every(2, 1, :discard)
    |> Enum.count(fn [last, at] -> at - last >= @lost_us end)
  end

  # Waits until all of these have come, in any order.
  defp await(events, types) do
    case types -- Enum.map(events, & &1.type) do
      [] ->
        events

      missing ->
        receive do
          {:fleet, :events, %{vehicle: @vehicle} = event} -> await(events ++ [event], types)
        after
          600_000 -> flunk("no #{inspect(missing)} after #{inspect(Enum.map(events, & &1.type))}")
        end
    end
  end

  defp waiting do
    receive do
      {:fleet, :events, %{vehicle: @vehicle} = event} -> [event | waiting()]
    after
      0 -> []
    end
  end

  defp complete(gateway, what) do
    recording = Recorder.status(gateway, what)
    :ok = Recorder.stop(gateway, what)
    recording
  end

  # A ground station on the second link.
  defp station(gateway) do
    port = link_port(gateway, "link-2")

    bytes =
      MavCodec.encode(%Messages.Heartbeat{type: 6, autopilot: 8, system_status: 4, mavlink_version: 3},
        system: 255,
        component: 190
      )

    start_supervised!({Task, fn -> talk(bytes, port) end}, id: :station)
    :station
  end

  defp talk(bytes, port) do
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}])

    Stream.repeatedly(fn ->
      :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, bytes)
      receive do: (:stop -> :ok), after: (200 -> :ok)
    end)
    |> Stream.run()
  end
end
