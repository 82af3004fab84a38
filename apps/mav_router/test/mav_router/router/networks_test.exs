defmodule MavRouter.Router.NetworksTest do
  @moduledoc "Networks that have the same system ids."
  use Aerie.EndpointCase, async: true

  describe "networks" do
    setup c do
      red = vehicle(c.gateway, "red", 1, networks: ["red"])
      blue = vehicle(c.gateway, "blue", 1, networks: ["blue"])
      two = vehicle(c.gateway, "two", 2, networks: ["blue"])
      {:ok, red: red, blue: blue, two: two, all: [red, blue, two]}
    end

    test "never meet: the same ids are other vehicles", c do
      r = client(c.gateway, "r", 255, networks: ["red"])
      b = client(c.gateway, "b", 255, networks: ["blue"])
      all = [r, b | c.all]
      got(all)
      say(c.red, attitude(1, 1))
      first = attitude(1, 1)
      assert %{"r" => [^first], "b" => [], "blue" => [], "two" => []} = got(all)
      order = message(command(1), 255, 190)
      say(b, order)
      assert %{"blue" => [^order], "red" => [], "r" => []} = got(all)
    end

    test "a client of several networks gets one system of each id, of the network named first; the others are listed as hidden",
         c do
      g = client(c.gateway, "g", 255, networks: ["red", "blue"])
      all = [g | c.all]
      got(all)
      first = attitude(1, 1)
      other = attitude(2, 1)
      say(c.red, first)
      say(c.blue, attitude(1, 2))
      say(c.two, other)
      assert %{"g" => [^first, ^other]} = got(all)
      assert %{hidden: [{"blue", 1}]} = counted(c.gateway, "g")
      orders = for id <- [1, 2], do: message(command(id), 255, 190)
      say(g, orders)
      [one, two] = orders
      assert %{"red" => [^one], "blue" => [], "two" => [^two]} = got(all)
      answer = message(%Messages.CommandAck{command: 400, target_system: 255, target_component: 190}, 2, 1)
      say(c.two, answer)
      assert %{"g" => [^answer]} = got(g)
    end

    test "a client that names no network sees all, later ones included, and a later one hides no system", c do
      g = client(c.gateway, "g", 255)
      assert %{networks: ["main", "red", "blue"]} = counted(c.gateway, "g")
      # By name it would come before the others.
      late = [
        vehicle(c.gateway, "late", 1, networks: ["amber"]),
        vehicle(c.gateway, "three", 3, networks: ["amber"])
      ]

      all = [g | late] ++ c.all
      assert %{networks: ["main", "red", "blue", "amber"], hidden: hidden} = counted(c.gateway, "g")
      assert Enum.sort(hidden) == [{"amber", 1}, {"blue", 1}]
      got(all)
      [red, three] = for id <- [1, 3], do: attitude(id, 1)
      say(c.red, red)
      say(hd(late), attitude(1, 2))
      say(List.last(late), three)
      assert %{"g" => [^red, ^three]} = got(all)

      # Both ways, although it said nothing since.
      order = message(command(3), 255, 190)
      say(g, order)
      answer = message(%Messages.CommandAck{command: 400, target_system: 255, target_component: 190}, 3, 1)
      say(List.last(late), answer)
      assert %{"g" => [^answer], "three" => [^order], "late" => []} = got(all)

      for endpoint <- late, do: stop_supervised!(endpoint.name)
      eventually(fn -> counted(c.gateway, "g").networks == ["main", "red", "blue"] end)
    end
  end

  describe "a client that sees the ids of a network with a number added" do
    setup c do
      red = vehicle(c.gateway, "red", 1, networks: ["red"])
      blue = vehicle(c.gateway, "blue", 1, networks: ["blue"])
      offsets = %{"blue" => 10}
      g = client(c.gateway, "g", 255, networks: ["red", "blue"], id_offsets: offsets)
      plain = client(c.gateway, "plain", 254, networks: ["blue"])
      all = [red, blue, g, plain]
      got(all)
      {:ok, red: red, blue: blue, g: g, plain: plain, all: all}
    end

    test "sees both vehicles with one id; other clients get unchanged frames (R3)", c do
      mine = attitude(1, 1)
      theirs = attitude(1, 2)
      say(c.red, mine)
      say(c.blue, theirs)

      shown =
        MavCodec.encode(%Messages.Attitude{time_boot_ms: 2, roll: 0.5, yaw: 1.0},
          system: 11,
          component: 1,
          seq: 2
        )

      assert %{"g" => [^mine, ^shown], "plain" => [^theirs], "red" => [], "blue" => []} = got(c.all)
      assert %{hidden: [], id_offsets: %{"blue" => 10}} = counted(c.gateway, "g")
    end

    test "reaches the vehicle that it means, and gets its answer under the id that it sees", c do
      say(c.g, message(command(11), 255, 190))
      order = message(command(1), 255, 190)
      assert %{"blue" => [^order], "red" => []} = got(c.all)
      say(c.g, order)
      assert %{"blue" => [], "red" => [^order]} = got(c.all)
      ack = %Messages.CommandAck{command: 400, target_system: 255, target_component: 190}
      say(c.blue, message(ack, 1, 1))
      shown = message(ack, 11, 1)
      assert %{"g" => [^shown], "plain" => []} = got(c.all)
      # Nobody is meant by it.
      say(c.g, message(command(12), 255, 190))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
      assert counted(c.gateway, "g").counters.no_route == 1
      # What is for all is for all.
      everyone = message(command(0, 0), 255, 190)
      say(c.g, everyone)
      assert %{"blue" => [^everyone], "red" => [^everyone]} = got(c.all)
    end

    test "signed frames are not changed but refused, and counted; those of other networks pass (S10)", c do
      signing = MavCodec.Signing.new(:binary.copy(<<7>>, 32), link_id: 3)
      {signed, _} = MavCodec.Signing.encode(signing, %Messages.Attitude{roll: 0.5}, system: 1, component: 1)
      say(c.blue, signed)
      assert %{"g" => [], "plain" => [^signed]} = got(c.all)
      assert counted(c.gateway, "g").counters.refused == 1
      say(c.red, signed)
      assert %{"g" => [^signed]} = got(c.all)
      {order, _} = MavCodec.Signing.encode(signing, command(11), system: 255, component: 190)
      say(c.g, order)
      assert %{"blue" => [], "red" => []} = got(c.all)
      assert counted(c.gateway, "g").counters.refused == 2
    end

    test "filters and rate limits use the ids that it sees, and two vehicles with one id have separate rates",
         c do
      :ok =
        Router.configure(c.gateway, "g",
          rate_limits: %{"ATTITUDE" => 0.001},
          filter_out: %{block_systems: [12]}
        )

      for n <- 1..3, e <- [c.red, c.blue], do: say(e, attitude(1, n))
      assert %{"g" => [_, _]} = got(c.g)
      two = vehicle(c.gateway, "two", 2, networks: ["blue"])
      say(two, attitude(2, 1))
      assert %{"g" => []} = got(c.g)
    end

    test "networks and links that do not exist are refused; a link may be the first of a network", c do
      why = ~s(unknown network "green"; known: blue, main, red)

      assert {:error, %{reason: {:invalid, ^why}}} =
               Router.configure(c.gateway, "g", networks: ["red", "green"])

      assert Router.changes(c.gateway) == %{}
      :ok = Router.configure(c.gateway, "blue", networks: ["blue", "green"])
      :ok = Router.configure(c.gateway, "g", networks: ["red", "green"])
      :ok = Router.known_networks(c.gateway, ["green", "main"])

      assert {:error, %{reason: {:invalid, ~s(carry: unknown link "lte")}}} =
               Router.configure(c.gateway, "blue", carry: %{"bulk" => "lte", "control" => "red"})

      :ok = Router.configure(c.gateway, "blue", carry: %{"bulk" => "all", "control" => "red"})
      assert {:error, %{reason: {:unavailable, _why}}} = Router.known_networks(make_ref(), ["main"])
    end

    test "offsets can be changed at run time; an id that two networks have is still hidden", c do
      :ok = Router.configure(c.gateway, "g", id_offsets: nil)
      assert %{hidden: [{"blue", 1}], id_offsets: %{}} = counted(c.gateway, "g")
      say(c.blue, attitude(1, 1))
      assert %{"g" => []} = got(c.g)
      eleven = vehicle(c.gateway, "eleven", 11, networks: ["red"])
      :ok = Router.configure(c.gateway, "g", id_offsets: %{"blue" => 10})
      assert %{hidden: [{"blue", 1}]} = counted(c.gateway, "g")
      got([eleven | c.all])
      say(c.blue, attitude(1, 2))
      assert %{"g" => []} = got(c.g)
      assert {:error, _} = Router.configure(c.gateway, "g", id_offsets: %{"blue" => 300})
    end
  end
end
