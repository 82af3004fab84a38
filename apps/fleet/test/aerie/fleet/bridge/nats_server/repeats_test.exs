defmodule Aerie.Fleet.Bridge.NatsServer.RepeatsTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.NatsServer.Repeats

  @away "Error trying to connect as leafnode to remote server \"hub:7422\" (attempt "

  test "of lines that differ in numbers alone one a minute is written, and says how many were not" do
    {written, _seen} =
      Enum.flat_map_reduce(0..179, Repeats.new(), fn second, seen ->
        {left_out, seen} = Repeats.observe(seen, @away <> "#{second})", second * 1000)
        {List.wrap(left_out), seen}
      end)

    assert written == [0, 59, 59]
  end

  test "another line is written at once, and what is remembered stays small" do
    {0, seen} = Repeats.observe(Repeats.new(), "Server is ready", 0)
    assert {0, seen} = Repeats.observe(seen, "Leafnode connection created", 1)

    seen =
      for a <- ?a..?z, b <- ?a..?z, reduce: seen do
        seen -> seen |> Repeats.observe(<<a, b>>, 2) |> elem(1)
      end

    assert map_size(seen) <= 100
  end
end
