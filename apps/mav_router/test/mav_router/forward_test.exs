defmodule MavRouter.ForwardTest do
  @moduledoc "The rules of MAVLink routing, by name."
  use Aerie.EndpointCase, async: true

  test "frames of an endpoint that has ended go nowhere and start no vehicle", c do
    gone = endpoint(c.gateway, "gone", [])
    :ok = LocalEndpoint.detach(gone.endpoint)
    # Like a vehicle's heartbeat, which a client may well send (a simulator behind it).
    assert %{unclaimed: 1, delivered: 0} = say(gone, heartbeat(9))
    assert Router.systems(c.gateway) == %{}
    assert Aerie.Base.Store.vehicles(c.gateway) == []
  end

  describe "rules" do
    setup c do
      v1 = vehicle(c.gateway, "v1", 1)
      v2 = vehicle(c.gateway, "v2", 2)
      g1 = client(c.gateway, "g1", 255)
      g2 = client(c.gateway, "g2", 254)
      all = [v1, v2, g1, g2]
      got(all)
      {:ok, v1: v1, v2: v2, g1: g1, g2: g2, all: all}
    end

    test "R1, R2: a client's frame with target 0 goes to everyone but the sender, telemetry to clients, with the same bytes (R3)",
         c do
      bytes = attitude(1, 7)
      say(c.v1, bytes)
      assert got(c.all) == %{"v1" => [], "v2" => [], "g1" => [bytes], "g2" => [bytes]}
      to_all = message(command(0, 0), 255, 190)
      say(c.g1, to_all)
      assert got(c.all) == %{"v1" => [to_all], "v2" => [to_all], "g1" => [], "g2" => [to_all]}
    end

    test "R1: only the target system gets a frame", c do
      order = message(command(2), 255, 190)
      say(c.g1, order)
      assert got(c.all) == %{"v1" => [], "v2" => [order], "g1" => [], "g2" => []}
      answer = message(%Messages.CommandAck{command: 400, target_system: 255, target_component: 190}, 2, 1)
      say(c.v2, answer)
      assert got(c.all) == %{"v1" => [], "v2" => [], "g1" => [answer], "g2" => []}
    end

    test "R2: a frame for an unknown target goes nowhere, and is counted", c do
      say(c.g1, message(command(77), 255, 190))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
      assert counted(c.gateway, "g1").counters.no_route == 1
    end

    test "R2: a frame never goes back to the endpoint of its sender", c do
      say(c.v1, heartbeat(1, type: 26, autopilot: 8, component: 154))
      got(c.all)
      say(c.v1, message(command(1, 154), 1, 1))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
    end

    test "R1: a target component is reached where it was heard; R9: one that never talks, where its system was",
         c do
      camera = endpoint(c.gateway, "camera", side: :vehicle)
      say(camera, heartbeat(1, type: 30, autopilot: 8, component: 100))
      got([camera | c.all])
      shoot = message(command(1, 100), 255, 190)
      say(c.g1, shoot)
      assert %{"camera" => [^shoot], "v1" => []} = got([camera | c.all])
      log = message(command(1, 155), 255, 190)
      say(c.g1, log)
      assert %{"camera" => [^log], "v1" => [^log]} = got([camera | c.all])
    end

    test "R4: an unknown message goes to every client, and to no vehicle", c do
      unknown = <<0xFD, 3, 0, 0, 1, 1, 1, 0xABCDEF::24-little, 1, 1, 5, 9, 9>>
      say(c.v1, unknown)
      assert got(c.all) == %{"v1" => [], "v2" => [], "g1" => [unknown], "g2" => [unknown]}
      unknown = <<0xFD, 3, 0, 0, 1, 255, 190, 0xABCDEF::24-little, 1, 1, 5, 9, 9>>
      say(c.g1, unknown)
      assert got(c.all) == %{"v1" => [], "v2" => [], "g1" => [], "g2" => [unknown]}
      assert counted(c.gateway, "g1").counters.withheld == 1
    end

    test "F10: a target that was cut off is everyone", c do
      # Every byte of it is zero, so that only one is sent.
      cut = message(%Messages.ParamRequestList{}, 255, 190)
      assert <<0xFD, 1, _::binary>> = cut
      say(c.g1, cut)
      assert %{"v1" => [^cut], "v2" => [^cut], "g2" => [^cut]} = got(c.all)
    end

    test "S8: SETUP_SIGNING goes nowhere, not even to a sniffer", c do
      sniffer = endpoint(c.gateway, "sniffer", sniffer: true)
      say(c.g1, message(%Messages.SetupSigning{target_system: 1, target_component: 1}, 255, 190))
      assert got([sniffer | c.all]) |> Map.values() |> Enum.concat() == []
      assert counted(c.gateway, "g1").counters.secret == 1
    end

    test "S9: the passwords of a client reach vehicles and nobody else, whatever the message", c do
      sniffer = endpoint(c.gateway, "sniffer", sniffer: true)
      stranger = endpoint(c.gateway, "stranger", side: :vehicle)
      others = [sniffer, stranger | c.all]
      got(others)

      for %{message: message, target: target} <- secrets(2), bytes = message(message, 255, 190) do
        say(c.g1, bytes)
        reached = for {name, [_ | _] = frames} <- got(others), do: {name, frames}

        cond do
          target ->
            assert(reached == [{"v2", [bytes]}])

          MavCodec.Meaning.Messages.order?(message.__struct__.id()) ->
            assert(reached == [{"v1", [bytes]}, {"v2", [bytes]}])

          # A vehicle's answer.
          true ->
            assert(reached == [])
        end
      end

      # An id that another client has said it has.
      say(c.g2, heartbeat(9, type: 6, autopilot: 8, component: 190))
      got(others)
      say(c.g1, message(%Messages.ChangeOperatorControl{target_system: 9, passkey: "hunter22"}, 255, 190))
      assert got(others) |> Map.values() |> Enum.concat() == []
    end

    test "S9: clients and sniffers get what a vehicle says without its passwords, and other vehicles nothing",
         c do
      sniffer = endpoint(c.gateway, "sniffer", sniffer: true)
      others = [sniffer | c.all]
      got(others)

      for %{message: message} <- secrets(255) do
        bytes = message(message, 1, 1)
        say(c.v1, bytes)
        reached = for {name, [_ | _] = frames} <- got(others), do: {name, frames}
        assert [{"g1", [copy]} | _more] = reached
        assert Enum.all?(reached, fn {name, frames} -> name in ~w(g1 g2 sniffer) and frames == [copy] end)
        assert :binary.match(copy, "hunter22") == :nomatch
        assert {:ok, %_same{}} = copy |> MavCodec.Frame.from_bytes(nil) |> MavCodec.decode()
      end
    end

    defp secrets(target) do
      for %module{} = message <- MavCodec.SecretSamples.all(),
          module != Messages.SetupSigning,
          kept?(message) do
        target? = is_map_key(message, :target_system)
        %{message: if(target?, do: %{message | target_system: target}, else: message), target: target?}
      end
    end

    defp kept?(message),
      do: message |> message(1, 1) |> MavCodec.Frame.from_bytes(nil) |> MavCodec.Signing.Redact.kept?()

    test "S10: a signed frame is forwarded unchanged, rightly signed or not", c do
      signing = MavCodec.Signing.new(:binary.copy(<<7>>, 32), link_id: 3)

      {signed, _signing} =
        MavCodec.Signing.encode(signing, %Messages.Attitude{roll: 0.5}, system: 1, component: 1)

      forged = binary_part(signed, 0, byte_size(signed) - 1) <> <<0>>

      for bytes <- [signed, forged] do
        say(c.v1, bytes)
        assert %{"g1" => [^bytes]} = got(c.all)
      end
    end

    test "a sniffer also gets frames for others", c do
      sniffer = endpoint(c.gateway, "sniffer", sniffer: true)
      order = message(command(2), 255, 190)
      say(c.g1, order)
      assert %{"sniffer" => [^order], "v1" => [], "v2" => [^order]} = got([sniffer | c.all])
    end

    test "our own frames that come back go nowhere", c do
      assert %{looped: 1} = say(c.g1, heartbeat(245, component: 191, type: 18, autopilot: 8))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
    end

    test "R5: a frame for the gateway itself goes no further and is not counted as no_route", c do
      say(c.g1, message(command(245, 191), 255, 190))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
      assert counted(c.gateway, "g1").counters.no_route == 0
      # Another part of our system is somebody else.
      say(c.g1, message(command(245, 7), 255, 190))
      assert counted(c.gateway, "g1").counters.no_route == 1
    end

    test "commands of an autopilot to itself go to no other vehicle (PX4: to 1/0 and 0/0, four times)", c do
      for _ <- 1..4, target <- [0, 1], do: say(c.v1, message(command(target, 0, 20), 1, 1))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
      # Its own camera elsewhere gets it.
      camera = endpoint(c.gateway, "camera", side: :vehicle)
      say(camera, heartbeat(1, type: 30, autopilot: 8, component: 100))
      got([camera | c.all])
      own = message(command(0, 0, 1000), 1, 1)
      say(c.v1, own)
      assert %{"camera" => [^own], "v2" => [], "g1" => []} = got([camera | c.all])
    end

    test "frames of a read-only endpoint go nowhere", c do
      reader = client(c.gateway, "reader", 200, role: :read_only)
      say(reader, message(command(1), 200, 190))
      assert %{"v1" => [], "g1" => []} = got(c.all)
      assert counted(c.gateway, "reader").counters.read_only == 2
      bytes = attitude(1, 1)
      say(c.v1, bytes)
      assert %{"reader" => [^bytes]} = got(reader)
    end

    test "an endpoint that is gone is removed with its routes", c do
      Process.exit(c.g1.pid, :kill)
      # First the endpoint goes, then its routes.
      eventually(fn -> Router.route(c.gateway, {"main", 255}) == nil end)
      assert counted(c.gateway, "g1") == nil
      say(c.v1, attitude(1, 1))
      assert %{"g2" => [_]} = got(c.g2)
    end

    test "frames for everyone and frames for one stay in order", c do
      ack = message(%Messages.CommandAck{command: 400, target_system: 255, target_component: 190}, 1, 1)
      all = [attitude(1, 1), attitude(1, 2), ack, attitude(1, 3)]
      say(c.v1, all)
      assert %{"g1" => ^all} = got(c.all)
    end

    test "R6: a boot time that starts over clears the routes that the same endpoint taught, and no others",
         c do
      time = fn ms ->
        message(%Messages.SystemTime{time_boot_ms: ms, time_unix_usec: 1_000_000_000_000_000}, 1, 1)
      end

      other = endpoint(c.gateway, "camera", side: :vehicle)

      for {endpoint, part} <- [{c.v1, 77}, {other, 78}],
          do: say(endpoint, heartbeat(1, component: part, type: 30, autopilot: 8))

      # The clock is sure after three readings over a second; all of them by one process, as those of a link are.
      at = fn ms, us -> Enum.map(parse(time.(ms)), &%{&1 | at: us}) end
      deliver(c.gateway, "v1", at.(500_000, 0))

      parts = fn ->
        for %{system: 1, component: part} when part in 77..78 <- Router.routes(c.gateway), do: part
      end

      assert Enum.sort(parts.()) == [77, 78]
      for n <- 0..4, do: deliver(c.gateway, "v1", at.(1_000 + n * 500, n * 500_000))
      assert parts.() == [78]
      assert Router.route(c.gateway, {"main", 1}) == {"v1", :self}
    end
  end
end
