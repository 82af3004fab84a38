defmodule Aerie.Fleet.Operations.RequestTest do
  @moduledoc "Operations as they come from outside."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Operations.{Request, Sequence}

  @now 1_800_000_000_000_000
  @rtl %{"vehicles" => ["V-1", "V-2"], "command" => %{"type" => "rtl"}}

  defp wrong(object) do
    {:error, errors} = Request.parse(object, @now)
    for error <- errors, do: error.key
  end

  test "a command for some vehicles, a desired state for a tag" do
    assert {:ok, request} = Request.parse(Map.put(@rtl, "vehicles", ["V-1", "V-2", "V-1"]), @now)
    assert request.targets == {:vehicles, ["V-1", "V-2"]}
    assert request.what == {:command, "rtl", %{}}
    assert %{step: 20, pause_ms: 0, halt_ratio: 1.0} = request.plan
    assert request.timeout_ms == 10_000

    shadow = %{"desired" => %{"params" => %{"FENCE_ALT_MAX" => 80}}, "reason" => "storm"}

    object = %{
      "id" => "roll-7",
      "tag" => "survey",
      "shadow" => shadow,
      "step" => 3,
      "pause_s" => 1.5,
      "halt_ratio" => 0,
      "await" => "converged"
    }

    assert {:ok,
            %{id: "roll-7", targets: {:tag, "survey"}, what: {:shadow, ^shadow}, await: :converged} = request} =
             Request.parse(object, @now)

    assert request.plan == %{step: 3, pause_ms: 1500, halt_ratio: 0.0}
    assert request.timeout_ms == 65_000

    desired = %{
      "params" => Map.new(1..100, &{"P#{&1}", &1}),
      "mission" => %{"plan" => String.duplicate("a", 64)}
    }

    long = %{object | "shadow" => %{"desired" => desired}}
    assert {:ok, %{timeout_ms: 1_165_000}} = Request.parse(long, @now)
    assert {:ok, %{timeout_ms: 3_600_000}} = long |> Map.put("timeout_s", 3_600) |> Request.parse(@now)
    assert wrong(Map.put(@rtl, "timeout_s", 301)) == ["timeout_s"]
  end

  test "what is wrong is named, each key by itself" do
    assert wrong("no object") == ["operation"]
    assert wrong(%{}) == ["vehicles", "command"]
    assert wrong(Map.put(@rtl, "tag", "x")) == ["tag"]
    assert wrong(%{@rtl | "vehicles" => ["V 1"]}) == ["vehicles"]
    assert wrong(%{@rtl | "vehicles" => ["V-1", nil]}) == ["vehicles"]
    assert wrong(%{@rtl | "vehicles" => List.duplicate("V", 2_001)}) == ["vehicles"]

    assert wrong(Map.merge(@rtl, %{"step" => 0, "pause_s" => -1, "halt_ratio" => 2})) == [
             "step",
             "pause_s",
             "halt_ratio"
           ]

    assert wrong(Map.put(@rtl, "step", 2.5)) == ["step"]
    assert wrong(Map.put(@rtl, "await", "converged")) == ["await"]
    assert wrong(Map.put(@rtl, "later", 1)) == ["later"]
    assert wrong(Map.put(@rtl, "id", "a b")) == ["id"]
    assert wrong(%{@rtl | "command" => %{"type" => "fly_away"}}) == ["command.type"]
    assert wrong(%{@rtl | "command" => %{"type" => "rtl", "source" => "me"}}) == ["command.source"]

    for params <- [7, "x", [nil, nil], [1], [[]], []],
        do: assert(wrong(%{@rtl | "command" => %{"type" => "rtl", "params" => params}}) == ["command.params"])

    assert [_one] = wrong(%{@rtl | "command" => %{"type" => "takeoff", "params" => %{"altitude" => "high"}}})
    shadow = &%{"tag" => "x", "shadow" => &1}
    assert wrong(shadow.(%{"desired" => %{"mood" => 1}})) == ["shadow.desired.mood"]
    assert wrong(shadow.(%{"desired" => %{"mode" => "RTL"}, "version" => 3})) == ["shadow.version"]
    assert [_some | _] = wrong(shadow.(7))
  end

  @arm %{"type" => "arm"}
  @up %{
    "sequence" => [
      %{"vehicle" => "V-1", "steps" => [@arm, %{"type" => "takeoff", "params" => %{"altitude" => 20}}]},
      %{
        "vehicle" => "V-2",
        "steps" => [%{"shadow" => %{"desired" => %{"mode" => "LOITER"}}}, %{"wait" => "above", "m" => 5}],
        "else" => [%{"type" => "rtl"}],
        "anyway" => true
      }
    ]
  }

  test "a sequence: each vehicle with its own steps, one after the other unless it says otherwise" do
    assert {:ok, request} = Request.parse(@up, @now)
    assert request.targets == {:vehicles, ["V-1", "V-2"]}
    assert request.plan == %{step: 1, pause_ms: 0, halt_ratio: 0.0}
    assert %{on_halt: :hold, radius_m: 1.5, shown: %{}, timeout_ms: nil} = request
    assert {:sequence, [first, second]} = request.what
    assert first.steps == [{:command, "arm", %{}}, {:command, "takeoff", %{"altitude" => 20}}]
    assert {first.else, first.anyway?, second.anyway?} == {[], false, true}

    assert [{:shadow, _update}, {:wait, %{for: :above, m: 5, timeout_ms: 60_000, go_on?: false}}] =
             second.steps

    more = %{
      "halt_ratio" => 1,
      "on_halt" => "return",
      "radius_m" => 3,
      "name" => "Up",
      "shown" => %{"V-1" => "ready"}
    }

    assert {:ok, request} = Request.parse(Map.merge(@up, more), @now)
    assert %{on_halt: :return, radius_m: 3.0, name: "Up", shown: %{"V-1" => "ready"}} = request
    assert request.plan.halt_ratio == 1.0
  end

  test "a wait for a height to which the steps before do not bring it is refused" do
    up = &%{"type" => "takeoff", "params" => %{"altitude" => &1}}
    to = &%{"type" => "set_altitude", "params" => Map.merge(%{"altitude" => &1}, &2)}
    wait = &%{"wait" => &1, "m" => &2}

    refused = fn steps, more ->
      vehicle = Map.merge(%{"vehicle" => "V-1", "steps" => steps}, more)

      {:ok, %{what: {:sequence, vehicles}}} = Request.parse(%{"sequence" => [vehicle]}, @now)

      case Sequence.futile(vehicles) do
        [] -> nil
        errors -> Enum.map_join(errors, "; ", &to_string/1)
      end
    end

    assert refused.([@arm, up.(10), wait.("above", 20)], %{}) ==
             "sequence[0].steps[2].m: expected at most 9.0 m: V-1 is not surely higher on its way to 10 m, got 20"

    assert refused.([up.(10), wait.("above", 10)], %{}) =~ "at most 9.0 m: V-1"

    assert refused.(
             [
               up.(10),
               %{"type" => "request_message", "params" => %{"message_id" => 242}},
               wait.("above", 10)
             ],
             %{}
           ) =~ "at most 9.0 m"

    assert refused.([to.(30, %{}), wait.("at", 33)], %{}) =~
             "steps[1].m: expected the height of V-1 by then, 30 m, got 33"

    assert refused.([@arm], %{"else" => [to.(30, %{}), wait.("at", 28.5)]}) =~ "sequence[0].else[1].m"

    for steps <- [
          [up.(10), wait.("above", 9)],
          [up.(1), wait.("above", 0.9)],
          [to.(30, %{}), wait.("at", 31), wait.("at", 29)],
          [up.(10), to.(30, %{}), wait.("above", 20)],
          # What else moves it, or is measured from elsewhere, may bring it there.
          [up.(10), %{"type" => "mission_start"}, wait.("above", 20)],
          [to.(30, %{"altitude_reference" => "msl"}), wait.("at", 10)],
          [wait.("above", 5)]
        ],
        do: assert(refused.(steps, %{}) == nil)

    # A place: about 33 m from the other one.
    there = &%{"type" => "goto", "params" => %{"lat" => 47.397, "lon" => 8.5, "altitude" => &1}}
    near = &%{"wait" => "near", "lat" => &1, "lon" => 8.5, "m" => 3}
    assert refused.([there.(20), near.(47.3973)], %{}) =~ "steps[1].m: expected more than the 33 m from there"
    assert refused.([there.(20), wait.("above", 25)], %{}) =~ "at most 19.0 m: V-1"

    for steps <- [
          [there.(20), near.(47.397), wait.("at", 20)],
          [there.(20), to.(30, %{}), near.(47.39701)],
          [there.(20), %{"type" => "mission_start"}, near.(47.3973)],
          [near.(47.3973)]
        ],
        do: assert(refused.(steps, %{}) == nil)
  end

  test "vehicles that wait for each other's landing are refused, whether directly or through others" do
    wait = &%{"wait" => "landed", "of" => &1}
    {rtl, climb} = {%{"type" => "rtl"}, %{"type" => "set_altitude", "params" => %{"altitude" => 30}}}

    refused = fn steps ->
      vehicles = for {id, steps} <- steps, do: %{"vehicle" => id, "steps" => steps}
      {:ok, %{what: {:sequence, vehicles}}} = Request.parse(%{"sequence" => vehicles}, @now)
      for error <- Sequence.futile(vehicles), do: to_string(error)
    end

    assert refused.(%{"V-1" => [climb, wait.("V-2"), rtl], "V-2" => [wait.("V-1"), rtl], "V-3" => [rtl]}) == [
             "sequence[0].steps[1].of: expected a vehicle that lands without waiting for V-1, got \"V-2\"",
             "sequence[1].steps[0].of: expected a vehicle that lands without waiting for V-2, got \"V-1\""
           ]

    circle = fn last -> for n <- 1..last, do: {"V-#{n}", [wait.("V-#{rem(n, last) + 1}"), rtl]} end
    assert length(refused.(circle.(3))) == 3
    assert [_itself] = refused.(circle.(1))
    # 2,000 wait for the one before, or after, and end with one that waits for nobody.
    for list <- [circle.(2_000), Enum.reverse(circle.(2_000))] do
      assert length(refused.(list)) == 8
      assert refused.(List.keyreplace(list, "V-2000", 0, {"V-2000", [rtl]})) == []
    end

    # What may land before it waits.
    for first <- [rtl, %{"type" => "mission_start"}, %{"type" => "set_mode", "params" => %{"mode" => "LAND"}}],
        do: assert(refused.(%{"V-1" => [first, wait.("V-2")], "V-2" => [first, wait.("V-1")]}) == [])
  end

  test "what is wrong with a sequence is named by its place" do
    steps = &%{"sequence" => [%{"vehicle" => "V-1", "steps" => &1}]}
    assert wrong(%{"sequence" => []}) == ["sequence"]

    assert wrong(%{"sequence" => [7, %{"vehicle" => "V 1", "steps" => []}]}) == [
             "sequence[0]",
             "sequence[1].vehicle",
             "sequence[1].steps"
           ]

    assert wrong(steps.(List.duplicate(@arm, 9))) == ["sequence[0].steps"]
    assert wrong(steps.([%{"type" => "takeoff"}])) == ["sequence[0].steps[0].params.altitude"]
    assert wrong(steps.([%{"type" => "arm", "id" => "x"}])) == ["sequence[0].steps[0].id"]
    assert wrong(steps.([@arm, %{"wait" => "above"}])) == ["sequence[0].steps[1].m"]
    assert wrong(steps.([%{"wait" => "landed", "m" => 2}])) == ["sequence[0].steps[0].m"]
    assert wrong(steps.([%{"wait" => "at"}])) == ["sequence[0].steps[0].m"]
    assert wrong(steps.([%{"wait" => "landed", "of" => "V 1"}])) == ["sequence[0].steps[0].of"]
    assert wrong(steps.([%{"wait" => "time", "of" => "V-1"}])) == ["sequence[0].steps[0].of"]
    near = &Map.merge(%{"wait" => "near", "lat" => 47.0, "lon" => 8, "m" => 3}, &1)
    assert {:ok, _request} = Request.parse(steps.([near.(%{})]), @now)
    assert wrong(steps.([near.(%{"lat" => nil})])) == ["sequence[0].steps[0].lat"]
    assert wrong(steps.([near.(%{"lat" => 91, "lon" => "8", "m" => 0})])) |> length() == 3
    assert wrong(steps.([%{"wait" => "at", "m" => 3, "lat" => 47}])) == ["sequence[0].steps[0].lat"]
    assert wrong(steps.([%{"wait" => "later"}])) == ["sequence[0].steps[0].wait"]

    assert wrong(steps.([%{"wait" => "alone", "timeout_s" => 0, "go_on" => 1}])) == [
             "sequence[0].steps[0].timeout_s",
             "sequence[0].steps[0].go_on"
           ]

    assert wrong(steps.([%{"shadow" => %{"desired" => %{"mood" => 1}}}])) == [
             "sequence[0].steps[0].shadow.desired.mood"
           ]

    assert wrong(Map.merge(@up, %{"vehicles" => ["V-1"], "command" => @arm})) == ["command"]
    assert wrong(Map.put(@up, "tag", "x")) == ["tag"]
    assert wrong(Map.put(@up, "shown", %{"V-1" => 7})) == ["shown"]
    assert wrong(Map.put(@rtl, "on_halt", "return")) == ["on_halt"]
    # Many errors are a few, and cost no more than that.
    many = %{"sequence" => for(n <- 1..2_000, do: %{"vehicle" => "V-#{n}", "steps" => []})}
    assert length(wrong(many)) == 8
  end
end
