defmodule Aerie.Console.Pages.Fleet.ReturnTest do
  @moduledoc "The sheet for a return of several vehicles: heights apart, and a queue where they land at one place."
  use Aerie.ConsoleCase, async: true

  import Aerie.ActCase

  alias Aerie.Fleet
  alias Aerie.Vehicle.Events.Journal

  @moduletag :tmp_dir
  @moduletag :capture_log

  setup %{tmp_dir: dir} do
    console = Aerie.ActCase.start(dir)
    # V1 and V2 land a metre apart, V3 far from them.
    for {n, home_m} <- [{1, 0}, {2, 1}, {3, 200}], do: fly(console, n, home_m)
    {:ok, console: console}
  end

  defp fly(console, n, home_m, groups \\ []) do
    lat = 47.0 + home_m / 111_195

    groups =
      Keyword.merge(
        [home: %{lat: lat, lon: 8.0}, position: %{lat: lat + n / 1_000, lon: 8.0, alt_rel: 20.0}],
        groups
      )

    put(console, n, groups)
  end

  defp open(console, role \\ :operator), do: console |> conn(role) |> live("/") |> elem(1)

  defp sheet(view) do
    render_click(view, "all")
    view |> element("#fleet-actions button", ~r/Return \d/) |> render_click()
    view
  end

  defp value(view), do: value(view, "#return-go")

  test "shows heights by distance, who waits for whom, and whose firmware undoes it; the plain Return stays",
       %{
         console: console
       } do
    :ok = Journal.commit(console.gateway, "V3", %{}, [], %{"RTL_ALT" => 6_000})
    view = console |> open() |> sheet()
    assert has_element?(view, "#fleet-rtl")
    assert has_element?(view, "#return h2", "Return 3 vehicles")
    assert has_element?(view, "#return-V1", "30 m")
    assert has_element?(view, "#return-V2 .badge.bad", "One place with V1: waits until that has landed")
    assert has_element?(view, "#return-V3", "36 m")
    assert has_element?(view, "#return-V3 .badge.warn", "It climbs to its own 60 m.")
    assert has_element?(view, "#return-V1 .badge.warn", "Its own return height is not known")
    view |> form("#return-form", %{base: "50"}) |> render_change()
    assert has_element?(view, "#return-V3", "56 m")
    assert operations(console) == []
  end

  test "a held press is one operation: to the heights, then home, and the second one at a place waits", %{
    console: console
  } do
    for n <- 1..3, do: executor(console, n)
    view = console |> open() |> sheet()
    hold(view, value(view))
    refute has_element?(view, "#return")

    for {id, height} <- [{"V1", 30}, {"V2", 33}, {"V3", 36}],
        do:
          assert_receive(
            {:commanded, ^id, "set_altitude", %{altitude: altitude}} when altitude == height,
            Aerie.Patience.ms()
          )

    # Nobody returns before it is at its height.
    refute_received {:commanded, _id, "rtl", _params}

    for {n, home_m, height} <- [{1, 0, 29.0}, {2, 1, 33.4}],
        do: fly(console, n, home_m, position: %{lat: 47.001, lon: 8.0, alt_rel: height})

    assert_receive {:commanded, "V1", "rtl", _params}, Aerie.Patience.ms()
    eventually(fn -> step(console, "V2") == "wait_turn" end)
    refute_received {:commanded, "V2", "rtl", _params}
    fly(console, 1, 0, mode: %{armed: false, in_air: false})
    eventually(fn -> step(console, "V2") == "wait_time" end)

    # The command of V1 may end a moment later.
    eventually(fn ->
      send(view.pid, :console_clock)
      has_element?(view, "#operation-web-1 li", ~r/V1.*Landed/s)
    end)

    assert has_element?(view, "#operation-web-1 li", ~r/V2.*Waiting for its turn/s)
    # One entry, whatever arrives twice.
    assert [%{"id" => "web-1", "name" => "Return"}] = operations(console)
  end

  defp step(console, id) do
    {:ok, operation} = Fleet.operation(console.gateway, "web-1")
    operation["vehicles"][id]["step"]
  end

  test "a press for what has changed since, or for others, sends nothing", %{console: console} do
    view = console |> open() |> sheet()
    shown = value(view)
    fly(console, 2, 1, mode: %{armed: false, in_air: false})
    refresh_fleet(view)
    assert has_element?(view, "#return .field-error", "V2 is not in the air: leave it out.")
    # The refusal stands, whatever a browser sends.
    assert hold(view, shown) =~ "Nothing was sent: V2 is not in the air"
    fly(console, 2, 1)
    :ok = Journal.commit(console.gateway, "V3", %{}, [], %{"RTL_ALT" => 6_000})
    assert hold(view, shown) =~ "What was shown has changed; nothing was sent."

    for odd <- [%{}, %{"return" => "all"}, %{"vehicles" => []}],
        do: assert(render_hook(view, "sheet_go", odd) =~ "has changed")

    assert operations(console) == []

    assert_push_event(view, "map:preview", %{
      routes: [%{text: "1: 30 m", bad: false}, %{bad: true}, %{bad: false}]
    })

    # The page began without any.
    assert_push_event(view, "map:preview", %{routes: []})
    render_hook(view, "sheet_close", %{})
    assert_push_event(view, "map:preview", %{routes: []})
    press = %{"ids" => ["V1"], "of" => ["V1"]}
    assert render_click(view, "sheet_return", press) =~ "The selection changed; nothing was sent."
  end

  test "a mode by its meaning is one operation for those that were shown", %{console: console} do
    for n <- 1..3, do: executor(console, n)
    view = open(console)
    render_click(view, "all")
    assert has_element?(view, "#fleet-mode p", ~r/Mission.*ArduPilot: AUTO/s)
    modes = for n <- 1..3, into: %{}, do: {"V#{n}", "AUTO"}
    press = %{"ids" => ~w(V1 V2 V3), "id" => "web-3", "mode" => "mission", "modes" => modes}
    assert render_hook(view, "mode", %{press | "ids" => ~w(V1)}) =~ "The selection changed; nothing was sent."
    assert render_hook(view, "mode", %{press | "modes" => %{}}) =~ "not all of them have this mode any more"
    assert operations(console) == []
    render_hook(view, "mode", press)

    for id <- ~w(V1 V2 V3),
        do: assert_receive({:commanded, ^id, "set_mode", %{mode: "AUTO"}}, Aerie.Patience.ms())

    assert has_element?(view, "#operation-web-3", "Mode Mission")
    viewer = open(console, :viewer)
    render_click(viewer, "all")
    refute has_element?(viewer, "#fleet-mode")
    render_hook(viewer, "mode", %{press | "id" => "web-4"})
    assert [%{"id" => "web-3"}] = operations(console)
  end

  test "missions start one after the other, and the first failure keeps the rest from beginning", %{
    console: console
  } do
    for n <- 1..3, do: fly(console, n, n * 50, mission: %{seq: 0, total: 4})
    executor(console, 1)
    view = open(console)
    render_click(view, "all")
    view |> element("#fleet-actions button", "Start 3 missions") |> render_click()
    assert has_element?(view, "#start-V2", ~r/4 items.*\+10 s/s)
    view |> form("#start-form", %{interval: "0"}) |> render_change()
    value = value(view, "#start-go")
    # What another sheet showed is for that one.
    assert hold(view, %{"return" => []}) =~ "What was shown has changed"
    hold(view, value)
    assert_receive {:commanded, "V1", "mission_start", _params}, Aerie.Patience.ms()
    # Nobody takes the commands of V2.
    eventually(fn ->
      match?(
        {:ok, %{"state" => "halted", "counts" => %{"waiting" => 1}}},
        Fleet.operation(console.gateway, "web-1")
      )
    end)

    send(view.pid, :console_clock)
    assert has_element?(view, "#operation-web-1", "Start missions: halted at 2 of 3")
  end

  test "a viewer has neither the button nor the events", %{console: console} do
    view = open(console, :viewer)
    render_click(view, "all")
    refute has_element?(view, "#fleet-actions button", ~r/Return/)

    for event <- ~w(sheet_return sheet_go),
        do: render_hook(view, event, %{"ids" => ~w(V1 V2 V3), "of" => ~w(V1 V2 V3)})

    refute has_element?(view, "#return")
    assert operations(console) == []
  end

  test "sixty vehicles are one sheet and one operation", %{console: console} do
    for n <- 1..60, do: fly(console, n, n * 10)
    view = console |> open() |> sheet()
    assert has_element?(view, "#return-V60", "207 m")
    hold(view, value(view))
    assert [%{"counts" => counts}] = operations(console)
    assert counts |> Map.values() |> Enum.sum() == 60
  end

  @tag :chromium
  test "by mouse and keyboard: fields, one that lands under the hand, a killed page, another operator", %{
    console: console
  } do
    for n <- 1..3, do: executor(console, n)
    script = browser(console, "return.mjs")
    await_line(script, "holding")
    fly(console, 3, 200, mode: %{armed: false, in_air: false})
    Port.command(script, "landed\n")
    await_line(script, "ended")
    assert operations(console) == []
    await_line(script, "begun")
    assert [%{"name" => "Return"}] = operations(console)
    kill_pages(console)
    Port.command(script, "killed\n")
    for id <- ~w(V1 V2), do: assert_received({:commanded, ^id, "set_altitude", _params})
    refute_received {:commanded, "V3", _type, _params}
    await_line(script, "ok")
  end
end
