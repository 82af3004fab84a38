defmodule MavRouter.Routes.CollisionsTest do
  @moduledoc "Another vehicle with the id of one that was there before."
  use Aerie.EndpointCase, async: true

  setup c do
    first = vehicle(c.gateway, "first", 1)
    other = vehicle(c.gateway, "other", 1)
    g = client(c.gateway, "g", 255)
    sniffer = endpoint(c.gateway, "sniffer", sniffer: true)
    all = [first, other, g, sniffer]
    got(all)
    :ok = MavRouter.Routes.Collisions.put(c.gateway, {"main", 1}, [{"other", :self}])
    {:ok, first: first, other: other, g: g, sniffer: sniffer, all: all}
  end

  test "its frames go only to sniffers, and it gets no commands", c do
    mine = attitude(1, 1)
    theirs = attitude(1, 2)
    say(c.first, mine)
    say(c.other, theirs)
    answer = message(%Messages.CommandAck{command: 400, target_system: 255, target_component: 190}, 1, 1)
    say(c.other, answer)
    order = message(command(1), 255, 190)
    say(c.g, order)
    got = got(c.all)

    assert %{
             "first" => [^order],
             "other" => [],
             "g" => [^mine],
             "sniffer" => [^mine, ^theirs, ^answer, ^order]
           } = got

    assert counted(c.gateway, "other").counters.collided == 2
    assert Router.route(c.gateway, {"main", 1}) == {"first", :self}
    # Nor do its other parts.
    say(c.other, heartbeat(1, type: 30, autopilot: 8, component: 100))
    assert %{"g" => []} = got(c.all)
    say(c.g, message(command(1, 100), 255, 190))
    assert %{"other" => []} = got(c.all)
  end

  test "the same bytes from both are not duplicates", c do
    same = heartbeat(1, seq: 77)
    say(c.other, same)
    say(c.first, same)
    assert %{"g" => [^same]} = got(c.g)
    assert counted(c.gateway, "first").counters.duplicates == 0
    assert counted(c.gateway, "other").counters.duplicates == 0
  end

  test "its reboot does not clear the first vehicle's routes (R6)", c do
    deliver = fn ms, us ->
      time = message(%Messages.SystemTime{time_boot_ms: ms, time_unix_usec: 1_000_000_000_000_000}, 1, 1)
      deliver(c.gateway, "other", Enum.map(parse(time), &%{&1 | at: us}))
    end

    deliver.(500_000, 0)
    for n <- 0..4, do: deliver.(1_000 + n * 500, n * 500_000)
    assert Router.route(c.gateway, {"main", 1}) == {"first", :self}
  end

  test "when the collision is over, its endpoint is a route again", c do
    test = self()
    ref = make_ref()
    gateway = c.gateway

    :telemetry.attach(
      ref,
      [:aerie, :router, :collision],
      fn _, _, m, _ -> m.gateway == gateway && send(test, {:collision, m.system, m.links}) end,
      nil
    )

    on_exit(fn -> :telemetry.detach(ref) end)
    :ok = MavRouter.Routes.Collisions.put(c.gateway, {"main", 1}, [])
    assert_received {:collision, 1, []}
    :ok = MavRouter.Routes.Collisions.put(c.gateway, {"main", 1}, [])
    refute_received {:collision, _, _}
    bytes = attitude(1, 5)
    say(c.other, bytes)
    assert %{"g" => [^bytes]} = got(c.all)
    assert {"other", 1} in for(r <- Router.routes(c.gateway), do: {r.link, r.system})
    assert Router.route(c.gateway, {"main", 1}) == {"first", :self}
  end
end
