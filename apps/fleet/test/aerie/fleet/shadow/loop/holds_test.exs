defmodule Aerie.Fleet.Shadow.Loop.HoldsTest do
  @moduledoc "Who is in charge of a vehicle."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Shadow.Loop.Holds

  @second 1_000_000

  defp look(holds, at, mode, more \\ %{}, commanded \\ nil) do
    groups = %{mode: %{data: Map.merge(%{mode: "GUIDED", armed: true, failsafe: false}, mode)}}
    groups = Map.merge(groups, Map.new(more, fn {group, data} -> {group, %{data: data}} end))
    Holds.observe(holds, %{groups: groups}, commanded, at * @second)
  end

  defp by(holds, at), do: for(%{by: by} <- Holds.active(holds, at * @second), do: by)

  # Watched for long enough: at its beginning an armed vehicle is held.
  defp new, do: look(Holds.new(30 * @second), -60, %{})
  setup do: %{holds: new()}

  test "of a vehicle that it has just begun to watch, and that may be armed, nobody knows who flies it" do
    for armed <- [true, nil],
        do: assert(Holds.new(30 * @second) |> look(0, %{armed: armed}) |> by(29) == ["begun"])

    assert Holds.new(30 * @second) |> look(0, %{armed: false}) |> by(0) == []
  end

  test "a clock that is set ends no hold and makes none longer", %{holds: holds} do
    holds = look(holds, 1, %{failsafe: true})

    for hours <- [1, -1], jump = hours * 3600 do
      moved = Holds.moved(holds, jump * @second)
      assert by(moved, jump + 30) == ["failsafe"]
      assert by(moved, jump + 32) == []
    end
  end

  test "a quiet vehicle is held by nobody", %{holds: holds} do
    assert by(holds, 0) == []
    assert holds |> look(1, %{}) |> by(1) == []
  end

  test "a failsafe holds while it is active, and for the configured time after", %{holds: holds} do
    holds = holds |> look(1, %{failsafe: true}) |> look(50, %{failsafe: true}) |> look(51, %{})

    assert [%{by: "failsafe", until: 80_000_000, why: "the vehicle is in a failsafe" <> _}] =
             Holds.active(holds, 79 * @second)

    assert by(holds, 80) == []
  end

  test "a change of the mode that nobody here commanded holds; one after a command of ours does not", %{
    holds: holds
  } do
    assert holds |> look(1, %{mode: "LOITER"}) |> by(2) == ["other"]
    acted = Holds.acted(holds, 1 * @second)
    assert acted |> look(5, %{mode: "LOITER"}) |> by(5) == []
    assert acted |> look(12, %{mode: "LOITER"}) |> by(12) == ["other"]
    assert holds |> look(1, %{armed: false}) |> by(1) == ["other"]
  end

  test "the first word of mode and arming is not a change" do
    holds = Holds.new(30 * @second) |> look(0, %{mode: nil, armed: nil}) |> look(31, %{})
    assert by(holds, 31) == []
  end

  test "a direct command holds from its time on, and what follows is its effect", %{holds: holds} do
    commanded = %{at: 4 * @second, source: "ops", type: "set_mode"}
    holds = holds |> look(5, %{}, %{}, commanded) |> look(6, %{mode: "LOITER"}, %{}, commanded)
    assert by(holds, 6) == ["operator"]
    assert by(holds, 33) == ["operator"]
    assert by(holds, 34) == []
    # The same note is not a new command.
    assert holds |> look(40, %{mode: "LOITER"}, %{}, commanded) |> by(40) == []
  end

  test "sticks and switches: a movement holds, noise does not, nor does the first look", %{holds: holds} do
    at = &look(&1, &2, %{}, %{rc: %{channels: &3}})

    holds =
      holds |> at.(1, [1500, 1500, 1000, 1500, 1800, nil]) |> at.(2, [1510, 1490, 1020, 1500, 1800, nil])

    assert by(holds, 2) == []
    moved = at.(holds, 3, [1510, 1560, 1020, 1500, 1800, nil])
    assert by(moved, 3) == ["rc"]
    assert by(moved, 33) == []
    assert holds |> at.(3, [1500, 1500, 1000, 1500, 1200, nil]) |> by(3) == ["rc"]
    # A slow movement adds up.
    slow = Enum.reduce(1..5, holds, &at.(&2, 2 + &1, [1500 + &1 * 10, 1500, 1000, 1500, 1800, nil]))
    assert by(slow, 7) == ["rc"]
  end

  test "armed in a mode that is flown by sticks, with a healthy receiver", %{holds: holds} do
    healthy = %{health: %{rc_receiver: true}}

    flown =
      Holds.new(30 * @second) |> look(-60, %{mode: "STABILIZE"}) |> look(1, %{mode: "STABILIZE"}, healthy)

    assert by(flown, 1) == ["rc"]
    assert Holds.new(30 * @second) |> look(0, %{mode: "STABILIZE", armed: false}, healthy) |> by(1) == []

    broken = %{health: %{rc_receiver: false}}
    assert Holds.new(30 * @second) |> look(-60, %{mode: "STABILIZE"}, broken) |> by(1) == []

    assert holds |> look(1, %{}, healthy) |> by(1) == []
  end
end
