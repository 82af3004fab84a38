defmodule Aerie.Fleet.Operations.RequestTest do
  @moduledoc "Operations as they come from outside."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Operations.Request

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
end
