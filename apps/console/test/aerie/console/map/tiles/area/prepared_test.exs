defmodule Aerie.Console.Map.Tiles.Area.PreparedTest do
  use ExUnit.Case, async: true

  alias Aerie.Console.Map.Tiles.Area.Prepared

  defp area(n), do: %{at: n, layer: "own", box: [8.5, 47.3, 8.6 + n, 47.4], zoom: 14, tiles: 20}

  test "the newest first, the same one once, at most twenty" do
    areas = Enum.reduce(1..30, [], &Prepared.add(&2, area(&1)))
    assert Enum.map(areas, & &1.at) == Enum.to_list(30..11//-1)
    assert [%{at: 99} | others] = Prepared.add(areas, %{area(15) | at: 99})
    assert Enum.map(others, & &1.at) == Enum.to_list(30..11//-1) -- [15]
  end

  test "what is kept is read again; what is damaged is not" do
    kept = for n <- 1..20, do: area(n)
    assert {:ok, ^kept} = kept |> JSON.encode!() |> JSON.decode!() |> Prepared.read()
    assert {:ok, []} = Prepared.read(nil)
    odd = [[1], [%{}], %{}, "x", List.duplicate(JSON.decode!(JSON.encode!(area(1))), 21)]

    wrong =
      for change <- [
            %{"zoom" => 99},
            %{"box" => [1, 2, 3]},
            %{"box" => [1, 2, 3, "4"]},
            %{"at" => "1"},
            %{"layer" => nil}
          ],
          do: [Map.merge(JSON.decode!(JSON.encode!(area(1))), change)]

    for given <- odd ++ wrong, do: assert(Prepared.read(given) == :error, inspect(given))
  end
end
