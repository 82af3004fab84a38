defmodule MavRouter.Forward.HoldersTest do
  @moduledoc "Who is believed to be a vehicle: the endpoints that bring it, and nobody who only says so."
  use Aerie.EndpointCase, async: true

  alias MavRouter.Routes
  alias MavRouter.Forward.Holders
  alias MavRouter.Tables

  @vehicle {"main", 1}

  setup c do
    v = vehicle(c.gateway, "v", 1, gcs: :deny)
    g = client(c.gateway, "g", 255)
    be_session(c.gateway, 1)
    got([v, g])
    {:ok, v: v, g: g, tables: Tables.of(c.gateway), now: System.monotonic_time(:millisecond)}
  end

  # Of everybody who has no right to be the vehicle: on its link, at clients' endpoints.
  defp impostors(c) do
    [
      endpoint(c.gateway, "stranger", side: :vehicle, gcs: :deny),
      endpoint(c.gateway, "viewer", side: :client),
      endpoint(c.gateway, "reader", side: :client, role: :read_only)
    ]
  end

  defp claims do
    [
      %Messages.Ping{seq: 1},
      %Messages.Attitude{roll: 0.5},
      %Messages.CommandAck{command: 400, target_system: 255, target_component: 190},
      %Messages.SystemTime{time_boot_ms: 5},
      %Messages.Heartbeat{type: 2, autopilot: 3, mavlink_version: 3},
      %Messages.Heartbeat{type: 2, autopilot: 12, mavlink_version: 3},
      %Messages.Statustext{text: "disarmed"}
    ]
  end

  defp flush do
    receive do
      {:frames, _sender, frames} -> frames ++ flush()
    after
      0 -> []
    end
  end

  defp order(c, component \\ 1) do
    order = message(command(1, component), 255, 190, seq: System.unique_integer([:positive]) |> rem(256))
    say(c.g, order)
    order
  end

  test "R1: whatever others say in the vehicle's name, commands go to the vehicle, and its session hears nothing",
       c do
    flush()

    for impostor <- impostors(c), claim <- claims(), component <- [1, 0] do
      say(impostor, message(claim, 1, component))
      order = order(c)
      all = [c.v, c.g, impostor]
      assert %{"v" => [^order], "g" => []} = got = got(all)
      assert got[impostor.name] == []
      # The gateway's own.
      own = message(command(1), 245, 191)
      assert :ok = Router.send(c.gateway, @vehicle, own, component: 1)
      assert Router.route(c.gateway, @vehicle) == {"v", :self}
      eventually(fn -> got(c.v)["v"] == [own] end)
      assert got(impostor) == %{impostor.name => []}
    end

    assert flush() == []
    assert Router.systems(c.gateway)[@vehicle].components |> Map.keys() == [1]
  end

  test "what they claim is reported to the session, by whichever message, and not what comes back by a router",
       c do
    [stranger, viewer | _] = impostors(c)
    say(stranger, message(%Messages.Ping{seq: 1}, 1, 1))
    assert_receive {:claimed, {"stranger", :self}, at} when is_integer(at)
    say(viewer, message(%Messages.Attitude{}, 1, 1))
    assert_receive {:claimed, {"viewer", :self}, _at}
    # From now on the vehicle's frames are remembered.
    echo = endpoint(c.gateway, "echo", side: :client)
    for n <- 1..20, do: Enum.each([c.v, echo], &say(&1, attitude(1, n)))
    refute_received {:claimed, {"echo", :self}, _at}
    assert counted(c.gateway, "echo").counters.duplicates == 20
    assert counted(c.gateway, "stranger").counters.collided == 1
  end

  test "copies of its frames that come first do not suppress the vehicle's", c do
    [stranger | _] = impostors(c)
    all = for seq <- 0..255, do: heartbeat(1, seq: seq)
    for beat <- all, do: say(stranger, beat)
    for beat <- all, do: say(c.v, beat)
    assert %{"g" => ^all} = got(c.g)
  end

  test "copies of a client's commands by a stranger make no loop of them", c do
    [stranger | _] = impostors(c)
    order = message(command(1, 1, 20), 255, 190)
    say(stranger, [gcs(255), order])

    for n <- 1..30 do
      for _ <- 1..20, do: say(stranger, order)
      say(c.g, order)
      assert {n, %{"v" => [order]}} == {n, got(c.v)}
    end
  end

  test "clocks of made-up components that start over clear nothing (R6)", c do
    for impostor <- impostors(c), component <- [1, 7, 77] do
      for {ms, n} <- Enum.with_index([500_000, 1_000, 1_500, 2_000, 2_500, 3_000]) do
        time =
          message(%Messages.SystemTime{time_boot_ms: ms, time_unix_usec: 1_000_000_000_000_000}, 1, component)

        deliver(c.gateway, impostor.name, Enum.map(parse(time), &%{&1 | at: n * 500_000}))
      end

      order = order(c)
      assert List.last(got(c.v)["v"]) == order
      assert Router.route(c.gateway, @vehicle) == {"v", :self}
    end
  end

  test "R1, R9: a part on a socket of its own gets what is for it, a stranger's no more than a copy", c do
    camera = endpoint(c.gateway, "camera", side: :vehicle, gcs: :deny, parts: true)
    stranger = endpoint(c.gateway, "stranger", side: :vehicle, gcs: :deny)
    say(camera, heartbeat(1, type: 30, autopilot: 8, component: 100))
    say(stranger, heartbeat(1, type: 26, autopilot: 8, component: 154))
    parts = [c.v, camera, stranger]
    got(parts)

    send = fn component ->
      own = message(command(1, component), 245, 191)
      :ok = Router.send(c.gateway, @vehicle, own, component: component)
      own
    end

    order = order(c, 100)
    assert %{"v" => [], "camera" => [^order], "stranger" => []} = got(parts)
    own = send.(100)
    assert %{"v" => [], "camera" => [^own], "stranger" => []} = got(parts)
    order = order(c, 154)
    assert %{"v" => [^order], "camera" => [], "stranger" => [^order]} = got(parts)
    own = send.(154)
    assert %{"v" => [^own], "camera" => [], "stranger" => [^own]} = got(parts)

    # However much it talks, what is for the autopilot goes there.
    for n <- 1..20, do: say(camera, heartbeat(1, type: 30, autopilot: 8, component: 100, seq: n))
    got(parts)
    for component <- [1, 0, 191], do: send.(component)
    assert %{"v" => [_, _, _], "camera" => [], "stranger" => []} = got(parts)

    # The gimbal is on the vehicle's radio after all.
    say(c.v, heartbeat(1, type: 26, autopilot: 8, component: 154))
    got(parts)
    order = order(c, 154)
    assert %{"v" => [^order], "stranger" => []} = got(parts)
  end

  describe "seniority" do
    defp path(owner, fields \\ []) do
      struct!(
        %MavRouter.Forward.Table.Path{key: {owner, :self}, owner: owner, side: :vehicle, networks: ["main"]},
        fields
      )
    end

    defp hears(c, owner, at), do: Routes.learn(c.tables, "main", 1, 1, {owner, :self}, at)

    test "another address has the id only while the first is silent, and not any more when it is back", c do
      later = c.now + 4_000
      hears(c, "v", later)
      assert Holders.join(c.tables, @vehicle, path("lte"), {2, 3}, false, later) == :claim
      assert Holders.standing(c.tables, @vehicle, 1, path("lte"), true, later) == :claim

      gone = later + 5_001
      assert Holders.join(c.tables, @vehicle, path("lte"), {2, 12}, false, gone) == :claim
      assert Holders.standing(c.tables, @vehicle, 1, path("lte"), true, gone) == :claim
      assert Holders.join(c.tables, @vehicle, path("lte"), {2, 3}, false, gone) == :changed
      hears(c, "lte", gone)
      assert Holders.standing(c.tables, @vehicle, 1, path("lte"), true, gone) == :holder
      assert Holders.way(c.tables, @vehicle, [], gone) == [{"lte", :self}]

      hears(c, "v", gone + 100)
      assert Holders.standing(c.tables, @vehicle, 1, path("lte"), true, gone + 100) == :claim
      assert Holders.way(c.tables, @vehicle, [], gone + 100) == [{"v", :self}]
    end

    test "with the address that was removed its seniority goes at once", c do
      Routes.forget(c.tables, "v")
      assert Holders.join(c.tables, @vehicle, path("again"), {2, 3}, false, c.now) == :changed
      hears(c, "again", c.now)
      assert Holders.way(c.tables, @vehicle, [], c.now) == [{"again", :self}]
    end

    test "a cable joins and comes before an address that anybody can use; another autopilot never joins", c do
      cable = %{path("cable") | key: {"cable", :remote}}
      assert Holders.join(c.tables, @vehicle, cable, {1, 12}, false, c.now) == :claim
      assert Holders.join(c.tables, @vehicle, cable, {2, 3}, false, c.now) == :changed
      Routes.learn(c.tables, "main", 1, 1, {"cable", :remote}, c.now)
      assert Holders.active(c.tables, @vehicle, c.now) == [{"cable", :remote}]
      assert Holders.join(c.tables, @vehicle, path("usb"), {2, 3}, true, c.now) == :changed
    end

    test "who may command anyway joins as the junior", c do
      assert Holders.join(c.tables, @vehicle, path("here", commands: true), {2, 3}, false, c.now) == :changed
      hears(c, "here", c.now + 2_000)
      hears(c, "v", c.now)
      assert Holders.active(c.tables, @vehicle, c.now) == [{"v", :self}, {"here", :self}]
      assert Holders.way(c.tables, @vehicle, [], c.now + 2_000) == [{"v", :self}]
      # It is not heard any more, and nobody waits until it is lost.
      assert Holders.way(c.tables, @vehicle, [], c.now + 2_600) == [{"here", :self}]
    end

    test "another link of its group joins, by one address only", c do
      for name <- ["a", "b"], do: endpoint(c.gateway, name, side: :vehicle, gcs: :deny, group: "mast")
      vehicle = {"main", 9}
      a = path("a", group: "mast")
      b = path("b", group: "mast")
      assert Holders.join(c.tables, vehicle, a, {2, 3}, false, c.now) == :changed
      Routes.learn(c.tables, "main", 9, 1, a.key, c.now)
      assert Holders.join(c.tables, vehicle, b, {2, 3}, false, c.now) == :changed
      Routes.learn(c.tables, "main", 9, 1, b.key, c.now)
      assert Holders.active(c.tables, vehicle, c.now) == [a.key, b.key]
      assert Holders.join(c.tables, vehicle, %{b | key: {"b", 2}}, {2, 3}, false, c.now) == :claim
      assert Holders.join(c.tables, vehicle, path("c", group: "other"), {2, 3}, false, c.now) == :claim
    end

    test "members and systems are bounded, and forgotten with their routes", c do
      for n <- 1..20,
          do: Holders.join(c.tables, @vehicle, path("p#{n}", commands: true), {2, 3}, false, c.now)

      assert length(Holders.active(c.tables, @vehicle, c.now)) <= 8
      Routes.forget_system(c.tables, @vehicle, :_, :_)
      Holders.sweep(c.tables)
      assert Holders.active(c.tables, @vehicle, c.now) == []
      assert Holders.standing(c.tables, @vehicle, 1, path("x"), false, c.now) == :free
    end
  end
end
