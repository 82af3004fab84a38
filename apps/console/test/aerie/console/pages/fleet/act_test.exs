defmodule Aerie.Console.Pages.Fleet.ActTest do
  @moduledoc "Acting on several vehicles, without a page: presses, groups, and the take-off that is prepared."
  use ExUnit.Case, async: true

  alias Aerie.Console.Pages.Fleet.Act.{Groups, Height, Mode, Press, Return, Sheet, TakeOff}
  alias Aerie.Console.Pages.Fleet.Act.Mission.Start
  alias Aerie.Console.Pages.Fleet.Board.Row
  alias Aerie.Console.Pages.Fleet.Selection
  alias Aerie.Fleet
  alias Aerie.Vehicle.Snapshot

  defp row(id, more) do
    fields = [
      id: id,
      network: "main",
      system_id: 1,
      kind: "copter",
      autopilot: :px4,
      status: :online,
      state: :armed
    ]

    struct!(Row, Keyword.merge(fields, more))
  end

  describe "a press" do
    test "is one operation with its id, for all at once" do
      assert {:ok, request} = Press.request(%{"id" => "web-1", "type" => "rtl"}, ~w(A B))

      assert request == %{
               "id" => "web-1",
               "name" => "Return",
               "vehicles" => ~w(A B),
               "command" => %{"type" => "rtl", "params" => %{}},
               "step" => 100
             }
    end

    test "with fields has them as the command reads them" do
      event = %{"id" => "web-1", "type" => "take_control", "fields" => %{"reason" => "storm"}}
      assert {:ok, %{"command" => %{"params" => %{"reason" => "storm"}}}} = Press.request(event, ["A"])
    end

    test "of another kind, without a usable id or without vehicles is refused" do
      for event <- [
            %{"id" => "web-1", "type" => "arm"},
            %{"type" => "rtl"},
            %{},
            %{"id" => "a b", "type" => "rtl"}
          ],
          do: assert({:error, _text} = Press.request(event, ["A"]))

      for id <- [nil, 7, "", String.duplicate("x", 33), "no id!"],
          do: assert({:error, _text} = Press.request(%{"id" => id, "type" => "rtl"}, ["A"]))

      assert {:error, "no vehicle is concerned"} =
               Press.request(%{"id" => "w", "type" => "release_control"}, [])
    end
  end

  describe "another height" do
    defp press(metres, air),
      do: %{"id" => "web-1", "air" => air, "fields" => %{"metres" => metres}}

    defp higher(event, rows \\ flying()),
      do: Height.request(event, rows, &%{"A" => 20.04, "B" => 5, "C" => nil}[&1])

    defp flying, do: [row("A", in_air: true), row("B", in_air: true), row("G", in_air: false)]

    test "is as many metres for each, all at once, so that they stay apart" do
      assert {:ok, %{"id" => "web-1", "name" => "Height -2.5 m", "step" => 100, "sequence" => sequence}} =
               higher(press("-2.5", ~w(A B)))

      steps = fn altitude -> [%{"type" => "set_altitude", "params" => %{"altitude" => altitude}}] end

      assert sequence == [
               %{"vehicle" => "A", "steps" => steps.(17.5)},
               %{"vehicle" => "B", "steps" => steps.(2.5)}
             ]
    end

    test "is refused for others than those that were shown, and near the ground" do
      assert {:error, "B would fly at 1.0 m: land it instead"} = higher(press("-4", ~w(A B)))
      assert {:error, "not all of them are in the air any more"} = higher(press("5", ~w(A G)))
      assert {:error, "not all of them are in the air any more"} = higher(press("5", ~w(A X)))
      assert {:error, "the height of C is not known"} = higher(press("5", ["C"]), [row("C", in_air: true)])

      for metres <- ["", "0", "x", "5 m", "101", "-1e9", nil, 5],
          do: assert({:error, "give metres" <> _} = higher(press(metres, ["A"])))

      for odd <- [%{}, %{"id" => "w"}, %{press("5", []) | "air" => "A"}],
          do: assert({:error, _text} = higher(odd))

      assert {:error, _no_id} = higher(%{press("5", ["A"]) | "id" => "no id!"})
    end
  end

  describe "a mode" do
    defp copters(autopilots),
      do: for({id, autopilot} <- autopilots, do: row(id, autopilot: autopilot, in_air: true))

    defp labels(rows) do
      {meant, manual} = Mode.choices(rows)
      {for(choice <- meant, do: {choice.label, choice.words}), for(choice <- manual, do: choice.label)}
    end

    test "is offered by its meaning, with the firmwares' words beside, if all of them have it" do
      assert {[{"Guided", "ArduPilot: GUIDED"}, {"Mission", "ArduPilot: AUTO"}], manual} =
               labels(copters(A: :ardupilot))

      assert "STABILIZE" in manual
      refute "RTL" in manual

      both = copters([{"A", :ardupilot}, {"B", :px4}])
      assert {[_guided, {"Mission", "ArduPilot: AUTO, PX4: AUTO_MISSION"}], manual} = labels(both)
      refute "STABILIZE" in manual
      # One without modes that are known takes all away.
      assert labels(copters([{"A", :ardupilot}, {"G", :generic}])) == {[], []}
    end

    test "that flies set-points only is shown with the reason, and no press sets it" do
      both = copters([{"A", :ardupilot}, {"B", :px4}])
      {[guided, mission], _manual} = Mode.choices(both)
      assert guided.words == "ArduPilot: GUIDED, PX4: OFFBOARD"
      assert guided.refusal =~ "PX4 flies OFFBOARD only while it gets set-points"
      assert mission.refusal == nil
      press = %{"id" => "web-1", "mode" => "guided", "modes" => guided.modes}
      assert Mode.request(press, both) == {:error, guided.refusal}
      assert {[%{name: "guided", refusal: nil}, _mission], _manual} = Mode.choices(copters(A: :ardupilot))
    end

    test "a press gives each vehicle its own word, and only the one that was shown" do
      both = copters([{"A", :ardupilot}, {"B", :px4}])
      modes = %{"A" => "AUTO", "B" => "AUTO_MISSION"}
      press = %{"id" => "web-1", "mode" => "mission", "modes" => modes}

      assert {:ok, %{"id" => "web-1", "name" => "Mode Mission", "sequence" => sequence}} =
               Mode.request(press, both)

      assert for(
               %{"vehicle" => id, "steps" => [%{"type" => "set_mode", "params" => %{"mode" => mode}}]} <-
                 sequence,
               do: {id, mode}
             ) ==
               [{"A", "AUTO"}, {"B", "AUTO_MISSION"}]

      for odd <- [
            %{press | "modes" => %{"A" => "AUTO"}},
            %{press | "modes" => %{"A" => "RTL", "B" => "AUTO_MISSION"}},
            %{press | "mode" => "STABILIZE"},
            %{press | "mode" => ["mission"]},
            %{press | "id" => "no id!"},
            %{}
          ],
          do: assert({:error, _text} = Mode.request(odd, both))

      assert {:error, _text} = Mode.request(press, tl(both))
    end
  end

  describe "groups" do
    @rows [
      %{id: "A", in_air: true, readiness: nil, tags: ["red"]},
      %{id: "B", in_air: false, readiness: :ready, tags: ["blue", "red"]},
      %{id: "C", in_air: nil, readiness: :unknown, tags: []}
    ]

    defp rows, do: for(fields <- @rows, do: row(fields.id, Map.to_list(fields)))

    test "are those that have vehicles, and the first nine tags have digits" do
      assert for(group <- Groups.of(rows()), do: {group.name, group.key, group.ids}) == [
               {"all", nil, ~w(A B C)},
               {"air", nil, ["A"]},
               {"ready", nil, ["B"]},
               {"tag:blue", "1", ["B"]},
               {"tag:red", "2", ~w(A B)}
             ]

      many = [row("A", tags: for(n <- 1..30, do: "t#{n}"))]
      keys = for %{name: "tag:" <> _, key: key} <- Groups.of(many), do: key
      assert Enum.take(keys, 10) == ~w(1 2 3 4 5 6 7 8 9) ++ [nil]
      assert length(keys) == 24
      assert Groups.of([]) == []
    end

    test "a press selects one, and a second press none; an unknown one changes nothing" do
      groups = Groups.of(rows())
      red = Groups.select(%Selection{}, groups, "tag:red")
      assert Selection.among(red, ~w(A B C)) == ~w(A B)
      assert Groups.select(red, groups, "tag:red") == %Selection{}
      assert Selection.size(Groups.select(red, groups, "all")) == 3
      for odd <- ["tag:none", nil, 7], do: assert(Groups.select(red, groups, odd) == red)
    end
  end

  describe "a take-off" do
    defp vehicle(id, lat) do
      position = %{at: 0, data: %{lat: lat, lon: 8.0}}
      %Snapshot{id: id, autopilot: :px4, vehicle_type: "copter", groups: %{position: position}}
    end

    defp facts(states) do
      for {{id, state}, i} <- Enum.with_index(states), into: %{} do
        points = [%{name: :gps, title: "GPS", state: state, text: "is #{state}.", todo: nil}]

        {id,
         %{snapshot: vehicle(id, 47.0 + i / 1000), readiness: %{state: state, points: points}, refusal: nil}}
      end
    end

    defp sheet(ids),
      do: Sheet.new(TakeOff, for({id, i} <- Enum.with_index(ids), do: vehicle(id, 47.0 + i / 1000)))

    defp change(sheet, fields), do: Sheet.event(sheet, "change", fields)
    defp leave(sheet, id), do: Sheet.event(sheet, "leave", %{"id" => id})
    defp move(sheet, id, to), do: Sheet.event(sheet, "move", %{"id" => id, "to" => to})
    defp anyway(sheet, id), do: Sheet.event(sheet, "anyway", %{"id" => id})
    defp refusal(sheet, facts), do: Sheet.refusal(sheet, facts)

    test "goes from south to north, each higher and later than the one before" do
      sheet = Sheet.new(TakeOff, [vehicle("N", 48.0), vehicle("S", 46.0), vehicle("M", 47.0)])
      lines = Sheet.lines(sheet, facts(S: :ready) |> Map.new(fn {id, fact} -> {"#{id}", fact} end))

      assert for(line <- lines, do: {line.id, line.n, line.height, line.after_s}) ==
               [{"S", 1, 20, 0}, {"M", 2, 23, 6}, {"N", 3, 26, 12}]

      same = change(sheet, %{"stacked" => "false", "height" => "15.5"})
      assert for(line <- Sheet.lines(same, %{}), do: line.height) == [15.5, 15.5, 15.5]
    end

    test "one that is left out makes room for those after it" do
      sheet = ~w(A B C) |> sheet() |> leave("B")
      facts = facts([{"A", :ready}, {"B", :not_ready}, {"C", :check}])

      assert [%{n: 1, height: 20}, %{n: nil, height: nil}, %{id: "C", n: 2, height: 23}] =
               Sheet.lines(sheet, facts)

      assert refusal(sheet, facts) == nil

      assert Sheet.shown(sheet, facts)["vehicles"] == [
               ["A", 20, "ready", false],
               ["C", 23, "check", false]
             ]

      assert %{n: 2} = sheet |> leave("B") |> Sheet.lines(facts) |> Enum.at(1)
    end

    test "is refused while one is not ready, unknown, refused, gone, or too near, and if none is left" do
      two = sheet(~w(A B))
      assert refusal(two, facts([{"A", :ready}, {"B", :not_ready}])) == "B is not ready: leave it out."
      unknown = facts([{"A", :ready}, {"B", :unknown}])
      assert refusal(two, unknown) =~ "not known whether B is ready"
      assert refusal(anyway(two, "B"), unknown) == nil
      # Not ready is never taken along.
      assert refusal(anyway(two, "B"), facts([{"A", :ready}, {"B", :not_ready}])) =~ "B is not ready"
      ready = facts([{"A", :ready}, {"B", :ready}])
      assert refusal(two, put_in(ready["B"].refusal, "too high")) == "B: too high"
      assert refusal(two, Map.delete(ready, "A")) =~ "A is not known any more"
      near = put_in(ready["B"].snapshot, vehicle("B", 47.00001))
      assert refusal(two, near) == "A and B stand 1.1 m apart; 3.0 m are wanted. Leave one of them out."
      assert two |> leave("A") |> leave("B") |> refusal(ready) == "All are left out."
      assert refusal(two, ready) == nil
    end

    test "a field with another text or a number beyond its limits keeps what was there, and says so" do
      for {field, text} <- [
            {"height", "0"},
            {"height", "1e9"},
            {"gap", "x"},
            {"interval", ""},
            {"above", "-1"},
            {"above", "5 m"}
          ] do
        sheet = change(sheet(["A"]), %{field => text})
        assert refusal(sheet, facts([{"A", :ready}])) =~ "#{field}: expected a number from"
        assert Map.delete(Map.from_struct(sheet), :error) == Map.delete(Map.from_struct(sheet(["A"])), :error)
      end

      odd =
        change(sheet(["A"]), %{
          "height" => ["30"],
          "on_fail" => "explode",
          "stacked" => "maybe",
          "gap" => %{}
        })

      assert %{height: 20, on_fail: "hold", stacked: "true"} = Sheet.values(odd)
      assert %{values: %{height: 30}, error: nil} = change(odd, %{"height" => "30"})
    end

    test "the next one begins below the height of the lowest, or the field says why not" do
      ready = facts([{"A", :ready}])
      form = &change(&1, %{"height" => &2, "above" => to_string(Sheet.values(&1).above)})

      heights = for height <- ~w(20 10 9.5 7 2 1.5 1 20), do: height

      {above, _sheet} =
        Enum.map_reduce(heights, sheet(["A"]), fn height, sheet ->
          sheet = form.(sheet, height)
          assert {Sheet.errors(sheet)[:above], refusal(sheet, ready)} == {nil, nil}
          {Sheet.values(sheet).above, sheet}
        end)

      assert above == [5, 5, 4, 3, 1, 0.5, 0.5, 5]

      # What somebody has set stays.
      twenty = sheet(["A"]) |> change(%{"height" => "30", "above" => "20"}) |> form.("10")
      assert Sheet.shown(twenty, ready)["values"]["above"] == 20
      words = "The lowest flies at 10 m and is not surely above 20 m: give at most 9.0 m."
      assert {Sheet.errors(twenty)[:above], refusal(twenty, ready)} == {words, words}

      assert refusal(change(twenty, %{"height" => "10", "above" => "9.5"}), ready) =~
               "not surely above 9.5 m"

      assert refusal(change(twenty, %{"height" => "10", "above" => "9"}), ready) == nil
    end

    test "lines are moved to a place, up and down, and never lost" do
      sheet = sheet(~w(A B C))
      assert move(sheet, "C", "A").order == ~w(C A B)
      assert move(sheet, "A", "down").order == ~w(B A C)

      for {id, to} <- [{"A", "up"}, {"X", "A"}, {"A", "X"}, {"C", "down"}],
          do: assert(move(sheet, id, to).order == sheet.order)

      property =
        :proper.forall(
          :proper_types.list(
            {:proper_types.oneof(~w(A B C X)), :proper_types.oneof(~w(A B C X up down)),
             :proper_types.boolean()}
          ),
          fn steps ->
            moved =
              Enum.reduce(steps, sheet, fn
                {id, to, true}, sheet -> move(sheet, id, to)
                {id, _to, false}, sheet -> leave(sheet, id)
              end)

            ns = for %{n: n} when n != nil <- Sheet.lines(moved, %{}), do: n
            Enum.sort(moved.order) == ~w(A B C) and ns == Enum.to_list(1..length(ns)//1)
          end
        )

      assert :proper.quickcheck(property, [:quiet, {:numtests, 200}]) == true,
             inspect(:proper.counterexample())
    end

    test "a press is for all that was shown, and becomes one sequence with the readiness that was shown" do
      sheet = change(sheet(~w(A B)), %{"on_fail" => "return", "interval" => "4"})
      facts = facts([{"A", :ready}, {"B", :check}])
      shown = Sheet.shown(sheet, facts)
      press = shown |> Map.put("id", "web-1") |> JSON.encode!() |> JSON.decode!()
      assert Sheet.meant?(press, shown)

      for {changed, seen} <- [
            {move(sheet, "A", "down"), facts},
            {leave(sheet, "A"), facts},
            {change(sheet, %{"height" => "21"}), facts},
            {sheet, facts([{"A", :ready}, {"B", :ready}])}
          ],
          do: refute(Sheet.meant?(press, Sheet.shown(changed, seen)))

      refute Sheet.meant?(%{"id" => "web-1"}, shown)

      assert Sheet.request(sheet, "web-1", shown, facts) ==
               %{
                 "id" => "web-1",
                 "name" => "Take off",
                 "pause_s" => 4,
                 "halt_ratio" => 0,
                 "on_halt" => "return",
                 "sequence" => [
                   Fleet.take_off(facts["A"].snapshot, 20, 5),
                   Fleet.take_off(facts["B"].snapshot, 23, 5)
                 ],
                 "shown" => %{"A" => "ready", "B" => "check"}
               }
    end
  end

  describe "a return" do
    # Metres to the north of its home, which is as far from the others' as told.
    defp away(id, metres, home_m) do
      lat = 47.0 + home_m / 111_195
      mode = %{at: 0, data: %{in_air: true}}
      position = %{at: 0, data: %{lat: lat + metres / 111_195, lon: 8.0}}
      groups = %{mode: mode, position: position, home: %{at: 0, data: %{lat: lat, lon: 8.0}}}
      %Snapshot{id: id, autopilot: :px4, vehicle_type: "copter", groups: groups}
    end

    defp return(vehicles, own \\ %{}) do
      facts =
        for %{id: id} = vehicle <- vehicles,
            into: %{},
            do: {id, %{snapshot: vehicle, own: Map.get(own, id, 0), climbs?: true, refusal: nil}}

      {Sheet.new(Return, vehicles), facts}
    end

    test "gives the nearest to its home the lowest height, whatever the order of the selection" do
      property =
        :proper.forall(
          :proper_types.non_empty(:proper_types.list(:proper_types.integer(0, 5_000))),
          fn metres ->
            vehicles = for {m, i} <- Enum.with_index(metres), do: away("V#{i}", m, i * 10)
            {sheet, facts} = return(Enum.shuffle(vehicles))
            lines = Sheet.lines(sheet, facts)
            heights = for line <- lines, do: line.height
            far = for line <- lines, do: line.home_m

            heights == Enum.map(1..length(lines), &(30 + (&1 - 1) * 3)) and far == Enum.sort(far) and
              Enum.all?(lines, &(&1.after == nil))
          end
        )

      assert :proper.quickcheck(property, [:quiet, {:numtests, 200}]) == true,
             inspect(:proper.counterexample())
    end

    test "lets those that land at one place wait for the one before, and leaves no gap for one that is left out" do
      {sheet, facts} = return([away("A", 10, 0), away("B", 20, 2), away("C", 30, 100), away("D", 40, 1)])

      assert for(line <- Sheet.lines(sheet, facts), do: {line.id, line.height, line.after}) ==
               [{"A", 30, nil}, {"B", 33, "A"}, {"C", 36, nil}, {"D", 39, "B"}]

      sheet =
        sheet
        |> Sheet.event("leave", %{"id" => "B"})
        |> Sheet.event("change", %{"base" => "40", "step" => "5"})

      assert for(line <- Sheet.lines(sheet, facts), do: {line.id, line.height, line.after}) ==
               [{"A", 40, nil}, {"B", nil, nil}, {"C", 45, nil}, {"D", 50, "A"}]

      assert Sheet.refusal(Sheet.event(sheet, "change", %{"step" => "1"}), facts) =~
               "step: expected a number from 3"
    end

    test "shows on the map each at its height with its way home, and in red what lands at one place" do
      {sheet, facts} = return([away("A", 10, 0), away("B", 20, 2), away("C", 30, 100)])
      shown = fn sheet, facts -> for route <- Sheet.preview(sheet, facts), do: {route.text, route.bad} end
      assert shown.(sheet, facts) == [{"1: 30 m", false}, {"2: 33 m", true}, {"3: 36 m", false}]
      # One that is left out is not shown, nor one whose place is not known.
      assert shown.(leave(sheet, "A"), facts) == [{"1: 30 m", false}, {"2: 33 m", false}]
      nowhere = update_in(facts["A"].snapshot.groups, &Map.delete(&1, :position))
      assert [{"2: 33 m", true}, {"3: 36 m", false}] = shown.(sheet, nowhere)

      for %{way: way, n: n} <- Enum.with_index(Sheet.preview(sheet, facts), &Map.put(&1, :n, &2)) do
        %{groups: %{position: position, home: home}} = facts[Enum.at(~w(A B C), n)].snapshot
        assert way == [[position.data.lat, 8.0], [home.data.lat, 8.0]]
      end
    end

    test "shows on the map of those that take off who stands too near to another one" do
      ready = facts([{"A", :ready}, {"B", :ready}])
      near = put_in(ready["B"].snapshot, vehicle("B", 47.00001))
      texts = for route <- Sheet.preview(sheet(~w(A B)), near), do: {route.text, route.bad, length(route.way)}
      assert texts == [{"1: 20 m", false, 1}, {"2: 23 m", true, 1}]
    end

    test "names those whose firmware undoes the stack, and those of which it is not known" do
      {sheet, facts} =
        return([away("A", 10, 0), away("B", 20, 50), away("C", 30, 100)], %{"A" => 60, "B" => nil, "C" => 36})

      assert [
               %{warn: "It climbs to its own 60 m."},
               %{warn: "Its own return height is not known" <> _},
               %{warn: nil}
             ] =
               Sheet.lines(sheet, facts)

      told = put_in(facts["C"].climbs?, false)

      assert %{height: nil, warn: "It takes no other height" <> _} =
               sheet |> Sheet.lines(told) |> List.last()

      nowhere = update_in(facts["C"].snapshot.groups, &Map.delete(&1, :home))

      assert %{home_m: nil, warn: "Its home is not known" <> _} =
               sheet |> Sheet.lines(nowhere) |> List.last()
    end

    test "is refused for one on the ground, that is gone or not allowed; a press is for all that was shown" do
      {sheet, facts} = return([away("A", 10, 0), away("B", 20, 50)])
      assert Sheet.refusal(sheet, facts) == nil
      assert Sheet.refusal(sheet, Map.delete(facts, "B")) =~ "B is not known any more"

      assert Sheet.refusal(sheet, put_in(facts["B"].snapshot.groups.mode.data.in_air, nil)) =~
               "B is not in the air"

      assert Sheet.refusal(sheet, put_in(facts["B"].refusal, "no")) == "B: no"
      none = sheet |> leave("A") |> leave("B")
      assert Sheet.refusal(none, facts) == "All are left out."

      shown = Sheet.shown(sheet, facts)
      press = shown |> Map.put("id", "web-1") |> JSON.encode!() |> JSON.decode!()
      assert Sheet.meant?(press, shown)
      refute Sheet.meant?(press, Sheet.shown(sheet, put_in(facts["A"].own, 70)))
      refute Sheet.meant?(press, Sheet.shown(leave(sheet, "B"), facts))
      # A press for another sheet.
      refute Sheet.meant?(%{"vehicles" => []}, shown)

      assert Sheet.request(sheet, "web-1", shown, facts) == %{
               "id" => "web-1",
               "name" => "Return",
               "step" => 100,
               "halt_ratio" => 1,
               "sequence" => [Fleet.return_home("A", 30, nil), Fleet.return_home("B", 33, nil)]
             }
    end
  end

  describe "missions that are started one after the other" do
    defp aboard(id, total, in_air \\ true) do
      groups = %{mode: %{at: 0, data: %{in_air: in_air}}, mission: %{at: 0, data: %{total: total}}}
      {id, %{snapshot: %Snapshot{id: id, groups: groups}, refusal: nil}}
    end

    defp starts(sheet, facts), do: for(line <- Sheet.lines(sheet, facts), do: {line.id, line.n, line.after_s})

    test "go by name, with the seconds between them, unless moved or left out" do
      facts = Map.new([aboard("A", 3), aboard("B", 4), aboard("C", nil)])
      sheet = Sheet.new(Start, for({_id, %{snapshot: snapshot}} <- facts, do: snapshot))
      assert starts(sheet, facts) == [{"A", 1, 0}, {"B", 2, 10}, {"C", 3, 20}]
      assert Sheet.refusal(sheet, facts) == nil

      sheet =
        sheet |> Sheet.event("move", %{"id" => "C", "to" => "A"}) |> Sheet.event("leave", %{"id" => "A"})

      sheet = Sheet.event(sheet, "change", %{"interval" => "4.5"})
      assert starts(sheet, facts) == [{"C", 1, 0.0}, {"A", nil, nil}, {"B", 2, 4.5}]
      assert Sheet.refusal(Sheet.event(sheet, "change", %{"interval" => "-1"}), facts) =~ "interval: expected"

      for {event, odd} <- [{"move", %{}}, {"leave", %{"id" => 7}}, {"x", %{}}],
          do: assert(Sheet.event(sheet, event, odd) == sheet)

      shown = Sheet.shown(sheet, facts)
      press = shown |> Map.put("id", "web-1") |> JSON.encode!() |> JSON.decode!()
      assert Sheet.meant?(press, shown)
      # Another mission has come aboard.
      refute Sheet.meant?(
               press,
               Sheet.shown(sheet, Map.new([aboard("A", 3), aboard("B", 5), aboard("C", nil)]))
             )

      assert Sheet.request(sheet, "web-1", shown, facts) == %{
               "id" => "web-1",
               "name" => "Start missions",
               "pause_s" => 4.5,
               "halt_ratio" => 0,
               "sequence" =>
                 for(id <- ~w(C B), do: %{"vehicle" => id, "steps" => [%{"type" => "mission_start"}]})
             }
    end

    test "are refused for one on the ground, without a mission, that is gone or not allowed" do
      facts = Map.new([aboard("A", 3), aboard("B", 4)])
      sheet = Sheet.new(Start, for({_id, %{snapshot: snapshot}} <- facts, do: snapshot))
      refused = fn {id, fact} -> Sheet.refusal(sheet, Map.put(facts, id, fact)) end
      assert refused.(aboard("B", 0)) == "B has no mission aboard: leave it out."
      assert refused.(aboard("B", 4, false)) == "B is not in the air: leave it out."
      assert refused.({"B", nil}) == "B is not known any more: leave it out."
      assert Sheet.refusal(sheet, put_in(facts["A"].refusal, "no")) == "A: no"
      assert sheet |> leave("A") |> leave("B") |> Sheet.refusal(facts) == "All are left out."
    end
  end
end
