defmodule Aerie.Console.Pages.Operations.WordsTest do
  @moduledoc "What the strip says of an operation and of each vehicle."
  use ExUnit.Case, async: true

  alias Aerie.Console.Pages.Operations.Words
  alias Aerie.Vehicle.{Event, Snapshot}

  # Unix microseconds, and the same as text.
  @begun 1_800_000_000_000_000
  @begun_at "2027-01-15T08:00:00Z"
  @up ["set_mode", "arm", "takeoff", "wait_above"]

  defp operation(vehicles, more \\ %{}) do
    waiting = Enum.count(vehicles, fn {_id, vehicle} -> vehicle["state"] == "waiting" end)

    Map.merge(
      %{
        "name" => "Take off",
        "state" => "running",
        "begun_at" => @begun_at,
        "done_at" => nil,
        "what" => %{"sequence" => @up},
        "counts" => %{"waiting" => waiting},
        "order" => for({id, _vehicle} <- vehicles, do: id),
        "vehicles" => Map.new(vehicles)
      },
      more
    )
  end

  defp seen(mode, in_air, height \\ nil) do
    groups = %{mode: %{mode: mode, in_air: in_air}, position: %{alt_rel: height}}
    %Snapshot{id: "A", groups: Map.new(groups, fn {name, data} -> {name, %{at: 0, data: data}} end)}
  end

  defp words(operation, vehicle, events \\ []),
    do: Words.vehicles(operation, {fn _id -> vehicle end, fn _id, @begun -> events end})

  defp texts(operation, height \\ nil),
    do: for(word <- words(operation, seen("GUIDED", true, height)), do: word.text)

  defp line(operation), do: Words.line(operation, words(operation, seen(nil, true, 12.3)))
  defp at(step), do: %{"state" => "under_way", "step" => step}
  defp ended(state, result, reason), do: %{"state" => state, "result" => result, "reason" => reason}

  @vehicles [
    {"A", %{"state" => "ok", "result" => "completed", "reason" => nil}},
    {"B", %{"state" => "under_way", "step" => "wait_above"}},
    {"C", %{"state" => "under_way", "step" => "arm"}},
    {"D", %{"state" => "waiting"}}
  ]

  test "a vehicle of a take-off by its step, with its height while it climbs" do
    assert texts(operation(@vehicles), 12.3) == ["Up", "Climbing 12 m", "Arming", "Waiting"]
    assert texts(operation(@vehicles), nil) == ["Up", "Climbing", "Arming", "Waiting"]
    assert line(operation(@vehicles)) == "Take off 4: 1 up, 1 climbing, 1 arming, 1 waiting"
  end

  test "what went wrong has its kind and its reason; the line names who it was" do
    vehicles = [
      {"A", ended("failed", "denied", "arm: no")},
      {"B", ended("failed", "timeout", "no answer")},
      {"C", ended("failed", "unknown", "restarted")},
      {"D", ended("failed", "failed", nil)}
    ]

    assert texts(operation(vehicles)) == [
             "Not allowed: arm: no",
             "Failed",
             "No answer: no answer",
             "Unknown: restarted"
           ]

    assert line(operation(vehicles)) ==
             "Take off 4: 1 not allowed: A (arm: no), 1 failed: D, 1 no answer: B (no answer), 1 unknown: C (restarted)"

    many = for n <- 1..60, do: {"V#{n}", ended("failed", "timeout", nil)}
    assert line(operation(many)) == "Take off 60: all no answer: V1, V2, V3 and 57 more"
  end

  test "the rest by what becomes of it" do
    rest = [{"A", ended("ok", "completed", nil)}, {"B", %{"state" => "waiting"}}]
    assert texts(operation(rest, %{"state" => "paused"})) == ["Up", "Waiting"]
    assert texts(operation(rest, %{"state" => "stopped"})) == ["Up", "Stopped"]
    assert texts(operation(rest, %{"state" => "interrupted"})) == ["Up", "Not begun"]
    assert line(operation(rest, %{"state" => "paused"})) == "Take off 2, paused: 1 up, 1 waiting"

    assert line(operation(rest, %{"state" => "interrupted"})) ==
             "Take off: interrupted at 1 of 2; 1 not begun"

    assert line(operation(rest, %{"state" => "halted"})) == "Take off: halted at 1 of 2; 1 up, 1 not begun"
  end

  test "operations without a name, and of one command" do
    what = %{"command" => %{"type" => "rtl", "params" => %{}}}

    unnamed =
      operation([{"A", at(nil)}, {"B", ended("ok", "completed", nil)}], %{"name" => nil, "what" => what})

    assert line(unnamed) == "Rtl 2: all returning"

    all =
      operation([{"A", ended("ok", "completed", nil)}], %{
        "name" => "Hold all",
        "what" => %{"sequence" => ["hold"]}
      })

    assert line(all) == "Hold all: A holding"
    assert Words.name(%{"what" => %{"shadow" => %{}}}) == "Desired state"
    assert Words.name(%{"what" => %{"sequence" => @up}}) == "Operation"
  end

  test "a mission is sent, held off by somebody, and then aboard, or refused with the reason" do
    sent =
      operation(
        [
          {"A", at("shadow")},
          {"B", at("shadow_held")},
          {"C", ended("ok", "converged", nil)},
          {"D", ended("failed", "refused", "Betaflight has no missions")}
        ],
        %{"name" => "Send missions", "what" => %{"sequence" => ["shadow"]}}
      )

    assert line(sent) ==
             "Send missions 4: 1 failed: D (Betaflight has no missions), 1 sending, 1 held off, 1 aboard"
  end

  describe "what the vehicle makes of it later" do
    @ok %{"state" => "ok", "result" => "completed", "reason" => nil}

    defp told(type, more \\ %{}),
      do:
        operation(
          [{"A", @ok}],
          Map.merge(%{"name" => "Act", "what" => %{"command" => %{"type" => type}}}, more)
        )

    defp event(type, after_s), do: Event.new("A", type, 1, @begun + after_s * 1_000_000, nil, %{})
    defp word(type, vehicle, events \\ []), do: type |> told() |> words(vehicle, events) |> hd()

    test "a landing has landed when it is on the ground, whatever the vehicle does then" do
      for {type, going, mode} <- [{"land", "Landing", "LAND"}, {"rtl", "Returning", "AUTO_RTL"}] do
        assert %{text: ^going, going?: true} = word(type, seen(mode, true))
        # Some firmwares show the last part of a return as a landing.
        assert %{text: ^going} = word(type, seen("AUTO_LAND", true))
        assert %{text: "Landed", going?: false, at: nil} = word(type, seen(mode, false))
        at = @begun + 60_000_000
        assert %{text: "Landed", at: ^at} = word(type, seen(mode, false), [event("landed", 60)])
        assert %{text: "Landed", at: ^at} = word(type, seen("AUTO", true), [event("landed", 60)])

        assert %{text: "No longer " <> _, kind: "plain"} =
                 word(type, seen("AUTO", true), [event("armed", 60)])

        # What is not known changes nothing.
        assert %{text: ^going} = word(type, seen(nil, nil))
        assert %{text: ^going} = word(type, nil)
      end

      assert Words.line(told("land"), [word("land", seen("LAND", false)) |> Map.put(:vehicle, "A")]) ==
               "Act: A landed"
    end

    test "another mode ends a hold in the air" do
      for mode <- ["LOITER", "BRAKE", "AUTO_LOITER", "ALT_HOLD"],
          do: assert(%{text: "Holding", kind: "ok"} = word("hold", seen(mode, true)))

      assert %{text: "No longer holding", kind: "plain"} = word("hold", seen("AUTO", true))
      assert %{text: "Holding"} = word("hold", seen("STABILIZE", false))

      for {type, text} <- [{"take_control", "In charge"}, {"release_control", "Released"}],
          do: assert(%{text: ^text} = word(type, nil))
    end

    test "it is shown until a minute after its end, or that of its landings" do
      minute = 60_000_000
      ended = told("land", %{"state" => "done", "done_at" => "2027-01-15T08:00:10Z"})
      done = @begun + 10_000_000
      shown? = fn operation, words, now -> Words.shown?(operation, words, now) end
      landing = words(ended, seen("LAND", true))
      assert shown?.(ended, landing, done + 10 * minute)
      refute shown?.(ended, landing, done + 15 * minute)
      landed = words(ended, seen("LAND", false), [event("landed", 300)])
      assert shown?.(ended, landed, @begun + 300_000_000 + minute - 1)
      refute shown?.(ended, landed, @begun + 300_000_000 + minute)

      failed =
        operation([{"A", ended("failed", "denied", nil)}], %{"state" => "done", "done_at" => @begun_at})

      assert shown?.(failed, words(failed, nil), @begun + minute - 1)
      refute shown?.(failed, words(failed, nil), @begun + minute)
      # What waits for somebody waits.
      assert shown?.(%{failed | "state" => "interrupted"}, words(failed, nil), @begun + 100 * minute)
      running = told("land")
      assert shown?.(running, words(running, seen("LAND", true)), @begun + 100 * minute)
    end
  end

  test "of several that return, those whose firmware takes no height are named until they have landed" do
    vehicle = fn id ->
      autopilot = if id in ~w(B C), do: :betaflight, else: :px4
      groups = %{mode: %{at: 0, data: %{mode: nil, in_air: id != "C"}}}
      %Snapshot{id: id, autopilot: autopilot, vehicle_type: "copter", groups: groups}
    end

    outside = fn ids, more ->
      returning = for id <- ids, do: {id, ended("ok", "completed", nil)}

      returning
      |> operation(Map.merge(%{"name" => "Return all", "what" => %{"sequence" => ["rtl"]}}, more))
      |> Words.vehicles({vehicle, fn _id, _since -> [] end})
      |> Words.outside()
    end

    assert outside.(~w(A B C), %{}) == "Outside the stack, at the firmware's own height: B"
    assert outside.(~w(A B), %{"name" => "Return"}) == "Outside the stack, at the firmware's own height: B"
    # Without heights, or alone, there is no stack.
    assert outside.(~w(A D), %{}) == nil
    assert outside.(["B"], %{}) == nil
    assert outside.(~w(A B), %{"what" => %{"command" => %{"type" => "rtl"}}}) == nil
  end

  test "of sixty, twelve are listed: what went wrong, then those still at it" do
    up = for n <- 1..50, do: {"U#{n}", ended("ok", "completed", nil)}
    going = for n <- 1..9, do: {"G#{n}", at("arm")}
    words = (up ++ going ++ [{"F", ended("failed", "timeout", nil)}]) |> operation() |> words(nil)
    {listed, 48} = Words.listed(words)
    assert for(word <- listed, do: word.vehicle) == ["F"] ++ for(n <- 1..9, do: "G#{n}") ++ ["U1", "U2"]
    few = Enum.take(words, 12)
    assert Words.listed(few) == {few, 0}
  end

  test "those that need somebody come first, with reasons in full; the others stay in their order" do
    why = String.duplicate("a long reason ", 30)
    ok = ended("ok", "completed", nil)

    vehicles =
      [{"A", %{"state" => "waiting"}}, {"B", ok}, {"C", ended("failed", "timeout", "late")}] ++
        [
          {"D", ended("failed", "denied", why)},
          {"E", %{"state" => "waiting"}},
          {"F", ended("failed", "denied", why)}
        ]

    words = words(operation(vehicles), nil)
    assert for(word <- words, do: word.vehicle) == ~w(D F C A B E)
    assert hd(words).text == "Not allowed: " <> why
    assert Words.counts(words) =~ "2 not allowed: D, F (#{why}), 1 no answer: C (late), 2 waiting, 1 up"
  end
end
