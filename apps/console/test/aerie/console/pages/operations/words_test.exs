defmodule Aerie.Console.Pages.Operations.WordsTest do
  @moduledoc "What the strip says of an operation and of each vehicle."
  use ExUnit.Case, async: true

  alias Aerie.Console.Pages.Operations.Words

  @up ["set_mode", "arm", "takeoff", "wait_above"]

  defp operation(vehicles, more \\ %{}) do
    waiting = Enum.count(vehicles, fn {_id, vehicle} -> vehicle["state"] == "waiting" end)

    Map.merge(
      %{
        "name" => "Take off",
        "state" => "running",
        "what" => %{"sequence" => @up},
        "counts" => %{"waiting" => waiting},
        "order" => for({id, _vehicle} <- vehicles, do: id),
        "vehicles" => Map.new(vehicles)
      },
      more
    )
  end

  defp texts(operation, height \\ nil),
    do: for(word <- Words.vehicles(operation, fn _id -> height end), do: word.text)

  defp line(operation), do: Words.line(operation, Words.vehicles(operation, fn _id -> 12.3 end))
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
             "Refused: arm: no",
             "No answer: no answer",
             "Not known: restarted",
             "Failed"
           ]

    assert line(operation(vehicles)) ==
             "Take off 4: 1 refused: A, 1 no answer: B, 1 not known: C, 1 failed: D"

    many = for n <- 1..60, do: {"V#{n}", ended("failed", "timeout", nil)}
    assert line(operation(many)) == "Take off 60: 60 no answer: V1, V2, V3 and 57 more"
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

    assert line(unnamed) == "Rtl 2: 2 returning"

    all =
      operation([{"A", ended("ok", "completed", nil)}], %{
        "name" => "Hold all",
        "what" => %{"sequence" => ["hold"]}
      })

    assert line(all) == "Hold all 1: 1 holding"
    assert Words.name(%{"what" => %{"shadow" => %{}}}) == "Desired state"
    assert Words.name(%{"what" => %{"sequence" => @up}}) == "Operation"
  end
end
