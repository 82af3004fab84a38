defmodule Aerie.CLI.StatusTest do
  use ExUnit.Case, async: true

  alias Aerie.CLI.Status.{Format, Lines, Table, View}

  @second 1_000_000
  @now 1_795_213_318 * @second

  defp vehicle(changes \\ %{}) do
    Map.merge(
      %Aerie.Vehicle.Snapshot{
        id: "VID-001",
        vehicle_type: "copter",
        autopilot: :ardupilot,
        status: :online,
        last_heard: @now - 400_000,
        links: ["link-1"],
        groups: %{
          mode: %{at: @now, data: %{mode: "GUIDED", armed: true}},
          position: %{at: @now, data: %{lat: -35.363261, lon: 149.16523, alt_rel: 20.04}},
          velocity: %{at: @now, data: %{groundspeed: 5.0}},
          battery: %{at: @now, data: %{remaining: 0.87, voltage: 12.4}},
          gps: %{at: @now, data: %{fix_name: "3D"}}
        }
      },
      changes
    )
  end

  defp view(changes \\ []) do
    struct!(
      %View{
        now: @now,
        started: @now - 125 * @second,
        vehicles: [vehicle()],
        links: [
          %{
            id: "link-1",
            kind: :udp_server,
            url: "udpin:0.0.0.0:14550",
            status: :up,
            text: "listening",
            rates: %{frames_in: 52.0, writes_out: 1.0, bytes_in: 2100.0},
            counters: %{
              crc_errors: 3,
              lost: 7,
              denied: 0,
              dropped_out: 0,
              kernel_dropped: 5,
              shed: 7,
              overload: 0
            }
          }
        ],
        nats: %{connected: true, url: "nats://127.0.0.1:4222", problem: nil, outbox: %{events: 0}},
        published: 17,
        http: "http://127.0.0.1:4000"
      },
      changes
    )
  end

  defp text(lines), do: lines |> Enum.join("\n") |> String.replace(~r/\e\[\d+m/, "")

  defp logged({message, pairs}),
    do:
      :logfmt
      |> Aerie.Base.Log.Formatter.line(@now, :info, message, pairs)
      |> IO.iodata_to_binary()
      |> String.trim()

  defp rendered(view), do: view |> Lines.render() |> Enum.map(&logged/1)

  test "the table shows what an operator asks first" do
    table = view() |> Table.render(140, 40) |> text()

    for word <- [
          "VID-001",
          "copter ardupilot",
          "GUIDED",
          "ARMED",
          "-35.363261",
          "20.0 m",
          "5.0 m/s",
          "87% 12.4 V",
          "3D"
        ] do
      assert table =~ word
    end

    assert table =~ "NATS connected nats://127.0.0.1:4222  published 17"
    assert table =~ "udpin:0.0.0.0:14550"
    assert table =~ "up 2 min"
  end

  test "lines are written once a minute, and in between those of what changed its state" do
    lines = Lines.render(view())
    assert {^lines, told} = Lines.due(lines, nil, 0)
    moved = Lines.render(view(vehicles: [vehicle(%{last_heard: @now})], published: 20))
    assert {[], told} = Lines.due(moved, told, 5_000)

    lost = Lines.render(view(vehicles: [vehicle(%{status: :lost})], published: 20))
    assert {[{"vehicle", pairs}], told} = Lines.due(lost, told, 10_000)
    assert pairs[:status] == :lost
    assert {[], told} = Lines.due(lost, told, 15_000)
    # Back as it was is a change, too.
    assert {[{"vehicle", _pairs}], told} = Lines.due(lines, told, 20_000)
    assert {^lines, _told} = Lines.due(lines, told, 60_000)
  end

  test "the table and the lines show who may use each way in, refused commands and dropped frames" do
    interface = %{address: "udpin:0.0.0.0:14550 (udp)", who: "anyone who reaches it: vehicles", wide: false}
    [link] = view().links
    view = view(interfaces: [interface], links: [put_in(link.counters.denied, 20)])
    table = view |> Table.render(140, 40) |> text()
    assert table =~ "udpin:0.0.0.0:14550 (udp)  anyone who reaches it: vehicles"
    assert table =~ "link link-1: 20 commands REFUSED"

    assert logged(Lines.interface(interface)) =~
             ~s|msg=interface open="udpin:0.0.0.0:14550 (udp)" to="anyone who reaches it: vehicles"|

    assert Enum.any?(rendered(view), &(&1 =~ "denied=20"))
    view = view(clients: [%{id: "gcs", text: "listening", counters: %{dropped_out: 7}}])
    assert view |> Table.render(140, 40) |> text() =~ "client gcs: 7 frames DROPPED"
    assert Enum.any?(rendered(view), &(&1 =~ "client=gcs dropped_out=7 dropped_in=0 text=listening"))
  end

  test "what came in and was dropped is in the line of its link or client, whichever did not keep up" do
    [link] = view().links
    counters = %{link.counters | kernel_dropped: 1, shed: 20, overload: 300}
    assert Enum.any?(rendered(view(links: [%{link | counters: counters}])), &(&1 =~ "dropped_in=321"))

    clients = [
      %{id: "gcs", text: "listening", counters: %{dropped_out: 0, kernel_dropped: 4, shed: 5}},
      %{id: "quiet", text: "listening", counters: %{dropped_out: 0, kernel_dropped: 0, shed: 0}}
    ]

    table = [clients: clients] |> view() |> Table.render(140, 40) |> text()
    assert table =~ "client gcs: 9 datagrams DROPPED"
    refute table =~ "client quiet"
    lines = rendered(view(clients: clients))
    assert Enum.any?(lines, &(&1 =~ "client=gcs dropped_out=0 dropped_in=9"))
    refute Enum.any?(lines, &(&1 =~ "quiet"))
  end

  test "the NATS address has its login in a terminal but not in a log" do
    view = view(nats_login: "nats://token@127.0.0.1:4222")
    assert view |> Table.render(140, 40) |> text() =~ "NATS connected nats://token@127.0.0.1:4222  published"
    refute view |> rendered() |> text() =~ "token"
  end

  test "events that NATS does not store are shown although it is connected" do
    nats = %{connected: true, url: "nats://h:1", problem: "no space left on device", outbox: %{events: 9}}
    table = [nats: nats] |> view() |> Table.render(140, 40) |> text()
    assert table =~ "events waiting 9\nNATS PROBLEM: no space left on device\n"
    assert [nats: nats] |> view() |> rendered() |> text() =~ ~s(problem="no space left on device")
  end

  test "a leaf node's hub, and what to do when it stores nothing" do
    hub = %{status: :up, waiting: 12, lost: 0, problem: nil, stalled: nil}
    nats = %{connected: true, url: "nats://h:1", problem: nil, outbox: %{events: 0}, hub: hub}
    table = &([nats: %{nats | hub: &1}] |> view() |> Table.render(140, 40) |> text())
    assert table.(hub) =~ "hub  connected  events waiting 12"
    refute table.(hub) =~ "HUB PROBLEM"
    full = %{hub | problem: "make room and restart it", stalled: "make room and restart it"}
    assert table.(full) =~ "HUB PROBLEM: make room and restart it"

    assert [nats: %{nats | hub: full}] |> view() |> rendered() |> text() =~
             ~s(problem="make room and restart it")
  end

  test "a vehicle that another gateway hears is there with that gateway's name" do
    refute view() |> Table.render(140, 40) |> text() =~ "VIA"
    remote = vehicle(%{id: "VID-002", via: "gateway-VID-002", links: []})
    table = [vehicles: [vehicle(), remote]] |> view() |> Table.render(160, 40) |> text()
    assert table =~ ~r/VEHICLE +VIA +STATUS +TYPE/
    assert table =~ ~r/VID-002 +gateway-VID-002 +online +copter/
    assert table =~ ~r/VID-001 {10,}online +copter/
    assert [vehicles: [remote]] |> view() |> rendered() |> text() =~ "via=gateway-VID-002"
  end

  test "an unknown value is a dash, and a lost vehicle is called lost" do
    table = [vehicles: [vehicle(%{groups: %{}, status: :lost})]] |> view() |> Table.render(140, 40) |> text()
    assert table =~ "LOST"
    refute table =~ "disarmed"
    refute table =~ "0.000000"
  end

  test "the table never exceeds the terminal's width and height" do
    vehicles = for n <- 1..60, do: vehicle(%{id: "VID-#{n}"})

    for width <- [20, 80, 200], height <- [5, 24, 100] do
      lines = Table.render(view(vehicles: vehicles), width, height)
      assert length(lines) < max(height, 4)
      for line <- lines, do: assert(String.length(text([line])) <= width)
    end
  end

  test "an empty gateway says what to do" do
    assert [vehicles: [], links: []] |> view() |> Table.render(120, 30) |> text() =~ "UDP port 14550"
  end

  test "a hostile name cannot steer the terminal" do
    assert Format.text("a\e[2Jb\r\nc") == "a[2Jbc"
  end

  test "log lines are key=value pairs; values with blanks are quoted" do
    [vehicle, link, nats] = rendered(view())

    assert vehicle =~
             "time=2026-11-20T22:21:58.000Z level=info msg=vehicle vehicle=VID-001 status=online type=copter"

    assert vehicle =~ "mode=GUIDED armed=true lat=-35.363261"
    assert link =~ "link=link-1 status=up"
    assert nats =~ "nats=connected"

    event = %{
      vehicle: "VID-001",
      type: "statustext",
      time: @now,
      data: %{"text" => "Arming motors", "severity" => 6, "position" => %{"lat" => 1.5}}
    }

    assert logged(Lines.event(event)) =~
             "msg=event vehicle=VID-001 type=statustext at=2026-11-20T22:21:58.000Z position.lat=1.5 severity=6 " <>
               ~s(text="Arming motors")

    assert Lines.note(event) == ~s(VID-001 statustext  severity=6 text="Arming motors")
  end

  test "durations and ages have readable units" do
    assert Format.duration(119 * @second) == "119 s"
    assert Format.duration(7199 * @second) == "119 min"
    assert Format.duration(7500 * @second) == "2 h 5 min"
    assert Format.age(nil) == "-"
    assert Format.age(-5) == "0 s"
    assert Format.age(1_500_000) == "1.5 s"
    assert Format.fit("abcdef", 4) == "abc…"
    assert Format.fit("ab", 4, :right) == "  ab"
  end
end
