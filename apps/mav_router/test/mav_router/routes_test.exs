defmodule MavRouter.RoutesTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  import :proper_types, only: [list: 1, elements: 1, range: 2]

  alias MavRouter.Router
  alias MavRouter.Endpoints
  alias MavRouter.Forward.Holders
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Routes
  alias MavRouter.Router.Sweeper
  alias MavRouter.Tables

  setup do
    gateway = start_parts()
    {:ok, gateway: gateway, tables: Tables.of(gateway)}
  end

  defp learn(c, system, component, link, now),
    do: Routes.learn(c.tables, "main", system, component, {link, 1}, now)

  test "the way heard last, by component where it is heard (R1), else by system (R9)", c do
    learn(c, 1, 1, "a", 10)
    learn(c, 1, 154, "b", 20)
    assert Routes.best(c.tables, {"main", 1}) == {"b", 1}
    assert Routes.best(c.tables, {"main", 1}, component: 1) == {"a", 1}
    # MAV_COMP_ID_LOG is addressed and never talks.
    assert Routes.best(c.tables, {"main", 1}, component: 155) == {"b", 1}
    assert Routes.best(c.tables, {"main", 1}, link: "a") == {"a", 1}
    assert Routes.best(c.tables, {"main", 2}) == nil
    learn(c, 1, 1, "c", 30)
    assert Routes.best(c.tables, {"main", 1}, component: 1) == {"c", 1}
    assert Routes.endpoints(c.tables, {"main", 1}) == [{"c", 1}, {"b", 1}, {"a", 1}]
    assert Routes.endpoints(c.tables, {"main", 1}, 1) == [{"c", 1}, {"a", 1}]
  end

  test "have ages, and are swept when old", c do
    learn(c, 1, 1, "a", 0)
    learn(c, 2, 1, "a", 0)
    learn(c, 1, 1, "a", 250_000)

    assert [%{age_ms: 50_000, known_ms: 300_000}, %{age_ms: 300_000}] =
             c.tables |> Routes.list(300_000) |> Enum.sort()

    assert Sweeper.sweep(c.tables, 300_001) == 1
    assert [%{system: 1}] = Routes.list(c.tables, 300_001)
  end

  test "of a vehicle that is not lost stay, by the endpoint where the gateway reaches it (X6)", c do
    heard = &Routes.learn(c.tables, "main", &1, 1, &2, &3)
    status = &Aerie.Base.Store.put_vehicle(c.gateway, {"main", 1}, %{id: "VID-001", status: &1})

    for {peer, at} <- [{{"a", 1}, 0}, {{"a", 2}, 5}, {{"sat", 1}, 1}, {{"sat", 2}, 2}],
        do: heard.(1, peer, at)

    heard.(2, {"a", 3}, 0)
    needed? = &Holders.needed?(c.tables, c.gateway, &1, &2)

    status.(:online)
    assert for(n <- 1..3, needed?.({"a", n}, 9), do: n) == [2]
    assert for(n <- 1..2, needed?.({"sat", n}, 9), do: n) == []
    # A radio that is out of reach next must not have cost the way by satellite.
    {:ok, sat} = Owner.new("sat", high_latency: true, networks: ["main"])
    Endpoints.put_owner(c.tables, sat)
    assert for(n <- 1..2, needed?.({"sat", n}, 9), do: n) == [2]

    assert Sweeper.sweep(c.tables, 3_600_000, needed?) == 3

    assert c.tables |> Routes.list(0) |> Enum.map(&{&1.link, &1.peer}) |> Enum.sort() == [
             {"a", 2},
             {"sat", 2}
           ]

    status.(:lost)
    assert Sweeper.sweep(c.tables, 3_600_000, needed?) == 2
  end

  test "are cleared by system on a reboot (R6), forgotten by link and by peer", c do
    for system <- 1..3, peer <- 1..2, do: Routes.learn(c.tables, "main", system, 1, {"a", peer}, 0)
    :ok = Routes.forget_system(c.tables, {"main", 1}, "a", :_)
    assert c.tables |> Routes.list(0) |> Enum.map(& &1.system) == [2, 2, 3, 3]
    :ok = Router.forget(c.gateway, "a", 2)
    assert c.tables |> Routes.list(0) |> Enum.map(& &1.peer) == [1, 1]
    :ok = Router.forget(c.gateway, "a")
    assert Routes.list(c.tables, 0) == []
  end

  test "are bounded, for each endpoint and together", c do
    for n <- 1..8_192, do: :new = learn(c, n, 1, "a", 0)
    assert learn(c, 20_000, 1, "a", 0) == :full
    assert learn(c, 5, 1, "a", 7) == :ok

    for other <- 1..32, n <- 1..256, do: :new = learn(c, n, 1, "b#{other}", 0)
    assert learn(c, 300, 1, "b1", 0) == :full
    assert learn(c, 1, 1, "c", 0) == :full
    assert length(Routes.list(c.tables, 0)) == 16_384
  end

  test "a peer that invents twenty thousand components leaves room for a vehicle of another; the refusals are counted",
       c do
    {id, port} = add_link(c.gateway, "tcpin:127.0.0.1:0")
    connect = fn -> :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false]) end
    {:ok, liar} = connect.()

    for component <- 1..80 do
      frames =
        for system <- 1..250,
            do: MavCodec.encode(%MavCodec.Messages.Attitude{}, system: system, component: component)

      :ok = :gen_tcp.send(liar, frames)
    end

    eventually(fn -> snapshot(c.gateway, id).counters.frames_in == 20_000 end)
    {:ok, vehicle} = connect.()
    :ok = :gen_tcp.send(vehicle, heartbeat(251))
    assert {^id, _peer} = eventually(fn -> Router.route(c.gateway, {"main", 251}) end)
    eventually(fn -> snapshot(c.gateway, id).counters.routes_refused == 20_000 - 8_192 end)
  end

  test "the best way is the newest of a plain list", c do
    property =
      :proper.forall(list({range(1, 3), range(0, 2), elements(["a", "b", "c"])}), fn heard ->
        :ets.delete_all_objects(c.tables.routes)

        for {{system, component, link}, n} <- Enum.with_index(heard),
            do: learn(c, system, component, link, n)

        Enum.all?(for(system <- 1..3, component <- 0..3, do: {system, component}), fn {system, component} ->
          of_system = Enum.filter(heard, &(elem(&1, 0) == system))
          of_component = Enum.filter(of_system, &(elem(&1, 1) == component and component != 0))
          expected = List.last(of_component) || List.last(of_system)
          expected = expected && {elem(expected, 2), 1}
          Routes.best(c.tables, {"main", system}, component: component) == expected
        end)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end
end
