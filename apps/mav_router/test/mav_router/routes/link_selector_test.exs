defmodule MavRouter.Routes.LinkSelectorTest do
  use Aerie.LinkCase, async: true

  alias MavRouter.Routes
  alias MavRouter.Tables
  alias MavRouter.Routes.LinkSelector

  @key {"main", 1}

  setup do
    gateway = start_parts()
    # The test does the measuring here.
    :ok = :sys.suspend(Aerie.Base.Names.whereis(gateway, :router_meter), Aerie.Patience.ms())
    {:ok, tables: Tables.of(gateway)}
  end

  test "what is configured goes before what is measured, until nothing comes by it", c do
    both = ["a", "b"]
    assert LinkSelector.links(c.tables, "mast", both, nil) == ["a"]
    :ets.insert(c.tables.scores, {{:carrier, "mast"}, "b"})
    assert LinkSelector.links(c.tables, "mast", both, nil) == ["b"]
    assert LinkSelector.links(c.tables, "mast", both, "a") == ["a"]
    assert LinkSelector.links(c.tables, "mast", both, "c") == ["b"]
    assert LinkSelector.links(c.tables, "mast", both, :all) == both
    assert LinkSelector.links(c.tables, "mast", ["a"], "b") == ["a"]

    for {score, carries} <- [{80.0, "a"}, {0.0, "b"}] do
      :ets.insert(c.tables.scores, {{:score, "a"}, %{score: score, loss: nil, rtt_ms: nil, age_ms: nil}})
      assert LinkSelector.links(c.tables, "mast", both, "a") == [carries]
    end
  end

  test "a link that does not hear the vehicle any more is passed over, however good it is for others", c do
    ways = [{"a", :self}, {"b", :self}]
    for way <- ways, do: Routes.learn(c.tables, "main", 1, 1, way, 10_000)
    assert LinkSelector.within_reach(c.tables, @key, ways) == ways
    Routes.learn(c.tables, "main", 1, 1, {"b", :self}, 14_000)
    assert LinkSelector.within_reach(c.tables, @key, ways) == ways
    Routes.learn(c.tables, "main", 1, 1, {"b", :self}, 15_001)
    assert LinkSelector.within_reach(c.tables, @key, ways) == [{"b", :self}]
    # While neither is heard, both are as good as before.
    assert LinkSelector.within_reach(c.tables, {"main", 9}, ways) == ways
  end
end
