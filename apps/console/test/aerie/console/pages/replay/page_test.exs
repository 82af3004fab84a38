defmodule Aerie.Console.Pages.Replay.PageTest do
  @moduledoc "The page Replay: what it gives to the browser, what the browser makes of it, and who sees what."
  use Aerie.ConsoleCase, async: true

  alias Aerie.Console.Pages.Replay.{Marks, TimeLine}
  alias Aerie.Control.Policy.Audit
  alias Aerie.Fleet.Tracks
  alias Aerie.HTTPClient
  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.Events.Journal

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    test = self()
    [console: console] = start_console(incident: &pack(test, &1, &2, &3, &4))
    start_supervised!({Audit, gateway: console.gateway, dir: Path.join(dir, "audit"), max_bytes: 8_000_000})
    {:ok, console: console, now: System.os_time(:second)}
  end

  # In place of the gateway's own: the kite's archive is there at once, the eagle's is refused when the test says so.
  defp pack(test, "eagle", _span, _folder, note) do
    send(test, {:packing, self()})
    receive do: (:goes_on -> :ok)
    note.("reading eagle.tlog")
    receive do: (:goes_on -> {:error, "nothing is known of eagle"})
  end

  defp pack(_test, vehicle, {from, to}, folder, _note) do
    path = Path.join(folder, "incident-#{vehicle}.tar.gz")
    File.write!(path, String.duplicate("x", 2_000_000 + rem(to - from, 1_000_000)))
    {:ok, path, []}
  end

  # Ten minutes: the eagle flies with a gap of a minute in the middle, the kite stands, and is lost at the end.
  defp flown(%{gateway: gateway}, dir, now, more \\ 0) do
    {:ok, files, 0} =
      Tracks.Files.open(gateway, Path.join(dir, "tracks"), max_bytes: 100_000_000, keep_ms: 86_400_000)

    Tracks.Metrics.status(gateway, %{dir: dir, bytes: 0, problem: nil})

    for ago <- 600..1//-1, ago not in 240..300, reduce: {files, Tracks.Core.new()} do
      {files, core} ->
        at = (now - ago) * 1000

        eagle = %Tracks.Sample{
          lat: 473_977_000 - ago * 900,
          lon: 85_456_000,
          height: 200,
          heading: 0,
          speed: 100,
          flags: 3
        }

        kite = %Tracks.Sample{
          lat: 473_970_000,
          lon: 85_450_000,
          height: 0,
          flags: if(ago < 60, do: 8, else: 0)
        }

        others = for n <- 1..more//1, do: {"other-#{n}", %{eagle | lon: 85_456_000 + n * 1_000}}

        samples = [
          {"eagle", %{eagle | mode: "AUTO", age: 0}},
          {"kite", %{kite | mode: "STABILIZE"}} | others
        ]

        {core, [{:write, ^at, begins?, block, _n}]} = Tracks.Core.handle(core, {:tick, at, samples})
        {:ok, files, 0} = Tracks.Files.write(files, at, begins?, block)
        {files, core}
    end

    event =
      Event.new("eagle", "failsafe", 1, (now - 400) * 1_000_000, nil, %{
        "reason" => "battery",
        "action" => "rtl"
      })

    landed = Event.new("eagle", "landed", 2, (now - 30) * 1_000_000, nil, %{})
    Journal.commit(gateway, "eagle", %{seq: 2}, [event, landed])

    deny = %{
      "type" => "decision",
      "decision" => "deny",
      "command" => "goto",
      "vehicle" => "eagle",
      "source" => "ann"
    }

    {:ok, _n} =
      Audit.append(gateway, Map.merge(deny, %{"rule" => "geofence", "reason" => "outside the fence"}))

    done = %{"command" => "rtl", "vehicle" => "eagle", "source" => "ann", "id" => "c1"}
    {:ok, _n} = Audit.append(gateway, Map.merge(done, %{"type" => "decision", "decision" => "allow"}))
    {:ok, _n} = Audit.append(gateway, Map.merge(done, %{"type" => "result", "result" => "completed"}))
    :ok
  end

  defp overview(console, role, query \\ "") do
    {:ok, view, _html} = live(conn(console, role), "/replay" <> query)
    assert_push_event(view, "replay:overview", overview)
    {view, overview}
  end

  test "a row for each vehicle, marks, and chunks of the map", %{console: console, tmp_dir: dir, now: now} do
    flown(console, dir, now)
    {view, overview} = overview(console, :operator)
    assert %{rows: [%{id: "eagle", spans: eagle}, %{id: "kite", spans: kite}], marks: marks} = overview
    assert overview.to - overview.from == 86_400
    assert [[_, _, 2] | _] = eagle
    assert for([_from, _to, state] <- kite, do: state) |> Enum.uniq() == [1, 3]

    assert [
             %{kind: "critical", vehicle: "eagle"},
             %{kind: "landed"},
             %{kind: "refused", rule: "geofence", who: "ann", record: _},
             %{kind: "done", took_ms: took}
           ] = marks

    assert took >= 0
    from = div(now - 400, 120) * 120
    render_hook(view, "chunk", %{"from" => from})
    assert_push_event(view, "replay:chunk", %{from: ^from, vehicles: %{"eagle" => rows, "kite" => _}})
    assert length(rows) in 100..120
    assert [_at, lat, 8.5456, 20.0, 0, 10.0, nil, "AUTO", :armed, true] = hd(rows)
    assert_in_delta lat, 47.36, 0.01
    # Nothing else is asked for.
    for wrong <- [%{"from" => 7}, %{"from" => "x"}, %{}, %{"from" => -120}],
        do: render_hook(view, "chunk", wrong)
  end

  test "a viewer sees the flights and events, and no commands", %{console: console, tmp_dir: dir, now: now} do
    flown(console, dir, now)
    {view, overview} = overview(console, :viewer)
    assert for(%{kind: kind} <- overview.marks, do: kind) == ["critical", "landed"]
    assert render(view) =~ "Commands are shown to operators"
    refute render(view) =~ "hold-button"
  end

  test "the strip below the fleet's map is read when it is opened, for viewers without commands", %{
    console: console,
    tmp_dir: dir,
    now: now
  } do
    {:ok, view, _html} = live(conn(console, :viewer), "/")
    render_hook(view, "strip", %{})

    assert_push_event(
      view,
      "strip:overview",
      %{problem: "this gateway keeps no tracks" <> _},
      Aerie.Patience.ms()
    )

    flown(console, dir, now)

    for {role, kinds} <- [viewer: ~w(critical landed), operator: ~w(critical landed refused done)] do
      {:ok, view, _html} = live(conn(console, role), "/")
      for _twice <- 1..2, do: render_hook(view, "strip", %{})
      assert_push_event(view, "strip:overview", %{rows: [_eagle, _kite], marks: marks}, Aerie.Patience.ms())
      assert for(%{kind: kind} <- marks, do: kind) == kinds
    end
  end

  test "some vehicles, and a time", %{console: console, tmp_dir: dir, now: now} do
    flown(console, dir, now)
    {view, overview} = overview(console, :operator, "?vehicles=kite&at=2026-11-30T09:58:12Z")
    assert [%{id: "kite"}] = overview.rows
    assert overview.marks == []
    assert has_element?(view, "#replay[data-at='1796032692'][data-vehicles=kite]")
    assert has_element?(view, "#replay-live[href='/vehicles/kite']")
    # The page ignores nonsense in the address.
    {_view, %{rows: []}} = overview(console, :operator, "?vehicles=../x,%00&at=never")
  end

  test "a gateway that keeps no tracks says so", %{console: console} do
    {:ok, view, _html} = live(conn(console, :viewer), "/replay")
    eventually(fn -> render(view) =~ "this gateway keeps no tracks" end)
  end

  test "spans end at gaps" do
    at = fn minutes, more -> Map.merge(%{at: minutes * 60_000_000, status: :online, in_air: false}, more) end
    assert TimeLine.spans([]) == []
    assert TimeLine.spans([at.(1, %{}), at.(2, %{}), at.(5, %{})]) == [[60, 120, 1], [300, 300, 1]]

    assert TimeLine.spans([at.(1, %{}), at.(2, %{in_air: true}), at.(3, %{status: :lost})]) == [
             [60, 120, 1],
             [120, 180, 2],
             [180, 180, 3]
           ]

    assert TimeLine.rows([%{lat: nil, lon: 1.0}]) == []
  end

  test "records of the audit log have marks only where they are about a command" do
    at = "2026-11-30T09:58:12.000000Z"

    records = [
      %{"type" => "opened", "at" => at},
      %{"type" => "result", "at" => "never"},
      %{"decision" => "deny", "at" => at, "command" => nil}
    ]

    assert Marks.marks(records, 2_000_000_000_000_000) == []
  end

  @tag :chromium
  test "by mouse and keyboard, narrow and wide, dark and light", %{console: console, tmp_dir: dir, now: now} do
    flown(console, dir, now)
    put_vehicle(console, "eagle")
    browse(console, "replay.mjs", ["#{now}"])
  end

  @tag :chromium
  test "sixty vehicles; a page that is killed comes back at the same second", %{
    console: console,
    tmp_dir: dir,
    now: now
  } do
    flown(console, dir, now, 60)
    script = browser(console, "replay_many.mjs", ["#{now}"])
    await_line(script, "there")
    pages = Aerie.Console.Supervisor.pages(console.gateway)
    [{_id, pid, _type, _modules}] = DynamicSupervisor.which_children(pages)
    ref = Process.monitor(pid)
    Process.exit(pid, :kill)
    assert_receive {:DOWN, ^ref, :process, _pid, :killed}
    Port.command(script, "killed\n")
    await_line(script, "ok")
  end

  @tag :chromium
  test "an incident is packed from the time in view", %{console: console, tmp_dir: dir, now: now} do
    flown(console, dir, now)
    script = browser(console, "incident.mjs", ["#{now}"])
    await_line(script, "asks")
    assert_receive {:packing, packer}, Aerie.Patience.ms()
    send(packer, :goes_on)
    await_line(script, "packing")
    send(packer, :goes_on)
    await_line(script, "ok")
  end

  test "incidents: for admins, one at a time, at most two hours, of a vehicle's name", %{
    console: console,
    now: now
  } do
    jar = HTTPClient.sign_in(console, "admin", password(:admin)).jar
    get = fn jar, query -> HTTPClient.get(console, "/download/incident?" <> query, jar) end
    span = "from=#{now - 60}&to=#{now}"

    for query <- [
          "",
          span,
          "vehicle=../kite&" <> span,
          "vehicle=kite&from=x&to=7",
          "vehicle=kite&from=7&to=7",
          "vehicle=kite&from=-1&to=7"
        ],
        do: assert(%{status: 400} = get.(jar, query))

    assert %{status: 413, body: "The time in view is longer than 2 hours" <> _} =
             get.(jar, "vehicle=kite&from=0&to=7201")

    for role <- [:viewer, :operator],
        do:
          assert(
            %{status: 403} =
              get.(HTTPClient.sign_in(console, "#{role}", password(role)).jar, "vehicle=kite&" <> span)
          )

    first = Task.async(fn -> get.(jar, "vehicle=eagle&" <> span) end)
    assert_receive {:packing, packer}, Aerie.Patience.ms()
    assert %{status: 429, body: "Another archive" <> _} = get.(jar, "vehicle=kite&" <> span)
    for _twice <- 1..2, do: send(packer, :goes_on)
    assert %{status: 422, body: "nothing is known of eagle" <> _} = Task.await(first, :infinity)

    assert %{status: 200, body: archive} = get.(jar, "vehicle=kite&" <> span)
    assert byte_size(archive) == 2_000_000
    # It stays until the next one, and is nobody else's.
    folder = Path.join(console.dir, "incident")
    assert ["incident-kite.tar.gz"] = File.ls!(folder)
    assert Bitwise.band(File.stat!(folder).mode, 0o777) == 0o700
  end
end
