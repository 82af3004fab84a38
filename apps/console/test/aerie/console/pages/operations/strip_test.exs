defmodule Aerie.Console.Pages.Operations.StripTest do
  @moduledoc "Operations at the foot of every page, and *Abort all* at its head."
  use Aerie.ConsoleCase, async: true

  alias Aerie.Fleet.Operations

  @operator %{name: "operator", role: :operator, permissions: []}
  @other %{name: "other", role: :operator, permissions: []}

  setup do
    [console: console] = start_console()
    dir = Path.join(console.dir, "operations")
    start_supervised!({Operations.Supervisor, gateway: console.gateway, dir: dir})
    grounded = [mode: %{armed: false, in_air: false}, position: %{alt_rel: 0.0}]

    for n <- 1..3 do
      place = %{lat: 47.0 + n / 1000, lon: 8.5}

      put_vehicle(
        console,
        "V#{n}",
        Keyword.merge(grounded, home: place, position: Map.put(place, :alt_rel, 0.0)),
        %{key: {"main", n}, system_id: n}
      )
    end

    {:ok, console: console}
  end

  # Each waits on the ground, so that it is under way until the test says otherwise.
  defp up(console, source \\ @operator) do
    steps = [
      %{"wait" => "above", "m" => 5, "timeout_s" => 3600},
      %{"type" => "takeoff", "params" => %{"altitude" => 20}}
    ]

    sequence = for n <- 1..3, do: %{"vehicle" => "V#{n}", "steps" => steps, "anyway" => true}
    request = %{"id" => "up", "name" => "Take off", "sequence" => sequence}
    {:ok, _operation} = Operations.begin(console.gateway, request, source, "console")
    eventually(fn -> match?(%{"step" => "wait_above"}, state(console)["vehicles"]["V1"]) end)
  end

  defp state(console), do: console.gateway |> Operations.get("up") |> elem(1)

  defp look(view) do
    send(view.pid, :console_clock)
    render(view)
  end

  defp open(console, role, path \\ "/"), do: console |> conn(role) |> live(path) |> elem(1)

  test "every page shows it, with words for each vehicle", %{console: console} do
    up(console)

    for path <- ["/", "/alarms", "/audit", "/vehicles/V2"] do
      view = open(console, :admin, path)
      assert has_element?(view, "#operation-strip", "Take off 3: 1 climbing, 2 waiting")
      assert has_element?(view, "#operation-up li", "Climbing 0 m")
    end
  end

  test "who began it pauses and continues, another operator stops and aborts, a viewer looks on", %{
    console: console
  } do
    up(console)
    viewer = open(console, :viewer)
    assert has_element?(viewer, "#operation-strip", "1 climbing")
    refute has_element?(viewer, "#operation-strip button")
    assert render_click(viewer, "operation-stop", %{"operation" => "up"}) =~ "Ask an operator"

    mine = open(console, :operator)
    mine |> element("#operation-strip button", "Pause") |> render_click()
    assert %{"state" => "paused"} = state(console)
    assert has_element?(mine, "#operation-strip", "Take off 3, paused")
    # As many as the button says.
    assert render_hook(mine, "operation-continue", %{"operation" => "up", "waiting" => 1}) =~
             "has changed; nothing was begun"

    assert %{"state" => "paused"} = state(console)

    theirs = open(console, :admin)
    refute has_element?(theirs, "#operation-continue-up")

    assert render_hook(theirs, "operation-continue", %{"operation" => "up", "waiting" => 2}) =~
             "operator has paused it"

    assert has_element?(theirs, "#operation-abort-up")

    render_hook(mine, "operation-continue", %{"operation" => "up", "waiting" => 2})
    assert %{"state" => "running"} = state(console)
    theirs |> look()
    theirs |> element("#operation-strip button", "Stop: the rest stays on the ground") |> render_click()
    assert %{"state" => "stopped"} = state(console)
    assert look(mine) =~ "1 climbing, 2 stopped"
  end

  test "aborted, it is given up, and an operation of its own brings back what it had begun", %{
    console: console
  } do
    up(console, @other)
    view = open(console, :operator)
    render_hook(view, "operation-abort", %{"operation" => "up", "command" => "rtl"})
    assert %{"state" => "stopped", "then" => back} = state(console)
    # It stands, but may have been commanded just now.
    assert is_binary(back)
    assert has_element?(view, "#operation-#{back}", "Return all: V1")
    refute has_element?(view, "#operation-abort-up")
  end

  test "after a restart it says where it was interrupted, and goes on with the rest or is left", %{
    console: console
  } do
    up(console)
    :ok = stop_supervised!(Operations.Supervisor)
    Aerie.Base.Store.forget(console.gateway, {:operation, "up"})
    view = open(console, :admin)
    refute has_element?(view, "#operation-strip")

    start_supervised!(
      {Operations.Supervisor, gateway: console.gateway, dir: Path.join(console.dir, "operations")}
    )

    assert look(view) =~ "Take off: interrupted at 1 of 3; 2 not begun"
    assert has_element?(view, "#operation-continue-up", "Continue with 2")
    render_hook(view, "operation-continue", %{"operation" => "up", "waiting" => 2})

    assert %{"state" => "running", "source" => "admin", "vehicles" => %{"V1" => %{"result" => "unknown"}}} =
             state(console)

    view |> element("#operation-strip button", "Stop") |> render_click()
    assert %{"counts" => %{"waiting" => 1}} = state(console)
  end

  test "abort all is there while something of mine or of nobody's flies, and says how many", %{
    console: console
  } do
    view = open(console, :operator)
    refute has_element?(view, "#abort-all")
    fly = fn n -> put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n}) end
    for n <- 1..3, do: fly.(n)
    # What all pages share is a second old at most.
    eventually(fn -> look(view) =~ "abort-hold" end)
    assert has_element?(view, "#abort-hold", "Hold 3")
    refute console |> open(:viewer) |> has_element?("#abort-all")

    assert console |> open(:viewer) |> render_hook("abort-all", %{"command" => "hold"}) =~
             "Ask an operator"

    assert render_hook(view, "abort-all", %{"command" => "terminate"})
    assert Operations.list(console.gateway) == []
    render_hook(view, "abort-all", %{"command" => "land"})
    assert [%{"name" => "Land all", "source" => "operator", "id" => id}] = Operations.list(console.gateway)
    assert has_element?(view, "#operation-#{id}", "Land all 3")
  end

  test "those that return and wait for their turn are stopped in the air", %{console: console} do
    for n <- 1..2, do: put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n})
    steps = [%{"wait" => "landed", "of" => "V2", "timeout_s" => 900}, %{"type" => "rtl"}]

    request = %{
      "id" => "up",
      "name" => "Return",
      "step" => 100,
      "sequence" => [%{"vehicle" => "V1", "steps" => steps}]
    }

    {:ok, _operation} = Operations.begin(console.gateway, request, @other, "console")
    view = open(console, :operator)
    eventually(fn -> look(view) =~ "Return: V1 waiting for its turn" end)
    assert has_element?(view, "#operation-abort-up", "Abort: hold all")
    render_hook(view, "operation-abort", %{"operation" => "up", "command" => "land"})
    assert %{"state" => "running"} = state(console)
    render_hook(view, "operation-abort", %{"operation" => "up", "command" => "hold"})
    assert %{"state" => "stopped", "then" => held} = state(console)
    assert has_element?(view, "#operation-#{held}", "Hold all: V1")
    refute has_element?(view, "#operation-abort-up")
  end

  test "of those that return, it names whose firmware takes no height", %{console: console} do
    for {n, autopilot} <- [{1, :px4}, {2, :betaflight}],
        do: put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n, autopilot: autopilot})

    steps = [%{"wait" => "landed", "timeout_s" => 900}, %{"type" => "rtl"}]
    sequence = for n <- 1..2, do: %{"vehicle" => "V#{n}", "steps" => steps}
    request = %{"id" => "up", "name" => "Return", "step" => 2, "sequence" => sequence}
    {:ok, _operation} = Operations.begin(console.gateway, request, @other, "console")

    assert console
           |> open(:operator)
           |> has_element?("#operation-up .badge.warn", "Outside the stack, at the firmware's own height: V2")
  end

  test "what is over is closed by each for all of their pages", %{console: console} do
    {:ok, _operation} =
      Operations.begin(
        console.gateway,
        %{"id" => "in", "name" => "Land", "vehicles" => ["V1"], "command" => %{"type" => "land"}},
        @operator,
        "console"
      )

    mine = open(console, :operator)
    # This gateway takes no commands.
    eventually(fn -> look(mine) =~ "Land: V1 not allowed: the gateway takes no commands just now" end)
    mine |> element("#operation-in button[aria-label^=Close]") |> render_click()
    refute has_element?(mine, "#operation-in")
    refute console |> open(:operator, "/alarms") |> has_element?("#operation-in")
    assert console |> open(:admin) |> has_element?("#operation-in")
    viewer = open(console, :viewer)
    assert has_element?(viewer, "#operation-in")
    refute has_element?(viewer, "#operation-in button")
    assert render_hook(mine, "operation-close", %{"operation" => ["in"]})
  end

  test "sixty vehicles are one row", %{console: console} do
    sequence =
      for n <- 1..60, do: %{"vehicle" => "W#{n}", "steps" => [%{"wait" => "landed", "timeout_s" => 600}]}

    request = %{"id" => "up", "name" => "Many", "sequence" => sequence, "step" => 50}
    {:ok, _operation} = Operations.begin(console.gateway, request, @operator, "console")
    view = open(console, :operator)
    assert has_element?(view, "#operation-strip", "Many 60: 50 landing, 10 waiting")
    assert has_element?(view, "#operation-up li", "and 48 more")
    assert has_element?(view, "#operation-strip button", "Stop: the rest does not begin")
    refute has_element?(view, "#operation-abort-up")
  end

  describe "in a browser" do
    @describetag :chromium

    test "the strip by mouse and keyboard", %{console: console} do
      up(console)
      assert browse(console, "operations.mjs", ["strip"]) =~ "ok"
      assert %{"state" => "stopped"} = state(console)
    end

    test "Abort all by its key, from a page without vehicles, and by its menu", %{console: console} do
      for n <- 1..3, do: put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n})
      assert browse(console, "operations.mjs", ["abort"]) =~ "ok"
      names = for %{"name" => name} <- Operations.list(console.gateway), do: name
      assert Enum.sort(names) == ["Hold all", "Return all"]
    end
  end
end
