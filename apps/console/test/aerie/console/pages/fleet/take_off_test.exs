defmodule Aerie.Console.Pages.Fleet.TakeOffTest do
  @moduledoc "The sheet for a take-off of several vehicles: nothing is sent before the held press for what was shown."
  use Aerie.ConsoleCase, async: true

  import Aerie.ActCase

  alias Aerie.Fleet

  @moduletag :tmp_dir
  @moduletag :capture_log

  setup %{tmp_dir: dir} do
    console = Aerie.ActCase.start(dir)
    for n <- 1..3, do: ground(console, n)
    {:ok, console: console}
  end

  # On the ground and ready, eleven metres from the next one.
  defp ground(console, n, groups \\ []) do
    groups =
      Keyword.merge(
        [
          mode: %{armed: false, in_air: false, landed_state: "ON_GROUND"},
          position: %{lat: 47.0 + n / 10_000, lon: 8.0, alt_rel: 0.0},
          home: %{lat: 47.0 + n / 10_000, lon: 8.0, alt_msl: 450.0},
          health: %{ready_to_arm: true, unhealthy: []}
        ],
        groups,
        fn _group, data, changes -> Map.merge(data, changes) end
      )

    put(console, n, groups)
  end

  defp open(console, role \\ :operator) do
    {:ok, view, _html} = live(conn(console, role), "/")
    view
  end

  defp sheet(view) do
    render_click(view, "all")
    view |> element("#fleet-actions button", "Take off") |> render_click()
    view
  end

  defp line(view, id), do: view |> element("#take-off-#{id}") |> render() |> String.replace(~r/\s+/, " ")

  defp value(view), do: value(view, "#take-off-go")

  test "shows who goes when and how high, and sends nothing before it is held", %{console: console} do
    ground(console, 3, position: %{lat: 46.9})
    view = console |> open() |> sheet()
    assert has_element?(view, "#take-off h2", "Take off 3 vehicles")
    assert line(view, "V3") =~ ~r/>1<.*V3.*Ready.*20 m.*\+0 s/
    assert line(view, "V2") =~ ~r/>3<.*V2.*Ready.*26 m.*\+12 s/

    assert has_element?(
             view,
             ".sheet-summary",
             "3 ready. Policy and firmware: allowed for all that take off."
           )

    assert has_element?(
             view,
             ".sheet-summary",
             "Nearest on the ground: V1 and V2, 11.1 m. In the stack 3 m apart in height."
           )

    view |> form("#take-off-form", %{height: "30", stacked: "false"}) |> render_change()
    view |> element("#take-off-V3 button[aria-label='V3 later']") |> render_click()
    assert line(view, "V1") =~ ~r/>1<.*30 m/
    render_hook(view, "sheet_move", %{"id" => "V2", "to" => "V1"})
    assert line(view, "V2") =~ ~r/>1</
    for odd <- [%{"id" => 7, "to" => []}, %{}], do: render_hook(view, "sheet_move", odd)
    view |> form("#take-off-form", %{height: "0"}) |> render_change()
    assert view |> element("#take-off-go") |> render() =~ "height: expected a number from 1 to 1000"
    view |> form("#take-off-form", %{height: "10", above: "20"}) |> render_change()

    assert view |> element("#take-off-above-errors") |> render() =~
             "not surely above 20 m: give at most 9.0 m."

    assert view |> element("#take-off-go") |> render() =~ "not surely above 20 m"
    view |> element("#take-off footer button", "Cancel") |> render_click()
    refute has_element?(view, "#take-off")
    assert operations(console) == []
  end

  test "a held press is one sequence of the gateway, and the page shows what becomes of it", %{
    console: console
  } do
    executor(console, 1)
    view = open(console)
    render_hook(view, "select", %{"id" => "V1", "how" => "only"})
    view |> element("#fleet-actions button", "Take off") |> render_click()
    value = value(view)
    hold(view, value)
    refute has_element?(view, "#take-off")
    assert has_element?(view, "#operation-web-1", "V1")
    for type <- ~w(arm takeoff), do: assert_receive({:commanded, "V1", ^type, _params}, Aerie.Patience.ms())
    # The same press again, late.
    hold(view, value)
    assert [%{"id" => "web-1", "name" => "Take off"}] = operations(console)

    # The operation goes on without its page, and a new page finds it.
    ref = Process.monitor(view.pid)
    Process.exit(view.pid, :kill)
    assert_receive {:DOWN, ^ref, :process, _pid, _killed}
    ground(console, 1, mode: %{armed: true, in_air: true}, position: %{alt_rel: 12.0})
    eventually(fn -> match?({:ok, %{"state" => "done"}}, Fleet.operation(console.gateway, "web-1")) end)
    assert has_element?(open(console), "#operation-web-1", "Take off: V1 up")
  end

  test "one that is not ready has to be left out", %{console: console} do
    ground(console, 2, battery: %{remaining: 0.1})
    view = console |> open() |> sheet()
    assert line(view, "V2") =~ ~r/Not ready.*Battery: 10 % left; 40 % are wanted\./
    assert view |> element("#take-off-go") |> render() =~ "V2 is not ready: leave it out."
    # Whatever a browser sends.
    assert hold(view, value(view)) =~ "Nothing was sent: V2 is not ready: leave it out."
    view |> element("#take-off-V2 button", "Leave out") |> render_click()
    assert line(view, "V2") =~ "left out"
    assert view |> element("#take-off-go") |> render() =~ "Take off 2, one after the other"
    assert value(view)["vehicles"] == [["V1", 20, "ready", false], ["V3", 23, "ready", false]]
  end

  test "one of which not all is known is taken along only if somebody says so", %{console: console} do
    ground(console, 2, battery: %{remaining: nil})
    view = console |> open() |> sheet()
    assert view |> element("#take-off-go") |> render() =~ "not known whether V2 is ready"
    view |> element("#take-off-V2 button", "Take along anyway") |> render_click()
    refute view |> element("#take-off-go") |> render() =~ "data-refusal"
    assert ["V2", 23, "unknown", true] in value(view)["vehicles"]
  end

  test "a press for what has changed since sends nothing", %{console: console} do
    view = console |> open() |> sheet()
    shown = value(view)
    ground(console, 2, gps: %{fix: 1})
    assert hold(view, shown) =~ "What was shown has changed; nothing was sent."
    assert view |> element("#take-off-go") |> render() =~ "V2 is not ready"
    ground(console, 2)
    refresh_fleet(view)
    refute render(view) =~ "V2 is not ready"
    view |> form("#take-off-form", %{height: "25"}) |> render_change()
    assert hold(view, shown) =~ "What was shown has changed"

    for odd <- [%{}, %{"id" => 7, "vehicles" => "all"}],
        do: assert(render_hook(view, "sheet_go", odd) =~ "has changed")

    assert operations(console) == []
  end

  test "the sheet is for the vehicles that the button named, and only those on the ground", %{
    console: console
  } do
    view = open(console)
    render_hook(view, "select", %{"id" => "V1", "how" => "only"})
    press = %{"ids" => ["V2"], "of" => ["V2"]}
    assert render_click(view, "sheet_take_off", press) =~ "The selection changed; nothing was sent."
    refute has_element?(view, "#take-off")

    ground(console, 3, mode: %{armed: true, in_air: true}, position: %{alt_rel: 20.0})
    refresh_fleet(view)
    render_click(view, "all")

    assert view |> element("#fleet-actions button", "Take off 2") |> render() =~
             ~s(&quot;of&quot;:[&quot;V1&quot;,&quot;V2&quot;])

    view |> element("#fleet-actions button", "Take off 2") |> render_click()
    assert has_element?(view, "#take-off h2", "Take off 2 vehicles")
    # Hidden vehicles are nobody's to act on.
    render_hook(view, "sheet_close", %{})
    view |> form("#fleet-filter", %{q: "V1"}) |> render_change()
    all = %{"ids" => ~w(V1 V2 V3), "of" => ~w(V1 V2)}
    assert render_click(view, "sheet_take_off", all) =~ "Hidden vehicles are selected."
    refute has_element?(view, "#take-off")
  end

  test "somebody else in charge, a limit of the policy, and a firmware without it keep one on the ground", %{
    console: console
  } do
    take_charge(console, 2, "olga")

    view = console |> open() |> sheet()
    assert line(view, "V2") =~ ~r/Not ready.*olga is in charge of it\./

    :ok = Aerie.Control.Policy.Store.put(console.gateway, %{max_altitude: 22.0})
    view |> element("#take-off-V2 button", "Leave out") |> render_click()
    assert line(view, "V3") =~ ~r/23 m above home/
    assert view |> element("#take-off-go") |> render() =~ "V3: "
  end

  test "those in the air fly higher together, those on the ground do not", %{console: console} do
    for n <- 2..3, do: ground(console, n, mode: %{armed: true, in_air: true}, position: %{alt_rel: 20.0 + n})
    for n <- 2..3, do: executor(console, n)
    view = open(console)
    render_click(view, "all")
    assert view |> element("#fleet-height-go") |> render() =~ "Change 2 by this"
    event = %{"ids" => ~w(V1 V2 V3), "air" => ~w(V2 V3), "id" => "web-2", "fields" => %{"metres" => "5"}}

    assert render_hook(view, "height", %{event | "ids" => ["V2"]}) =~
             "The selection changed; nothing was sent."

    assert render_hook(view, "height", %{event | "air" => ["V1"]}) =~
             "not all of them are in the air any more"

    assert operations(console) == []
    render_hook(view, "height", event)
    for id <- ~w(V2 V3), do: assert_receive({:commanded, ^id, "set_altitude", _params}, Aerie.Patience.ms())
    eventually(fn -> match?({:ok, %{"state" => "done"}}, Fleet.operation(console.gateway, "web-2")) end)
    assert has_element?(open(console), "#operation-web-2", "Height +5 m 2: all height set")
    viewer = open(console, :viewer)
    render_click(viewer, "all")
    refute has_element?(viewer, "#fleet-height")
  end

  test "a viewer has neither the button nor the events", %{console: console} do
    view = open(console, :viewer)
    render_click(view, "all")
    refute has_element?(view, "#fleet-actions button", "Take off")

    for event <- ~w(sheet_take_off sheet_leave sheet_go),
        do: render_hook(view, event, %{"ids" => [], "of" => []})

    refute has_element?(view, "#take-off")
    assert operations(console) == []
  end

  test "sixty vehicles are one sheet and one operation", %{console: console} do
    for n <- 1..60, do: ground(console, n)
    view = console |> open() |> sheet()
    assert has_element?(view, "#take-off h2", "Take off 60 vehicles")
    assert line(view, "V60") =~ ~r/>60<.*197 m/
    hold(view, value(view))
    assert [%{"id" => "web-1", "counts" => counts}] = operations(console)
    assert counts |> Map.values() |> Enum.sum() == 60
  end

  @tag :chromium
  test "by mouse and keyboard: order, what is left out, one that stops being ready under the hand, a killed page",
       %{
         console: console,
         tmp_dir: dir
       } do
    Aerie.ShadowCase.start_shadow(console.gateway, dir)
    for n <- [2, 3], do: :ok = Fleet.Shadow.tag(console.gateway, "V#{n}", ["north"])
    for n <- 1..4, do: ground(console, n)
    for n <- 1..4, do: executor(console, n)
    ground(console, 5, battery: %{remaining: 0.1})

    script = browser(console, "take_off.mjs")
    await_line(script, "holding")
    ground(console, 2, gps: %{fix: 1})
    Port.command(script, "unready\n")
    await_line(script, "ended")
    assert operations(console) == []
    ground(console, 2)
    Port.command(script, "ready\n")
    await_line(script, "begun")
    assert [%{"id" => id, "state" => "running"}] = operations(console)

    kill_pages(console)
    Port.command(script, "killed\n")
    await_line(script, "back")
    # Each is up when its turn comes.
    for n <- [1, 4, 2, 3] do
      assert_receive {:commanded, vehicle, "takeoff", _params}, Aerie.Patience.ms()
      assert vehicle == "V#{n}"
      ground(console, n, mode: %{armed: true, in_air: true}, position: %{alt_rel: 30.0})
    end

    eventually(fn -> match?({:ok, %{"state" => "done"}}, Fleet.operation(console.gateway, id)) end)
    Port.command(script, "done\n")
    await_line(script, "ok")
  end
end
