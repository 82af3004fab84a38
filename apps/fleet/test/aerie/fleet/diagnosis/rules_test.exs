defmodule Aerie.Fleet.Diagnosis.RulesTest do
  @moduledoc "Conditions whose causes need time, a second machine or another clock: facts as the read model has them."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Diagnosis
  alias Aerie.Fleet.Diagnosis.{Condition, Trend}
  alias MavRouter.Link.Serial.Finding
  alias Aerie.Vehicle.Services.Gcs

  @second 1_000_000
  @now 1_795_000_000 * @second

  defp facts(changes \\ %{}) do
    Map.merge(
      %{
        now: @now,
        mono: 0,
        clock_offset: 0,
        links: [],
        vehicles: [],
        endpoints: [],
        clients: [],
        identity: %{system: 237, component: 191, alarm: nil},
        nats: nil,
        nats_off?: true,
        recorder: nil,
        audit: nil,
        signing: %{keys: [], pending: [], not_stored: nil}
      },
      changes
    )
  end

  defp link(changes) do
    Map.merge(
      %{
        id: "radio",
        kind: :udp_server,
        status: :up,
        url: "udpin:0.0.0.0:14550",
        text: "listening",
        reason: nil,
        since: @now - 60 * @second,
        last_heard: @now,
        port: 14_550,
        spec: %{server: true, recorded: false},
        diagnosis: [],
        overload: nil,
        peers: [],
        sources: %{},
        counters: %{frames_in: 0, bytes_in: 0},
        quality: nil
      },
      changes
    )
  end

  defp vehicle(changes) do
    Map.merge(
      %{
        id: "VID-001",
        system_id: 1,
        status: :online,
        links: ["radio"],
        firmware: "4.6.3",
        mavlink_version: 2,
        collision: nil,
        clock: %{samples: 5},
        streams: %{},
        high_latency: %{only?: false},
        gcs: Gcs.show(Gcs.new(), @now),
        signing: nil
      },
      changes
    )
  end

  # A look, and another one half a minute later.
  defp conditions(before, later \\ nil) do
    {_first, diagnosis} = Diagnosis.step(Diagnosis.new(), before)
    {conditions, _diagnosis} = Diagnosis.step(diagnosis, Map.put(later || before, :mono, 30_000))
    conditions
  end

  defp names(before, later \\ nil), do: Enum.map(conditions(before, later), & &1.name)
  defp grows(counters), do: {facts(%{links: [link(%{})]}), facts(%{links: [link(%{counters: counters})]})}

  test "nothing is wrong with a gateway that has nothing" do
    assert conditions(facts()) == []
  end

  test "the machine's clock is set, forward or back; a slewed one is not" do
    assert [%{name: :clock_jump, severity: :warning, evidence: ["0 s ago by +3600.0 s"]}] =
             conditions(facts(), facts(%{clock_offset: 3_600 * @second}))

    assert [%{severity: :notice, evidence: ["0 s ago by -2.0 s"]}] =
             conditions(facts(), facts(%{clock_offset: -2 * @second}))

    assert conditions(facts(), facts(%{clock_offset: 300_000})) == []
  end

  test "reports a jump for ten minutes" do
    {_facts, trend} = Trend.step(Trend.new(), facts())
    {_facts, trend} = Trend.step(trend, facts(%{mono: 1_000, clock_offset: 9 * @second}))

    {%{clock_steps: [{599_000, 9_000_000}]}, trend} =
      Trend.step(trend, facts(%{mono: 600_000, clock_offset: 9 * @second}))

    assert {%{clock_steps: []}, _trend} =
             Trend.step(trend, facts(%{mono: 602_000, clock_offset: 9 * @second}))
  end

  test "ports: no permission, in use by somebody, gone, silent" do
    for {reason, name, words} <- [
          {:eacces, :serial_permission, "dialout"},
          {{:in_use, "mavproxy.py (process 812)"}, :serial_busy, "fuser"},
          {:enoent, :serial_absent, "Plug it in"}
        ] do
      finding = Finding.failed("/dev/ttyUSB0", reason)
      serial = link(%{kind: :serial, status: :down, diagnosis: [finding]})

      assert [%Condition{name: ^name, severity: :error, mend: mend, evidence: [_one]}] =
               conditions(facts(%{links: [serial]}))

      assert mend =~ words
    end

    silent =
      link(%{
        kind: :serial,
        status: :down,
        diagnosis: [Finding.silent("/dev/ttyUSB0", 5), Finding.silent("/dev/ttyUSB1", 5)]
      })

    assert [%{name: :serial_silent, evidence: [_one, _two]}] = conditions(facts(%{links: [silent]}))
  end

  test "what the router counts: refused peers and vehicles, denied commands, wrong signatures, slow sessions" do
    for {counter, name} <- [
          peers_refused: :peers_refused,
          refused: :vehicles_refused,
          denied: :commands_denied,
          overload: :overload,
          looped: :gateway_loop
        ] do
      {before, later} = grows(%{:frames_in => 10, :bytes_in => 100, counter => 3})
      assert [%{name: ^name, evidence: [evidence]}] = conditions(before, later)
      assert evidence =~ "3 "
      # It is over when nothing more is counted.
      assert names(later) == []
    end

    signed = link(%{signing: %{rejected: 4}})

    assert [%{name: :signing_refused, subject: {:link, "radio"}}] =
             conditions(facts(%{links: [link(%{signing: %{rejected: 0}})]}), facts(%{links: [signed]}))
  end

  test "a link that drops datagrams; one that loses a part of its frames" do
    assert [%{name: :overload, severity: :error}] =
             conditions(facts(%{links: [link(%{overload: %{since: @now, datagrams: 9}})]}))

    busy = &facts(%{links: [link(%{overload: %{since: @now, datagrams: 9}, counters: %{shed_new: &1}})]})
    assert [%{name: :overload, evidence: ["9 datagrams" <> _, "5 in " <> _]}] = conditions(busy.(0), busy.(5))

    gcs = link(%{id: "gcs", overload: %{since: @now, datagrams: 7}})

    assert [%{name: :overload, severity: :error, subject: {:client, "gcs"}, evidence: ["7 datagrams" <> _]}] =
             conditions(facts(%{clients: [gcs]}))

    lossy = link(%{quality: %{loss: 0.25, rtt_ms: 812.0}})

    assert [%{name: :lossy_link, title: "25 % " <> _, evidence: [evidence]}] =
             conditions(facts(%{links: [lossy]}))

    assert evidence =~ "812 ms"
  end

  test "counters that begin again, and links that are new, have not grown by what they were" do
    assert names(
             facts(%{links: [link(%{counters: %{denied: 50}})]}),
             facts(%{links: [link(%{counters: %{denied: 0}})]})
           ) == []

    assert names(facts(), facts(%{links: [link(%{counters: %{denied: 50}})]})) == []
  end

  test "a client that does not take its frames" do
    endpoint =
      &%{side: :client, owner: "ws-7", counters: %{frames_out: 100, dropped_state: &1, dropped_bulk: 0}}

    assert [%{name: :slow_client, subject: {:client, "ws-7"}, evidence: ["40 frames dropped" <> _]}] =
             conditions(facts(%{endpoints: [endpoint.(2)]}), facts(%{endpoints: [endpoint.(42)]}))
  end

  test "a vehicle that answers and does not send what is wanted; rates that are not what was asked" do
    streams =
      for id <- [30, 33, 24, 74], into: %{}, do: {id, %{state: :missing, wanted: 4, asked: 4, measured: nil}}

    assert [%{name: :no_streams, evidence: [evidence]}] =
             conditions(facts(%{vehicles: [vehicle(%{streams: streams})]}))

    assert evidence =~ "4 of 4" and evidence =~ "ATTITUDE"
    yielded = %{30 => %{state: :yielded, wanted: 10, asked: 10, measured: 4.0}}

    assert [
             %{
               name: :contested_streams,
               title: title,
               evidence: ["ATTITUDE: requested 10.0 Hz, measured 4.0 Hz"]
             }
           ] =
             conditions(facts(%{vehicles: [vehicle(%{streams: yielded})]}))

    refute title =~ "another program"

    # A recording answers nothing.
    replayed = facts(%{links: [link(%{kind: :replay})], vehicles: [vehicle(%{streams: streams})]})
    assert conditions(replayed) == []
  end

  test "H5: a failsafe that listens to a station that is not there" do
    station = %{system: 254, component: 190, type: 6, via: "qgc", last_heard: @now}

    gcs =
      Gcs.new()
      |> Gcs.vehicle(:ardupilot, "copter")
      |> Gcs.param("SYSID_MYGCS", 255)
      |> Gcs.param("FS_GCS_ENABLE", 1)

    heard = gcs |> Gcs.stations([station], {237, 191}) |> Gcs.show(@now)

    assert [%{name: :gcs_id_mismatch, evidence: [listens, "ground stations heard: 254"], mend: mend}] =
             conditions(facts(%{vehicles: [vehicle(%{gcs: heard})]}))

    assert listens =~ "255"
    assert mend =~ "255" and mend =~ "254"
    right = gcs |> Gcs.stations([%{station | system: 255}], {237, 191}) |> Gcs.show(@now)
    assert conditions(facts(%{vehicles: [vehicle(%{gcs: right})]})) == []
    off = gcs |> Gcs.param("FS_GCS_ENABLE", 0) |> Gcs.stations([station], {237, 191}) |> Gcs.show(@now)
    assert conditions(facts(%{vehicles: [vehicle(%{gcs: off})]})) == []
  end

  test "a vehicle with another key; a key that cannot be used; stamps that cannot be stored (S6)" do
    rejected = %{state: :rejected, key: "main/1", rejected: 70}

    assert [%{name: :signing_refused, subject: {:vehicle, "VID-001"}}] =
             conditions(facts(%{vehicles: [vehicle(%{signing: rejected})]}))

    keys = [%{key: "main/1", error: "the file is not readable"}]
    signing = %{keys: keys, pending: [], not_stored: "no space left on device"}
    assert Enum.sort(names(facts(%{signing: signing}))) == [:signing_key_unusable, :signing_not_stored]
  end

  test "a full disk: recordings, the audit log, the outbox" do
    recording = %{state: :paused, label: "main-VID-001", reason: "no space left on device"}
    recorder = %{dir: "var/recordings", recordings: [recording], space: %{free: 4_000_000, low: true}}
    nats = %{connected: true, problem: nil, outbox: %{events: 3, problem: "no space left on device"}}

    found =
      conditions(facts(%{recorder: recorder, audit: "no space left on device", nats: nats, nats_off?: false}))

    assert Enum.map(found, & &1.name) == [:audit_failing, :outbox_failing, :recordings_stopped]
    assert %{evidence: ["main-VID-001: no space left on device", "3 MB are free"]} = List.last(found)
  end

  test "NATS that is connected and stores nothing" do
    nats = %{connected: true, problem: "no event was confirmed for 30 s", outbox: %{events: 12, problem: nil}}

    assert [%{name: :nats_not_confirming, evidence: [_problem, "12 events wait"]}] =
             conditions(facts(%{nats: nats, nats_off?: false}))

    assert conditions(facts(%{nats: nats, nats_off?: true})) == []

    url =
      Map.merge(nats, %{mode: :url, url: "nats://h:1", outbox: %{events: 12, problem: nil, silent?: true}})

    assert [%{mend: mend}] = conditions(facts(%{nats: url, nats_off?: false}))
    assert mend =~ "disk of nats-server at nats://h:1 was full, make room and restart it"
  end

  test "a leaf node's hub: away is a notice, one that stores nothing an error" do
    nats = &%{connected: true, problem: nil, outbox: %{events: 0, problem: nil}, hub: &1}
    found = &conditions(facts(%{nats: nats.(&1), nats_off?: false}))
    hub = %{status: :up, waiting: 7, lost: 0, problem: nil, stalled: nil}
    assert found.(hub) == []

    assert [%{name: :hub_unreachable, severity: :notice, evidence: ["it refuses the key", "7 events wait"]}] =
             found.(%{hub | status: :down, problem: "it refuses the key"})

    assert [%{name: :hub_not_confirming, severity: :error, mend: mend}] =
             found.(%{hub | stalled: "it confirms no event"})

    assert mend =~ "the hub's nats-server was full, make room and restart it"
  end

  test "a condition keeps the time when it was noticed, until it is gone" do
    {[%{since: @now}], diagnosis} = Diagnosis.step(Diagnosis.new(), facts(%{audit: "full"}))
    {[%{since: @now}], diagnosis} = Diagnosis.step(diagnosis, facts(%{audit: "full", now: @now + 5}))
    {[], diagnosis} = Diagnosis.step(diagnosis, facts(%{now: @now + 6}))
    later = @now + 7
    assert {[%{since: ^later}], _diagnosis} = Diagnosis.step(diagnosis, facts(%{audit: "full", now: later}))
  end

  test "a rule that fails is a condition of its own, and hides no other" do
    odd = &facts(%{links: [link(%{peers: :none, counters: %{peers_refused: &1}})], audit: "full"})

    assert [%{name: :audit_failing}, %{name: :rule_failed, evidence: [evidence]}] =
             conditions(odd.(0), odd.(3))

    assert evidence =~ "Traffic"
  end

  test "conditions are bounded, the serious ones first, and each has a name with a meaning" do
    vehicles = for n <- 1..300, do: vehicle(%{id: "V#{n}", system_id: n, mavlink_version: 1})
    found = conditions(facts(%{vehicles: vehicles, audit: "full"}))
    assert length(found) == 200
    assert hd(found).severity == :error
    known = Keyword.keys(Diagnosis.names())
    assert known == Enum.uniq(known)
    for %{name: name} <- found, do: assert(name in known)
    for {_name, meaning} <- Diagnosis.names(), do: assert(meaning =~ ~r/\A[^.]+\z/)
  end
end
