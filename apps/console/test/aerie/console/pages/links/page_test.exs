defmodule Aerie.Console.Pages.Links.PageTest do
  use Aerie.ConsoleCase, async: true

  alias MavRouter.{Link, Router}
  alias Aerie.Console.Pages.Links.View

  @moduletag :capture_log

  # With links that are real.
  setup do
    gateway = Aerie.GatewayCase.start_gateway(%{}, with: [:router, :links])
    [console: console] = start_console(gateway: gateway)
    {:ok, console: console, gateway: gateway}
  end

  defp udp(gateway, id \\ "radio") do
    {:ok, ^id} = Link.start(gateway, "udpin:127.0.0.1:0", id: id)
    port = eventually(fn -> Link.get(gateway, id) && Link.get(gateway, id).port end)
    {:ok, socket} = :gen_udp.open(0, [:binary])
    beat = %MavCodec.Messages.Heartbeat{type: 2, autopilot: 3, mavlink_version: 3}
    :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, MavCodec.encode(beat, system: 7, component: 1))
    eventually(fn -> Router.route(gateway, {"main", 7}) end)
    socket
  end

  defp open(console, path \\ "/links", role \\ :viewer) do
    {:ok, view, _html} = live(conn(console, role), path)
    view
  end

  test "no links, and what would bring some", %{console: console} do
    assert console |> open() |> render() =~ "No links"
  end

  test "links with their state and rates, networks, and one link with peers, components and counters", c do
    udp(c.gateway)
    view = open(c.console)
    eventually(fn -> has_element?(view, "#links .badge.ok", "up") end)
    assert has_element?(view, "#networks td", "main")
    view |> element("#links a", "radio") |> render_click()
    assert has_element?(view, "#link dd", "udpin:127.0.0.1:0")
    eventually(fn -> has_element?(view, "#sources td", "7/1") end)
    assert has_element?(view, "#peers td", "127.0.0.1:")
    assert has_element?(view, "#link dt", "frames_in")
    refute has_element?(view, "#link button", "Remove")
    # A line needs a sample, and gets one a second.
    eventually(fn -> has_element?(view, ".spark polyline[points]") end)
  end

  test "routes and clients", c do
    udp(c.gateway)
    assert has_element?(open(c.console, "/links?part=routes"), "#routes td", "7/1")
    assert c.console |> open("/links?part=clients") |> render() =~ "No clients"
    assert c.console |> open("/links?part=rules") |> render() =~ "No changed rules"
    assert c.console |> open("/links?part=nonsense&link%5B%5D=x") |> render() =~ "Networks"
    assert c.console |> open("/links?link=gone") |> render() =~ "No link gone"
  end

  test "viewers and operators can change nothing, whatever the browser says", c do
    udp(c.gateway)

    for role <- [:viewer, :operator] do
      view = open(c.console, "/links?link=radio", role)
      assert render_click(view, "ask", %{"what" => "remove", "id" => "radio"}) =~ "Ask an admin."
      assert render_click(view, "add", %{"url" => "udpin:127.0.0.1:0"}) =~ "Ask an admin."
      assert render_click(view, "remove", %{}) =~ "Ask an admin."
    end

    assert [%{id: "radio"}] = Link.list(c.gateway)
  end

  test "an admin adds a link; what is wrong about its address is said", c do
    view = open(c.console, "/links", :admin)
    view |> element("button", "Add a link") |> render_click()
    form = fn params -> view |> element("#add-link-form") |> render_submit(params) end
    assert form.(%{"url" => "nonsense:1", "id" => "", "network" => ""}) =~ "field-error"
    assert form.(%{"url" => "replay:/etc/passwd"}) =~ "play recordings from"

    assert form.(%{"url" => "udpin:127.0.0.1:0", "id" => "second", "network" => "field"}) =~
             "Link second added"

    assert %{network: "field"} = Link.get(c.gateway, "second")
    eventually(fn -> has_element?(view, "#links a", "second") end)
  end

  test "an admin restarts and removes a link, after a question", c do
    udp(c.gateway)
    view = open(c.console, "/links?link=radio", :admin)
    before = Aerie.Base.Names.whereis(c.gateway, :link, "radio")
    view |> element("#link button", "Restart") |> render_click()
    assert has_element?(view, "dialog", "counters and routes stay")
    render_click(view, "cancel", %{})
    assert Aerie.Base.Names.whereis(c.gateway, :link, "radio") == before
    view |> element("#link button", "Restart") |> render_click()
    # The answer to an earlier question, about another link.
    render_click(view, "restart", %{"id" => "other"})
    assert Aerie.Base.Names.whereis(c.gateway, :link, "radio") == before
    assert view |> element("dialog button", "Restart link radio") |> render_click() =~ "restarted"
    refute Aerie.Base.Names.whereis(c.gateway, :link, "radio") == before
    view |> element("#link button", "Remove") |> render_click()
    view |> element("dialog button", "Remove link radio") |> render_click()
    assert Link.list(c.gateway) == []
    assert render_click(view, "restart", %{"id" => "none"}) =~ "Links"
    assert render_click(view, "ask", %{"what" => "remove-client", "id" => "none"}) =~ "Remove client none"

    assert view |> element("dialog button", "Remove client none") |> render_click() =~
             "there is no client none"
  end

  test "rules that were changed are shown beside the configured ones, and undone", c do
    udp(c.gateway)
    :ok = Router.configure(c.gateway, "radio", bytes_per_s: 1_000)
    view = open(c.console, "/links?part=rules", :admin)
    assert has_element?(view, "#rules td", "1000")
    assert view |> element("#rules button", "Reset") |> render_click() =~ "are as configured again"
    assert Router.changes(c.gateway) == %{}
  end

  test "a link that was heard long ago says so; what serial ports found out is shown", c do
    finding = MavRouter.Link.Serial.Finding.silent("/dev/ttyUSB0", 5)

    put_link(c.console, "old", %{
      last_heard: System.os_time(:microsecond) - 60_000_000,
      diagnosis: [finding],
      status: :idle
    })

    html = c.console |> open("/links?link=old") |> render()
    assert html =~ ~r/Not heard for \d+ s/
    assert html =~ "/dev/ttyUSB0: nothing in 5 s"
  end

  test "lines: newest at the right, nothing where nothing is known, bounded" do
    link = %{
      id: "a",
      network: "main",
      url: "",
      status: :up,
      text: "",
      rates: %{frames_in: 10},
      quality: %{loss: nil, rtt_ms: 20}
    }

    samples = Enum.reduce(1..130, [], fn _n, samples -> View.sampled(samples, link) end)
    assert length(samples) == 120
    assert %{top: 10, points: points} = View.line(samples, :frames, 1)
    assert String.ends_with?(points, "120,1.0")
    assert View.line(samples, :loss, 0.01) == nil
    assert View.line([], :frames, 1) == nil
  end
end
