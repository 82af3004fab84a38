defmodule Aerie.Fleet.Tracks.CoreTest do
  @moduledoc "Who has a sample at a tick, and when a group of blocks begins."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Tracks.{Block, Core, Sample}

  @at 1_700_000_040_000
  @air %Sample{flags: 3, mode: "AUTO", lat: 1, lon: 2}
  @ground %Sample{flags: 0, mode: "STABILIZE", lat: 1, lon: 2}

  # What is written at each tick, read again: `{begins?, names}`; nil where nothing is.
  defp run(ticks) do
    {written, _core} =
      Enum.map_reduce(ticks, {Core.new(), Block.new()}, fn event, {core, reader} ->
        {core, actions} = Core.handle(core, event)

        case actions do
          [{:write, _at, begins?, block, count}] ->
            {:ok, reader, "", names} =
              Block.fold(reader, IO.iodata_to_binary(block), [], fn _at, samples, _acc ->
                {:cont, Enum.map(samples, &elem(&1, 0))}
              end)

            assert count == length(names)
            {{begins?, names}, {core, reader}}

          [] ->
            {nil, {core, reader}}
        end
      end)

    written
  end

  defp tick(seconds, vehicles), do: {:tick, @at + seconds * 1000, vehicles}

  test "in the air each second, on the ground each thirty" do
    both = [{"a", @air}, {"g", @ground}]
    written = run(for second <- 0..60, do: tick(second, both))
    minute = for second <- 1..60, do: if(rem(second, 30) == 0, do: ["a", "g"], else: ["a"])
    assert Enum.map(written, &elem(&1, 1)) == [["a", "g"] | minute]
  end

  test "a group begins with each minute, when the clock is set back, and after a block that was not written" do
    both = [{"a", @air}, {"g", @ground}]
    all = {true, ["a", "g"]}

    assert run([tick(0, both), tick(29, both), tick(60, both), tick(61, both)]) ==
             [all, {false, ["a"]}, all, {false, ["a"]}]

    assert run([tick(10, both), tick(5, both), tick(6, both)]) == [all, all, {false, ["a"]}]
    assert run([tick(1, both), :not_written, tick(2, both)]) == [all, nil, all]
  end

  test "a change of mode, arming or contact is written at once, a change of place is not" do
    ground = fn change -> [{"g", struct!(@ground, change)}] end
    lost = ground.(flags: 8)

    assert [{true, _}, nil, {false, ["g"]}, nil, {false, ["g"]}, {false, ["g"]}, nil] =
             run([
               tick(0, ground.([])),
               tick(1, ground.(lat: 5)),
               tick(2, ground.(mode: "GUIDED")),
               tick(3, ground.(mode: "GUIDED")),
               tick(4, ground.(flags: 1)),
               tick(5, lost),
               tick(6, lost)
             ])

    # One that is lost in the air does not fly any more, as far as anybody knows.
    assert [{true, _}, {false, _}, nil] =
             run([
               tick(0, [{"a", @air}]),
               tick(1, [{"a", %{@air | flags: 11}}]),
               tick(2, [{"a", %{@air | flags: 11}}])
             ])
  end

  test "vehicles beyond the limit and names that are too long are left out, and counted" do
    many = for n <- 1..(Block.max_vehicles() + 5), do: {"v-#{n}", @ground}
    {_core, actions} = Core.handle(Core.new(), tick(0, many))
    assert [{:write, _at, true, _block, written}, {:left_out, 5}] = actions
    assert written == Block.max_vehicles()

    assert {_core, [{:write, _, true, _, 1}, {:left_out, 1}]} =
             Core.handle(Core.new(), tick(0, [{String.duplicate("n", 129), @air}, {"a", @air}]))

    assert {_core, []} = Core.handle(Core.new(), tick(0, []))
  end
end
