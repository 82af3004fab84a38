defmodule Aerie.Console.Pages.Recordings.PageTest do
  use Aerie.ConsoleCase, async: true

  alias MavRouter.{Link, Recorder}
  alias Aerie.Console.Pages.Recordings.{TimeLine, TlogFile}
  alias Aerie.HTTPClient
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser

  @moduletag :tmp_dir
  @moduletag :capture_log
  @start 1_795_000_000_000_000

  setup %{tmp_dir: dir} do
    config = %{recorder: %{dir: Path.join(dir, "recordings"), min_free_mb: 0, flush_ms: 5}}
    gateway = Aerie.GatewayCase.start_gateway(config, with: [:router, :links])
    [console: console] = start_console(gateway: gateway)
    {:ok, console: console, gateway: gateway}
  end

  # A vehicle that is armed after ten seconds of its recording.
  defp record(gateway, id \\ "VID-007") do
    put_vehicle(%Aerie.ConsoleCase{gateway: gateway, port: 0, dir: "", server: nil, url: ""}, id, [], %{
      key: {"main", 7},
      system_id: 7
    })

    :ok = Recorder.start(gateway, {:vehicle, {"main", 7}}, :always)
    for second <- 0..20, do: :ok = Recorder.vehicle_frames(gateway, {"main", 7}, [beat(second, second >= 10)])
    eventually(fn -> match?([%{bytes: bytes}] when bytes > 400, Recorder.list(gateway)) end)
    :ok = Recorder.stop(gateway, {:vehicle, {"main", 7}})
    [%{file: file}] = Recorder.list(gateway)
    file
  end

  defp beat(second, armed?) do
    message = %M.Heartbeat{
      type: 2,
      autopilot: 3,
      base_mode: if(armed?, do: 0x81, else: 1),
      mavlink_version: 3,
      system_status: 3
    }

    bytes = MavCodec.encode(message, system: 7, component: 1, seq: second)
    {[frame], _parser} = Parser.push_datagram(Parser.new(), bytes, @start + second * 1_000_000)
    frame
  end

  defp open(console, role \\ :viewer) do
    {:ok, view, _html} = live(conn(console, role), "/recordings")
    view
  end

  test "what a name and the first bytes say", %{tmp_dir: dir} do
    assert TlogFile.label("main-radio-20261121T013005Z-2.tlog") == "main-radio"
    assert TlogFile.label("flight.tlog") == "flight.tlog"
    path = Path.join(dir, "a.tlog")

    for {bytes, start} <- [
          {<<@start::64, 1, 2>>, @start},
          {<<@start * 1000::64>>, nil},
          {<<0::64>>, nil},
          {"abc", nil},
          {"", nil}
        ] do
      File.write!(path, bytes)
      assert TlogFile.start(path) == start
    end

    assert TlogFile.start(dir) == nil
    assert TlogFile.start(path <> "x") == nil

    for {bytes, words} <- [{412, "412 B"}, {1_048_576, "1048 kB"}, {72_208_089_088, "72 GB"}],
        do: assert(TlogFile.size(bytes) == words)
  end

  test "no recordings yet", %{console: console} do
    assert console |> open() |> render() =~ "No recordings yet"
  end

  test "files with size and age, their events on a time line", c do
    name = c.gateway |> record() |> Path.basename()
    view = open(c.console)
    assert has_element?(view, "#files td", name)
    assert has_element?(view, "#recordings td", "VID-007")
    assert has_element?(view, "#files strong", "VID-007")
    # Since its first frame, not since its file was made.
    assert has_element?(view, "#files td", Aerie.Console.Clock.stamp(@start))
    view |> element("#files button", "Events") |> render_click()
    eventually(fn -> has_element?(view, "#time-line li", "armed") end)
    assert has_element?(view, "#time-line .track line")
    assert has_element?(view, "#time-line li", "10.0 s")
    view |> element("#time-line button", "") |> render_click()
    refute has_element?(view, "#time-line")
    render_click(view, "events", %{"name" => "../../etc/passwd"})
    refute has_element?(view, "#time-line")
  end

  test "download by users who are signed in; only recordings", c do
    file = record(c.gateway)
    name = Path.basename(file)
    jar = HTTPClient.sign_in(c.console, "viewer", password(:viewer)).jar
    assert %{status: 200, body: body} = HTTPClient.get(c.console, "/download/recordings/" <> name, jar)
    assert body == File.read!(file)
    assert %{status: 303} = HTTPClient.get(c.console, "/download/recordings/" <> name)
    assert %{status: 404} = HTTPClient.get(c.console, "/download/recordings/recordings.index", jar)

    assert %{status: 403} =
             HTTPClient.get(c.console, "/download/recordings/" <> name, jar, [
               {"origin", "https://evil.example"}
             ])
  end

  test "an admin deletes a file after a question; others cannot", c do
    file = record(c.gateway)
    name = Path.basename(file)

    for role <- [:viewer, :operator] do
      view = open(c.console, role)
      refute has_element?(view, "button[aria-label='Delete #{name}']")
      assert render_click(view, "ask", %{"name" => name}) =~ "Ask an admin."
      assert render_click(view, "delete", %{}) =~ "Ask an admin."
      assert render_click(view, "play", %{"name" => name, "speed" => "1"}) =~ "Ask an admin."
    end

    view = open(c.console, :admin)
    view |> element("button[aria-label='Delete #{name}']") |> render_click()
    assert File.exists?(file)
    assert view |> element("dialog button", "Delete") |> render_click() =~ "deleted"
    refute File.exists?(file)
    assert render(view) =~ "No recordings yet"
  end

  test "an admin plays a file on a network of its own, and stops it", c do
    name = c.gateway |> record() |> Path.basename()
    view = open(c.console, :admin)
    render_click(view, "play", %{"name" => name, "speed" => "max"})
    assert %{network: "replay", kind: :replay} = Link.get(c.gateway, "replay-" <> name)
    assert has_element?(view, "section li", "replay-" <> name)
    view |> element("section li button", "Stop") |> render_click()
    assert Link.get(c.gateway, "replay-" <> name) == nil
    render_click(view, "play", %{"name" => "/etc/passwd", "speed" => "1"})
    assert Link.list(c.gateway) == []
  end

  test "an operator saves the last minutes of a vehicle", c do
    record(c.gateway)
    view = open(c.console, :operator)

    assert view |> element("button[phx-click=save]", "VID-007") |> render_click() =~
             "Saved as main-VID-007-console"

    assert open(c.console) |> render() =~ "console"
  end

  test "names a file that is too large or missing" do
    assert {:error, "it is too large" <> _} = TimeLine.read("x", 1_000_000_000)
    assert {:error, text} = TimeLine.read("no-such-file.tlog", 10)
    assert is_binary(text)
  end
end
