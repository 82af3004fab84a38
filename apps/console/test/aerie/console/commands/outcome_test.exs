defmodule Aerie.Console.Commands.OutcomeTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command.Result
  alias Aerie.Vehicle.Event
  alias Aerie.Console.Commands.{Entry, Outcome}

  @at 1_795_000_000_000_000
  @done @at + 1_000_000

  defp entry(type, params \\ %{}, more \\ %{}) do
    Map.merge(
      %{
        id: "a",
        vehicle: "VID-001",
        type: type,
        params: params,
        source: "ann",
        via: "console",
        at: @at,
        progress: nil,
        result: Result.new("a", :completed),
        done_at: @done
      },
      more
    )
  end

  defp later(type, status \\ :completed),
    do: entry(type, %{}, %{id: "b", at: @done + 5, result: status && Result.new("b", status)})

  defp vehicle(groups, kind \\ "copter") do
    %{vehicle_type: kind, groups: Map.new(groups, fn {name, data} -> {name, %{at: @at, data: data}} end)}
  end

  defp event(type, data \\ %{}, after_us \\ 60_000_000),
    do: Event.new("VID-001", type, 1, @done + after_us, nil, data)

  # 0.001° are 111 m.
  defp away(metres, more \\ []),
    do: vehicle([position: %{lat: 47.0 + metres / 111_195, lon: 8.0, alt_rel: 20.0}] ++ more)

  @there %{lat: 47.0, lon: 8.0, altitude: 20.0, altitude_reference: "home"}

  defp shown(entry, vehicle, events \\ [], later \\ []) do
    case Outcome.of(entry, later, vehicle, events) do
      nil -> nil
      course -> {course.stage, course.label, course.text}
    end
  end

  test "a flight to a place: how far and how long, until it is there (F7)" do
    fast = [velocity: %{groundspeed: 5.9}]
    assert shown(entry("goto", @there), away(118, fast)) == {:going, "On its way", "118 m to go, 20 s"}
    assert shown(entry("goto", @there), away(118)) == {:going, "On its way", "118 m to go"}
    assert shown(entry("goto", @there), away(2_340, fast)) == {:going, "On its way", "2.3 km to go, 6 min"}
    assert shown(entry("goto", @there), away(3)) == {:there, "Arrived", nil}
    # Above its place, and still climbing.
    assert {:going, _label, _text} = shown(entry("goto", %{@there | altitude: 60.0}), away(3))
    # A plane circles around it.
    plane = %{away(80) | vehicle_type: "plane"}
    assert {:there, "Arrived", nil} = shown(entry("goto", @there), plane)
    assert {:going, "On its way", nil} = shown(entry("goto", @there), vehicle([]))
  end

  test "a landing and a return end on the ground" do
    air =
      vehicle(
        mode: %{in_air: true},
        position: %{alt_rel: 22.4, lat: 47.001, lon: 8.0},
        home: %{lat: 47.0, lon: 8.0}
      )

    assert shown(entry("land"), air) == {:going, "Landing", "22 m above home"}
    assert shown(entry("rtl"), air) == {:going, "Returning", "111 m from home"}

    for type <- ["land", "rtl"],
        ended <- ["landed", "disarmed"],
        do: assert({:there, "Landed", nil} = shown(entry(type), air, [event(ended)]))

    assert {:there, "Landed", nil} = shown(entry("land"), vehicle(mode: %{in_air: false}))
    # It landed before the result was known.
    assert {:there, "Landed", nil} = shown(entry("land"), air, [event("landed", %{}, -500_000)])
    assert {:going, _label, _text} = shown(entry("land"), air, [event("landed", %{}, -90_000_000)])
    # A return that lands by a mode of its own goes on.
    assert {:going, _label, _text} = shown(entry("rtl"), air, [event("mode_change", %{"to" => "QLAND"})])
    rover = vehicle([position: %{lat: 47.0, lon: 8.0}, home: %{lat: 47.0, lon: 8.0}], "rover")
    assert {:there, "Arrived", nil} = shown(entry("rtl"), rover)
  end

  test "a climb, and a mission" do
    low = vehicle(position: %{alt_rel: 3.2})
    high = vehicle(position: %{alt_rel: 9.1})
    climb = entry("takeoff", %{altitude: 10.0})
    assert shown(climb, low) == {:going, "Climbing", "3 m above home, to 10 m"}
    assert {:there, "At height", nil} = shown(climb, high)
    # PX4 changes the mode when it is up there; before that, the climb was broken off.
    mode = [event("mode_change", %{"to" => "AUTO_LOITER"})]
    assert {:there, "At height", nil} = shown(climb, high, mode)
    assert {:ended, "Ended", "mode changed to AUTO_LOITER"} = shown(climb, low, mode)

    flying = vehicle(mission: %{seq: 3, total: 7})
    assert shown(entry("mission_start"), flying) == {:going, "Flying the mission", "item 3 of 7"}
    assert {:there, "Mission completed", nil} = shown(entry("resume"), flying, [event("mission.completed")])
  end

  test "another command, another mode and the ground end it; what was refused does not" do
    goto = entry("goto", @there)
    assert {:ended, "Ended", "by the command Hold"} = shown(goto, away(118), [], [later("hold")])

    for refused <- [:denied, :failed, nil],
        do: assert({:going, _label, _text} = shown(goto, away(118), [], [later("hold", refused)]))

    assert {:going, _label, _text} = shown(goto, away(118), [], [later("camera_photo")])

    assert {:ended, "Ended", "mode changed to RTL"} =
             shown(goto, away(118), [event("mode_change", %{"to" => "RTL"})])

    assert {:ended, "Ended", "the vehicle landed"} = shown(goto, away(118), [event("landed")])
    # The mode that the command itself set.
    assert {:going, _label, _text} = shown(goto, away(118), [event("mode_change", %{"to" => "GUIDED"}, -1)])
  end

  test "only what is completed by beginning has a course" do
    assert shown(entry("hold"), away(1)) == nil
    assert shown(entry("goto", @there, %{result: nil}), away(1)) == nil

    for status <- [:failed, :unknown, :accepted],
        do: assert(shown(entry("goto", @there, %{result: Result.new("a", status)}), away(1)) == nil)
  end

  test "an end is kept, whatever comes later" do
    goto = entry("goto", @there)
    keep = &Outcome.keep(&1, [later("hold", nil), goto], &2, {[], @done + 7})
    assert %{"a" => %{stage: :going, at: nil}} = going = keep.(%{}, away(118))
    assert %{"a" => %{stage: :there, at: at}} = there = keep.(going, away(2))
    assert at == @done + 7
    assert keep.(there, away(500)) == there
    # When the end was not seen, the command's own time is told.
    assert %{"a" => %{stage: :there, at: @done}} = keep.(%{}, away(2))
    assert Outcome.keep(there, [], away(2), {[], @done}) == %{}
  end

  test "the words of a command follow its course" do
    goto = entry("goto", @there)
    going = Outcome.of(goto, [], away(118), [])

    assert %{label: "On its way", text: "118 m to go", tone: :going, going: true, state: :completed} =
             Entry.of(goto, going)

    there = Outcome.of(goto, [], away(1), [])
    assert %{label: "Arrived", tone: :good, going: false, done_at: @done} = Entry.of(goto, there)
    assert %{label: "Done", going: false} = Entry.of(entry("arm"))
  end
end
