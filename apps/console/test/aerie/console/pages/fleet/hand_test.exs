defmodule Aerie.Console.Pages.Fleet.HandTest do
  @moduledoc "The fleet's page under an operator's hand: a press is for what it showed, and rows keep their places."
  use Aerie.ConsoleCase, async: true

  alias Aerie.Control.Commands
  alias Aerie.Console.Pages.Fleet.{Order, Selection, Sequence}
  alias Aerie.Console.Pages.Fleet.Board.Row

  @changed "The selection changed; nothing was sent."

  describe "a press" do
    setup do
      [console: console] = start_console()
      start_operations(console)
      for n <- 1..3, do: put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n})
      {:ok, view, _html} = live(conn(console, :operator), "/")
      {:ok, console: console, view: view}
    end

    defp select(view, id, how \\ "only"), do: render_hook(view, "select", %{"id" => id, "how" => how})

    defp press(view, name, ids, press \\ "web-1"),
      do: render_hook(view, "command", %{"type" => name, "id" => press, "ids" => ids})

    test "carries the vehicles that its button shows", %{view: view} do
      select(view, "V3")
      select(view, "V1", "toggle")

      for type <- ~w(hold rtl land),
          do:
            assert(
              view |> element("#fleet-#{type}") |> render() =~
                ~s({&quot;ids&quot;:[&quot;V1&quot;,&quot;V3&quot;]})
            )
    end

    test "is refused if other vehicles are selected when it arrives", %{view: view} do
      select(view, "V2")

      for type <- ~w(hold rtl land),
          ids <- [["V1"], ["V1", "V2"], [], nil, "V2", %{"V2" => 1}, [["V2"], 2]] do
        assert press(view, type, ids) =~ @changed
        refute has_element?(view, "#operation-strip")
      end

      select(view, "V1", "toggle")
      assert press(view, "land", ["V2"]) =~ @changed
      render_hook(view, "none", %{})
      assert press(view, "land", ["V2"]) =~ @changed
      refute has_element?(view, "#operation-strip")

      select(view, "V2")
      refute press(view, "land", ["V2"], "web-2") =~ @changed
      assert has_element?(view, "#operation-web-2 li", "V2")
    end

    test "on Tags and Missions is also for the same vehicles", %{view: view} do
      select(view, "V2")
      assert render_click(view, "tag", %{"ids" => ["V1"]}) =~ @changed
      assert render_click(view, "plans", %{"ids" => ["V1"]}) =~ @changed
      refute has_element?(view, "#tags")
      view |> element("button", "Tags") |> render_click()
      # The dialog is for those that it names, whatever is selected behind it.
      select(view, "V1")
      assert has_element?(view, "#tags", "Tags of V2")
    end

    test "on a vehicle that has gone is refused", %{view: view, console: console} do
      select(view, "V1")
      select(view, "V2", "toggle")
      Aerie.Base.Store.delete_vehicle(console.gateway, {"main", 2})
      refresh_fleet(view)
      assert press(view, "rtl", ["V1", "V2"]) =~ @changed
    end

    test "on Acknowledge all is for the alarms that were shown", %{console: console} do
      server = Aerie.Base.Names.whereis(console.gateway, :console_alarms)
      put_vehicle(console, "V1", [mode: %{failsafe: true}], %{key: {"main", 1}, system_id: 1})
      {:ok, alarms, _html} = live(conn(console, :operator), "/alarms")

      button =
        eventually(fn ->
          has_element?(alarms, ".alarm-group", "V1") && element(alarms, "button", "Acknowledge all")
        end)

      assert render(button) =~ ~r/alarms.*a1/
      assert is_pid(server)
      render_click(button)
      eventually(fn -> has_element?(alarms, ".alarm-row", "operator") end)
      # What somebody sends who saw none acknowledges none.
      put_vehicle(console, "V2", [mode: %{failsafe: true}], %{key: {"main", 2}, system_id: 2})
      eventually(fn -> has_element?(alarms, ".alarm-group", "V2") end)
      render_click(alarms, "alarm-acknowledge", %{"all" => "yes"})
      render_click(alarms, "alarm-acknowledge", %{"alarms" => []})
      assert has_element?(alarms, ".alarm-row button", "Acknowledge")
    end
  end

  describe "selected vehicles that the table does not list" do
    setup do
      [console: console] = start_console()
      for n <- 1..3, do: put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n})
      {:ok, view, _html} = live(conn(console, :operator), "/")
      {:ok, view: view, console: console}
    end

    test "are named, and take neither keys nor presses", %{view: view, console: console} do
      select(view, "V1")
      refute has_element?(view, ".fleet-hidden")
      refute view |> element("#fleet-hold") |> render() =~ "data-refusal"
      view |> form("#fleet-filter", %{q: "V2"}) |> render_change()
      assert has_element?(view, ".fleet-hidden", "1 selected vehicle is hidden by the filter: V1")
      refute has_element?(view, ".fleet-selected > strong:not(.fleet-hidden)")

      for type <- ~w(hold rtl land) do
        assert view |> element("#fleet-#{type}[aria-disabled=true]") |> render() =~
                 ~s(data-refusal="Hidden vehicles are selected. Clear the filter or the selection first.")

        # A press that was made before the filter.
        press = %{"type" => type, "id" => "p-#{type}", "ids" => ["V1"]}
        assert render_hook(view, "command", press) =~ "Nothing was sent. Hidden vehicles are selected."
      end

      refute has_element?(view, "#fleet-charge")
      take = %{"type" => "take_control", "id" => "p-take", "ids" => ["V1"], "holders" => %{}}
      assert render_hook(view, "command", take) =~ "Nothing was sent"
      assert Commands.recent(console.gateway, "V1") == []

      select(view, "V2", "toggle")
      assert has_element?(view, ".fleet-selected strong", "V2")
      assert has_element?(view, ".fleet-hidden", "V1")
    end

    test "in words" do
      selection = %Selection{ids: MapSet.new(~w(a b c d e))}
      all = ~w(a b c d e f)
      assert Selection.summary(selection, all, all) == {"5 vehicles (a, b, c …)", nil}

      assert {"a", "4 selected vehicles are hidden by the filter: 4 vehicles (b, c, d …)"} =
               Selection.summary(selection, all, ~w(a f))

      assert Selection.summary(%Selection{ids: MapSet.new(["a"])}, all, []) ==
               {nil, "1 selected vehicle is hidden by the filter: a"}
    end
  end

  describe "rows" do
    setup do
      [console: console] = start_console()
      for {n, left} <- [{1, 0.5}, {2, 0.6}, {3, 0.7}], do: battery(console, n, left)
      {:ok, view, _html} = live(conn(console, :operator), "/?sort=battery")
      {:ok, console: console, view: view}
    end

    defp battery(console, n, left),
      do: put_vehicle(console, "V#{n}", [battery: %{remaining: left}], %{key: {"main", n}, system_id: n})

    defp order(view) do
      refresh_fleet(view)
      Regex.scan(~r/<tr[^>]*data-id="([^"]+)"/, render(view), capture: :all_but_first) |> List.flatten()
    end

    for {what, on, off} <- [
          {"the pointer is over the table or something in it has the focus",
           {"pointer", %{"over" => true, "ids" => ["V1", "V2", "V3"]}},
           {"pointer", %{"over" => false, "ids" => []}}},
          {"a vehicle is selected", {"select", %{"id" => "V2", "how" => "only"}}, {"none", %{}}}
        ] do
      test "keep their places while #{what}", %{console: console, view: view} do
        {on, value} = unquote(Macro.escape(on))
        {off, off_value} = unquote(Macro.escape(off))
        render_hook(view, on, value)
        battery(console, 1, 0.9)
        assert order(view) == ~w(V1 V2 V3)
        assert has_element?(view, ".fleet-order", "Order from")
        battery(console, 0, 0.1)
        assert order(view) == ~w(V1 V2 V3 V0)

        # What somebody asks for is done.
        view |> element("button", "Sort now") |> render_click()
        assert order(view) == ~w(V0 V2 V3 V1)
        refute has_element?(view, ".fleet-order")
        battery(console, 0, 0.95)
        assert order(view) == ~w(V0 V2 V3 V1)
        view |> element("button[phx-value-by=id]") |> render_click()
        assert order(view) == ~w(V0 V1 V2 V3)
        render_hook(view, off, off_value)
        refute has_element?(view, ".fleet-order")
      end
    end

    test "that stop matching the filter stay, and say so", %{console: console, view: view} do
      view |> element("button[phx-value-flag=armed]") |> render_click()
      render_hook(view, "pointer", %{"over" => true, "ids" => []})
      put_vehicle(console, "V2", [mode: %{armed: false}], %{key: {"main", 2}, system_id: 2})
      assert order(view) == ~w(V1 V2 V3)
      assert has_element?(view, "#vehicle-V2.fleet-left")
      render_hook(view, "sort_now", %{})
      assert order(view) == ~w(V1 V3)
    end

    test "take the places that the browser showed when the hand came", %{view: view} do
      render_hook(view, "pointer", %{"over" => true, "ids" => ["V3", "never", "V1", "V1", 7]})
      assert order(view) == ~w(V3 V1 V2)

      for odd <- [%{"over" => "yes"}, %{"over" => true, "ids" => "V1"}],
          do: render_hook(view, "pointer", odd)

      assert Process.alive?(view.pid)
    end

    test "are as high with alarms, tags and somebody in charge as without", %{view: view} do
      for part <- [
            "td.fleet-problems[title]",
            "th .fleet-line",
            "colgroup col.fleet-col-link",
            ".fleet-status",
            ".fleet-dock"
          ],
          do: assert(has_element?(view, part))
    end
  end

  test "rows of the same shown values keep their order by name, whatever the decimals behind" do
    for column <- ~w(battery height speed), direction <- [:asc, :desc], _round <- 1..50 do
      rows = for n <- 1..8, do: row("V#{n}", 0.5 + :rand.uniform() / 20)
      sorted = Order.sort(Enum.shuffle(rows), {column, direction})
      assert sorted == Order.sort(Enum.shuffle(rows), {column, direction})

      for [one, two] <- Enum.chunk_every(sorted, 2, 1, :discard),
          shown(one, column) == shown(two, column),
          do: assert(one.id < two.id)
    end
  end

  defp row(id, value) do
    data = fn map -> %{at: 0, data: map} end

    groups = %{
      battery: data.(%{remaining: value}),
      position: data.(%{alt_rel: value * 40 - 10}),
      velocity: data.(%{groundspeed: value - 0.5})
    }

    Row.new(
      %Aerie.Vehicle.Snapshot{
        id: id,
        key: id,
        network: "main",
        system_id: 1,
        vehicle_type: "copter",
        autopilot: :px4,
        firmware: nil,
        status: :online,
        links: [],
        groups: groups,
        last_heard: 0
      },
      [],
      %{},
      0
    )
  end

  defp shown(row, "battery"), do: round(row.battery * 100)
  defp shown(row, "height"), do: "#{row.height}"
  defp shown(row, "speed"), do: "#{row.speed}"

  test "nothing moves while it is held, and nobody is lost or doubled" do
    all = ~w(a b c d e f g h)

    for _round <- 1..200 do
      [ids, sorted] = for _list <- 1..2, do: Enum.take_random(all, :rand.uniform(9) - 1)
      held = %Sequence{} |> Sequence.sort(ids, 0) |> Sequence.follow(sorted, all, true, 10_000)
      assert Enum.take(held.ids, length(ids)) == ids
      assert Enum.sort(held.ids) == Enum.sort(Enum.uniq(ids ++ sorted))
      assert held.differs == (held.ids != sorted)
      assert Sequence.follow(held, sorted, all, false, 10_000).ids == sorted
      assert Enum.sort(Sequence.adopt(held, ["x" | Enum.reverse(sorted)]).ids) == Enum.sort(held.ids)
    end
  end

  test "without a hand the table is sorted every five seconds, and at once when somebody comes or goes" do
    sequence = Sequence.sort(%Sequence{}, ~w(a b), 0)
    assert Sequence.follow(sequence, ~w(b a), ~w(a b), false, 4_999).ids == ~w(a b)
    assert Sequence.follow(sequence, ~w(b a), ~w(a b), false, 5_000).ids == ~w(b a)
    assert Sequence.follow(sequence, ~w(c b a), ~w(a b c), false, 1).ids == ~w(c b a)
  end
end
