defmodule Aerie.Console.Pages.Fleet.RowsTest do
  use ExUnit.Case, async: true

  alias Aerie.Console.Pages.Fleet.{Filter, Order, Selection}
  alias Aerie.Console.Pages.Fleet.Board.{Problems, Row}
  alias Aerie.Console.Map.Payload

  @now 1_795_000_000_000_000

  defp snapshot(groups \\ %{}, more \\ %{}) do
    groups = Map.new(groups, fn {name, data} -> {name, %{at: @now, time_boot_ms: nil, data: data}} end)

    Map.merge(
      %Aerie.Vehicle.Snapshot{
        id: "VID-001",
        network: "main",
        system_id: 1,
        autopilot: :px4,
        vehicle_type: "copter",
        firmware: "1.15.4",
        status: :online,
        last_heard: @now,
        links: ["radio"],
        groups: groups
      },
      more
    )
  end

  defp row(id, more \\ []),
    do:
      struct!(
        %Row{
          id: id,
          order: Row.order(id),
          network: "main",
          system_id: 7,
          kind: "copter",
          autopilot: :px4,
          status: :online,
          state: :disarmed
        },
        more
      )

  describe "a row" do
    test "of a vehicle of which nothing is known but that it is there" do
      row = Row.new(snapshot(%{}, %{last_heard: nil, links: []}), [], %{}, @now)

      assert %{mode: nil, armed: nil, battery: nil, height: nil, link: nil, silent_us: nil, state: :disarmed} =
               row

      assert row.problems == [] and row.tags == []
    end

    test "rounds to what is shown" do
      groups = %{
        position: %{lat: 47.1, lon: 8.5, alt_rel: 3.26},
        velocity: %{groundspeed: 4.128},
        battery: %{remaining: 0.6789, voltage: 22.81},
        gps: %{fix: 3, satellites: 255},
        mode: %{mode: "GUIDED", armed: true, in_air: true}
      }

      links = [
        %{id: "radio", quality: %{score: 55.4}, last_heard: @now, spec: %{}},
        %{id: "lte", quality: %{score: 91.0}, last_heard: @now, spec: %{}}
      ]

      vehicle = snapshot(groups, %{links: ["radio", "gone"]})
      row = Row.new(vehicle, links, %{"VID-001" => ["north"]}, @now + 2_900_000)
      assert %{height: 3.3, speed: 4.1, battery: 0.68, voltage: 22.8, satellites: nil, link: 55} = row
      assert row.silent_us == 2_000_000
      assert row.tags == ["north"]
      assert Row.new(put_in(vehicle.groups.position.data.alt_rel, 120.4), links, %{}, @now).height == 120
    end

    test "a value that is not a number is not known" do
      row = Row.new(snapshot(%{position: %{alt_rel: :nan}, velocity: %{groundspeed: nil}}), [], %{}, @now)
      assert row.height == nil and row.speed == nil
    end
  end

  describe "problems" do
    for {name, groups, more, expected} <- [
          {"none", %{mode: %{failsafe: false}, battery: %{remaining: 0.9}}, %{}, []},
          {"lost", %{}, %{status: :lost}, [bad: "lost"]},
          {"stale", %{}, %{status: :stale}, [warn: "not heard"]},
          {"failsafe", %{mode: %{failsafe: true}}, %{}, [bad: "failsafe"]},
          {"collision", %{}, %{collision: %{at: 1}}, [bad: "two vehicles with one id"]},
          {"fence", %{mission: %{fence_breach: true}}, %{}, [bad: "outside its fence"]},
          {"battery low", %{battery: %{remaining: 0.3}}, %{}, [warn: "battery 30 %"]},
          {"battery empty", %{battery: %{remaining: 0.1}}, %{}, [bad: "battery 10 %"]},
          {"battery by its own word", %{battery: %{remaining: 0.5, charge_state: "CRITICAL"}}, %{},
           [bad: "battery critical"]},
          {"no fix in the air", %{gps: %{fix: 1}, mode: %{in_air: true}}, %{}, [bad: "no GPS fix"]},
          {"no fix on the ground", %{gps: %{fix: 1}, mode: %{in_air: false}}, %{}, []},
          {"sensors", %{health: %{unhealthy: ["MAV_SYS_STATUS_SENSOR_3D_GYRO", "GPS"]}}, %{},
           [warn: "unhealthy: 3d gyro, gps"]},
          {"the worst first", %{health: %{unhealthy: ["GPS"]}, mode: %{failsafe: true}}, %{},
           [bad: "failsafe", warn: "unhealthy: gps"]}
        ] do
      test name do
        vehicle = snapshot(unquote(Macro.escape(groups)), unquote(Macro.escape(more)))
        assert Problems.of(vehicle) == unquote(expected)
      end
    end
  end

  describe "the filter" do
    test "is in the address and back" do
      params = %{
        "q" => "sky",
        "type" => "plane",
        "firmware" => "px4",
        "tag" => "a b",
        "armed" => "1",
        "problem" => "1"
      }

      filter = Filter.parse(params)
      assert filter |> Filter.params() |> Map.new() == params
      assert Filter.any?(filter)
      refute Filter.any?(Filter.parse(%{"q" => "", "armed" => "0", "unknown" => "1", "type" => ["x"]}))
    end

    test "shows what matches all of it" do
      row =
        row("VID-007",
          armed: true,
          in_air: false,
          mode: "GUIDED",
          tags: ["north"],
          problems: [bad: "failsafe"]
        )

      for {params, shown?} <- [
            {%{}, true},
            {%{"q" => "vid guided"}, true},
            {%{"q" => "return"}, false},
            {%{"q" => "7"}, true},
            {%{"q" => "NORTH"}, true},
            {%{"q" => "vid auto"}, false},
            {%{"armed" => "1"}, true},
            {%{"armed" => "1", "air" => "1"}, false},
            {%{"stale" => "1"}, false},
            {%{"problem" => "1"}, true},
            {%{"unready" => "1"}, false},
            {%{"type" => "copter"}, true},
            {%{"type" => "plane"}, false},
            {%{"firmware" => "ardupilot"}, false},
            {%{"tag" => "north"}, true},
            {%{"tag" => "south"}, false}
          ] do
        assert Filter.shows?(Filter.parse(params), row) == shown?, inspect(params)
      end
    end

    test "a flag is switched on and off; others are ignored" do
      filter = Filter.toggle(%Filter{}, "air")
      assert filter.flags == [:air]
      assert Filter.toggle(filter, "air").flags == []
      assert Filter.toggle(filter, "no flag") == filter
    end
  end

  describe "the order" do
    test "of ids is that of their numbers, and what is not known is last both ways" do
      rows = [row("VID-10", battery: 0.5), row("VID-9"), row("VID-2", battery: 0.9), row("7")]
      assert ids(Order.sort(rows, {"id", :asc})) == ["7", "VID-2", "VID-9", "VID-10"]
      assert ids(Order.sort(rows, {"battery", :asc})) == ["VID-10", "VID-2", "7", "VID-9"]
      assert ids(Order.sort(rows, {"battery", :desc})) == ["VID-2", "VID-10", "7", "VID-9"]
    end

    test "by alarms puts first what is not ready, and what is well last both ways" do
      rows = [
        row("well"),
        row("check", readiness: :check, open: ["Mode: It cannot be armed in LAND."]),
        row("warned", problems: [warn: "battery 25 %"]),
        row("ready", readiness: :ready),
        row("unready", readiness: :not_ready, open: ["GPS: No position."])
      ]

      assert ids(Order.sort(rows, {"problems", :asc})) == ~w(unready warned check ready well)
      assert ids(Order.sort(rows, {"problems", :desc})) == ~w(check warned unready ready well)
      shown = fn state -> Filter.shows?(Filter.parse(%{"unready" => "1"}), row("x", readiness: state)) end

      assert for(state <- [:ready, :check, :not_ready, :unknown, nil], shown.(state), do: state) == [
               :not_ready,
               :unknown
             ]
    end

    test "by state puts first who needs somebody" do
      rows = for state <- [:disarmed, :armed, :stale, :failsafe, :lost], do: row("#{state}", state: state)
      assert ids(Order.sort(rows, {"state", :asc})) == ~w(lost failsafe stale armed disarmed)
    end

    test "every column sorts rows of which nothing is known" do
      rows = [row("b"), row("a")]

      for column <- ~w(id state mode battery gps height speed link age problems),
          do: assert(ids(Order.sort(rows, {column, :desc})) |> Enum.sort() == ["a", "b"])
    end

    test "is in the address; a press turns it around" do
      assert Order.parse("-battery") == {"battery", :desc}
      assert Order.parse("unknown") == {"id", :asc}
      assert Order.param({"battery", :desc}) == "-battery"
      assert Order.param({"id", :asc}) == nil
      assert {"mode", :asc} |> Order.press("mode") |> Order.press("mode") == {"mode", :asc}
      assert Order.press({"mode", :asc}, "speed") == {"speed", :asc}
    end
  end

  describe "the selection" do
    @order ~w(a b c d e)

    test "one, one more, a range, all, none" do
      selection = Selection.only(%Selection{}, "b")
      assert Selection.among(selection, @order) == ["b"]
      selection = Selection.range(selection, "d", @order)
      assert Selection.among(selection, @order) == ~w(b c d)
      assert selection |> Selection.range("a", @order) |> Selection.among(@order) == ~w(a b)
      selection = Selection.toggle(selection, "c")
      assert Selection.among(selection, @order) == ~w(b d)
      assert selection |> Selection.all(@order) |> Selection.size() == 5
      assert selection |> Selection.all(@order) |> Selection.all(@order) |> Selection.size() == 0
    end

    test "a range without an anchor that is shown is this one alone" do
      assert %Selection{} |> Selection.range("c", @order) |> Selection.among(@order) == ["c"]
      assert %Selection{anchor: "hidden"} |> Selection.range("c", @order) |> Selection.among(@order) == ["c"]
    end

    test "a vehicle that is gone is selected no longer" do
      selection = %Selection{ids: MapSet.new(~w(a x)), anchor: "x"}
      assert Selection.keep(selection, @order) == %Selection{ids: MapSet.new(["a"]), anchor: nil}
    end

    test "any presses select only what is there, and never fail" do
      press = :proper_types.oneof([:only, :toggle, :range, :all, :keep])

      property =
        :proper.forall(:proper_types.list({press, :proper_types.oneof(@order ++ ["gone"])}), fn presses ->
          selection =
            Enum.reduce(presses, %Selection{}, fn
              {:all, _id}, selection -> Selection.all(selection, @order)
              {:keep, _id}, selection -> Selection.keep(selection, @order)
              {:range, id}, selection -> Selection.range(selection, id, @order)
              {how, id}, selection -> apply(Selection, how, [selection, id])
            end)

          kept = Selection.keep(selection, @order)

          Enum.all?(kept.ids, &(&1 in @order)) and
            Selection.size(kept) == length(Selection.among(kept, @order))
        end)

      assert :proper.quickcheck(property, [:quiet, {:numtests, 200}]) == true,
             inspect(:proper.counterexample())
    end
  end

  describe "what the map gets" do
    test "a row has numbers that the eye can tell apart, and no position no row" do
      groups = %{
        position: %{lat: 47.123456789, lon: 8.5, alt_rel: 12.34, heading: 93.4},
        velocity: %{vn: 0.0, ve: -5.0, groundspeed: 5.04},
        mode: %{armed: true, in_air: true}
      }

      assert Payload.row(snapshot(groups)) ==
               ["VID-001", 47.1234568, 8.5, 93, 270, 5.0, 12.3, "copter", :armed, true, nil, false]

      assert ["survey", true] = groups |> snapshot() |> Payload.row("survey", true) |> Enum.take(-2)

      assert Payload.row(snapshot(%{position: %{lat: 47.1, lon: :nan}})) == nil
      assert Payload.row(snapshot()) == nil
    end

    test "the state: what is old comes first" do
      armed = %{mode: %{armed: true, failsafe: true}}
      assert Payload.state(snapshot(armed)) == :failsafe
      assert Payload.state(snapshot(armed, %{status: :stale})) == :stale
      assert Payload.state(snapshot(armed, %{status: :lost})) == :lost
    end

    test "only what has changed, and who is gone" do
      [a, b, moved] = [["A", 1.0, 2.0], ["B", 1.0, 2.0], ["A", 1.5, 2.0]]
      assert {%{all: true, vehicles: [^a, ^b], gone: []}, sent} = Payload.changes(%{}, [a, b])
      assert {nil, ^sent} = Payload.changes(sent, [a, b])
      assert {%{all: false, vehicles: [^moved], gone: ["B"]}, sent} = Payload.changes(sent, [moved])
      assert {%{all: false, vehicles: [], gone: ["A"]}, sent} = Payload.changes(sent, [])
      assert sent == %{}
    end

    test "any changes, applied as the map does, give the present vehicles" do
      row = {:proper_types.oneof(~w(A B C D)), :proper_types.range(1, 3)}

      property =
        :proper.forall(:proper_types.list(:proper_types.list(row)), fn steps ->
          {map, _sent, expected} =
            Enum.reduce(steps, {%{}, %{}, %{}}, fn rows, {map, sent, _expected} ->
              rows = for {id, n} <- Map.new(rows), do: [id, n]
              {payload, sent} = Payload.changes(sent, rows)
              {applied(map, payload), sent, Map.new(rows, fn [id | _] = row -> {id, row} end)}
            end)

          map == expected
        end)

      assert :proper.quickcheck(property, [:quiet, {:numtests, 200}]) == true,
             inspect(:proper.counterexample())
    end

    test "each home once" do
      home = fn lat -> snapshot(%{home: %{lat: lat, lon: 8.0, alt_msl: 1.0}}) end

      homes = Enum.map([home.(47.0), home.(47.0000001), home.(48.0), snapshot()], &Payload.home/1)

      assert Payload.homes(homes) == [
               [47.0, 8.0],
               [48.0, 8.0]
             ]
    end
  end

  defp applied(map, nil), do: map

  defp applied(map, %{all: all?, vehicles: rows, gone: gone}) do
    map = if all?, do: %{}, else: Map.drop(map, gone)
    Map.merge(map, Map.new(rows, fn [id | _] = row -> {id, row} end))
  end

  defp ids(rows), do: Enum.map(rows, & &1.id)
end
