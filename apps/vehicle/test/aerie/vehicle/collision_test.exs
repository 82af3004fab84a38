defmodule Aerie.Vehicle.CollisionTest do
  use Aerie.GatewayCase, async: true

  alias Aerie.Store
  alias Aerie.Vehicle.Collision

  @key {"main", 1}

  test "links that carry different vehicles are apart, others are not" do
    gateway = start_gateway()
    assert Collision.of(gateway, @key) == nil
    refute Collision.apart?(gateway, @key, "a", "b")
    links = [["a", "both"], ["b", "both"]]
    collision = %{at: 1, sign: "position", links: links, ways: [["a", {"both", 1}], ["b", {"both", 2}]]}
    Store.put_vehicle(gateway, @key, %{id: "VID-001", collision: collision})
    assert Collision.of(gateway, @key) == collision
    assert Collision.apart?(gateway, @key, "a", "b") and Collision.apart?(gateway, @key, "b", "a")
    refute Collision.apart?(gateway, @key, "a", "both")
    refute Collision.apart?(gateway, @key, "a", "c")
  end
end
