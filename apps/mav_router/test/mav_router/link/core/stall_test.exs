defmodule MavRouter.Link.Core.StallTest do
  use ExUnit.Case, async: true

  alias MavRouter.Link.Core
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Core.Stall
  alias MavRouter.Endpoints.Endpoint

  setup do: %{endpoint: Endpoint.new(make_ref(), {"link", 1}, out: {:pid, self(), 1})}

  defp room?(endpoint), do: Endpoint.room?(endpoint.waiting, :state, 1)

  test "a peer that takes nothing for a second gets only what it requested, and all when it takes something",
       %{
         endpoint: e
       } do
    assert {0, 10} = Stall.busy(nil, e, 0)
    assert {0, 10} = Stall.busy(0, e, 999)
    assert room?(e)
    assert {0, 250} = Stall.busy(0, e, 1_000)
    refute room?(e)
    refute Endpoint.room?(e.waiting, :transfer, 1)
    :ok = Endpoint.requested(e, System.monotonic_time(:millisecond))
    assert Endpoint.room?(e.waiting, :transfer, 1)
    refute room?(e)
    refute Stall.stuck?(0, 9_999)
    assert Stall.stuck?(0, 10_000)
    assert Stall.took(0, e, 100) == nil
    assert Endpoint.room?(e.waiting, :state, 100)
    refute Endpoint.room?(e.waiting, :state, 101)
    refute Stall.stuck?(nil, 10_000)
  end

  test "a server ends the connection of a stuck peer, and warns of refused ones once a minute" do
    core = Core.new(Spec.parse!("tcpin::1"))
    {core, _} = Core.handle(core, :start, {0, 0})
    {core, _} = Core.handle(core, {:opened, %{}}, {0, 0})
    {core, _} = Core.handle(core, {:peer_up, 1, "10.0.0.1:5"}, {0, 0})

    assert {core, [{:drop, 1}, {:forget, 1}, {:emit, :peer_down, _, %{reason: reason}}]} =
             Core.handle(core, {:peer_stuck, 1}, {1, 1})

    assert reason =~ "took nothing for 10 s"
    assert {core, []} = Core.handle(core, {:peer_stuck, 1}, {2, 2})
    assert {core, [{:warn, "full"}]} = Core.handle(core, {:refused, 3, "full"}, {3, 3})
    assert {core, []} = Core.handle(core, {:refused, 2, "full"}, {60_002, 3})
    assert {core, [{:warn, "full"}]} = Core.handle(core, {:refused, 1, "full"}, {60_003, 3})
    assert Core.counters(core).peers_refused == 6
  end
end
