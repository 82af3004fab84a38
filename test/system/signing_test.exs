defmodule Aerie.System.SigningTest do
  @moduledoc """
  Vehicles that require signatures, as real autopilots do, behind a whole gateway: ground stations that sign, that the gateway
  signs for, and that stay unsigned; keys that are given, changed and revoked; a flood of wrong signatures.
  """

  use Aerie.SystemCase, async: true

  import Aerie.PeerCase, only: [findings: 1, start_peer: 3]

  alias MavRouter.{Client, Router, Signing}
  alias MavCodec.{Frame, Parser}
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @moduletag :capture_log

  @api_key "an-admins-key-of-the-test"
  # A single word, because MAVProxy takes only one.
  @passphrase "a-passphrase-of-the-system-tests"
  @key MavCodec.Signing.key(@passphrase)
  @vehicle {"main", 1}

  setup %{tmp_dir: folder} = context do
    file = private_file(folder, "network.key", @passphrase)

    keys = if context[:keys] == [], do: [], else: [%{"key_file" => file}]
    sockets = short_dir()

    overrides = %{
      "api" => %{"key" => @api_key},
      "signing" => %{"dir" => Path.join(folder, "signing"), "keys" => keys},
      "sockets" => %{"dir" => sockets, "sign" => true}
    }

    run =
      start_gateway(folder,
        links: [context[:link] || "udpin:127.0.0.1:0"],
        stations: ["maintain"],
        overrides: overrides
      )

    gateway = run.gateway
    Aerie.Base.PubSub.subscribe(gateway, :events)

    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"

    sim = Keyword.merge([link: link, key: @key] ++ fast_vehicle(:ardupilot), context[:sim] || [])

    {:ok, sim} = SimVehicle.start_link(sim)
    eventually(fn -> Store.vehicle(gateway, @vehicle) end, "the vehicle is known")
    %{gateway: gateway, sim: sim, socket: Path.join(sockets, "mavlink.sock")}
  end

  defp client(gateway, options) do
    {:ok, id} = MavRouter.Client.add(gateway, Map.merge(%{url: "tcpin:127.0.0.1:0"}, Map.new(options)))
    Enum.find(Client.endpoints(gateway), &(&1.id == id)).port
  end

  defp flown(findings) do
    assert %{"set" => "True", "same" => "True", "arm" => "armed", "land" => "disarmed"} = findings
    assert %{"upload" => "0", "takeoff" => "ten metres"} = findings
  end

  defp state(gateway), do: Signing.vehicle(gateway, @vehicle).state
  defp flight(port), do: ["tcp:127.0.0.1:#{port}", "ardupilot", 1, "PILOT_TKOFF_ALT"]

  # In faster time the vehicle waits less than two seconds for a mission's next item.
  @tag :python
  @tag sim: [speed: 2.0]
  test "pymavlink without a key flies it through a client with sign: true", c do
    port = client(c.gateway, id: "gcs", sign: true)
    refused = SimVehicle.stats(c.sim).refused
    flown(findings(start_peer("pymavlink_gcs.py", flight(port), %{"MAVLINK20" => "1"})))
    assert state(c.gateway) == :verified
    # No frame without a signature reached the vehicle.
    assert SimVehicle.stats(c.sim).refused == refused
    assert Store.counter(c.gateway, {:signing, "link-1", :signed}) > 20
    assert Store.counter(c.gateway, {:signing, "link-1", :rejected}) == 0
  end

  @tag :python
  @tag sim: [speed: 2.0]
  test "frames that pymavlink signs are verified and forwarded unchanged (S10)", c do
    port = client(c.gateway, id: "gcs")

    flown(
      findings(
        start_peer("pymavlink_gcs.py", flight(port), %{
          "MAVLINK20" => "1",
          "SIGNING_KEY" => Base.encode16(@key)
        })
      )
    )

    # The gateway has verified its signatures.
    assert %{state: :verified, rejected: 0} = Signing.vehicle(c.gateway, {"main", 255})
    assert SimVehicle.stats(c.sim).refused == 0
  end

  @tag :mavproxy
  test "MAVProxy with the key, by UDP; its SETUP_SIGNING is not forwarded (S8)", c do
    {:ok, "gcs"} = MavRouter.Client.add(c.gateway, %{url: "udpin:127.0.0.1:0", id: "gcs"})
    port = Enum.find(Client.endpoints(c.gateway), &(&1.id == "gcs")).port
    # The operator types the key at its prompt.
    arguments = ["udpout:127.0.0.1:#{port}", "ardupilot", 1, "PILOT_TKOFF_ALT"]
    findings = findings(start_peer("mavproxy_gcs.py", arguments, %{"SIGNING_PASSPHRASE" => @passphrase}))
    assert %{"arm" => "armed", "land" => "disarmed", "set" => "True"} = findings
    assert %{state: :verified} = Signing.vehicle(c.gateway, {"main", 255})

    secret = fn ->
      for(%{owner: "gcs"} = e <- Router.endpoints(c.gateway), do: e.counters.secret) |> Enum.sum()
    end

    eventually(fn -> secret.() > 0 end, "the order was kept back")
    verified = Signing.vehicle(c.gateway, @vehicle).verified
    eventually(fn -> Signing.vehicle(c.gateway, @vehicle).verified > verified end, "the vehicle has its key")
  end

  test "the gateway signs for a program at mavlink.sock if the configuration says so", c do
    {:ok, socket} = :gen_tcp.connect({:local, c.socket}, 0, [:binary, active: false, packet: 0])
    request = %M.ParamRequestRead{target_system: 1, target_component: 1, param_id: "RTL_ALT", param_index: -1}
    bytes = MavCodec.encode(request, system: 254, component: 190)
    :ok = :gen_tcp.send(socket, [<<byte_size(bytes)::32-little>>, bytes])
    # The parser finds the frames between the lengths.
    await_value(socket, "RTL_ALT")
  end

  test "without sign a client's frames stay unsigned, and the vehicle refuses them; sign can be set at run time",
       c do
    port = client(c.gateway, id: "gcs")
    {:ok, socket} = :gen_tcp.connect(~c"127.0.0.1", port, [:binary, active: false])
    request = %M.ParamRequestRead{target_system: 1, target_component: 1, param_id: "RTL_ALT", param_index: -1}
    bytes = MavCodec.encode(request, system: 255, component: 190)
    refused = SimVehicle.stats(c.sim).refused
    # The first one is for a vehicle that this client has not heard yet, but the gateway has.
    :ok = :gen_tcp.send(socket, bytes)
    eventually(fn -> SimVehicle.stats(c.sim).refused > refused end, "the vehicle refuses it")
    assert Store.counter(c.gateway, {:signing, "gcs", :rejected}) > 0

    :ok = Router.configure(c.gateway, "gcs", sign: true)
    :ok = :gen_tcp.send(socket, bytes)
    await_value(socket, "RTL_ALT")
    # The gateway never signs for a sender on a link.
    assert {:error, error} = Router.configure(c.gateway, "link-1", sign: true)
    assert Exception.message(error) =~ "only a client"
  end

  # Waits for the parameter that was asked for. The gateway asks for others, whose answers everybody hears.
  defp await_value(socket, name, parser \\ Parser.new()) do
    {:ok, bytes} = :gen_tcp.recv(socket, 0, Aerie.Patience.ms())
    {frames, parser} = Parser.push(parser, bytes)

    names =
      for %{id: id} = frame <- frames, id == M.ParamValue.id() do
        assert Frame.signed?(frame)
        {:ok, %{param_id: name}} = MavCodec.decode(frame)
        name
      end

    if name not in names, do: await_value(socket, name, parser)
  end

  @tag keys: [], link: "udpin:127.0.0.1:0?secure=true", sim: [key: nil]
  test "a key is given, changed, restored and revoked; each step is an event, and no event contains a key",
       c do
    conn = nats_client(c.gateway)
    assert {:error, %Aerie.Base.Error{} = error} = Aerie.Vehicle.Enrolment.enrol(c.gateway, "VID-001")
    assert Exception.message(error) =~ "key: :generate"

    # Longer than the ten seconds that an operator waits.
    patient = [timeout_ms: Aerie.Patience.ms()]

    assert {:ok, %{key: first}} =
             Aerie.Vehicle.Enrolment.enrol(c.gateway, "VID-001", [key: :generate, by: "a test"] ++ patient)

    assert state(c.gateway) == :verified
    assert_receive {:fleet, :events, %{type: "signing.enrolled", data: %{"by" => "a test"}}}

    # The vehicle answers the gateway's requests, so it accepts its signatures.
    eventually(fn -> Store.vehicle(c.gateway, @vehicle).clock.samples > 0 end, "it answers")

    assert {:ok, %{key: second}} =
             Aerie.Vehicle.Enrolment.enrol(c.gateway, "VID-001", [key: :generate] ++ patient)

    refute MavRouter.Signing.Key.same?(first, second)

    assert {:ok, %{key: nil}} =
             Aerie.Vehicle.Enrolment.enrol(c.gateway, "VID-001", [key: :previous] ++ patient)

    assert state(c.gateway) == :verified
    # The same by HTTP, without any key in it.
    assert {200, %{"result" => "enrolled", "link" => "link-1"}} =
             post(c.gateway, %{"action" => "enrol", "key" => "generate"})

    assert {422, %{"error" => %{"message" => text}}} =
             post(c.gateway, %{"action" => "enrol", "key" => "0123"})

    assert text =~ "configured, generate, previous"
    assert {:ok, _} = Aerie.Vehicle.Enrolment.revoke(c.gateway, "VID-001", patient)
    assert Signing.list(c.gateway).keys == []

    events =
      eventually(
        fn ->
          events = for %{"type" => "signing." <> _} = event <- stream_events(conn), do: event
          length(events) == 5 && events
        end,
        "all are in NATS"
      )

    assert Enum.map(events, & &1["type"]) == List.duplicate("signing.enrolled", 4) ++ ["signing.revoked"]
    assert Enum.at(events, 3)["data"]["by"] == "http:api.key"

    for secret <- [first, second] do
      key = Aerie.Base.Secret.reveal(secret)
      refute inspect(events) =~ Base.encode16(key, case: :lower)
      refute inspect(events, limit: :infinity) =~ inspect(key)
    end
  end

  defp post(gateway, body), do: rest(gateway, :post, "vehicles/VID-001/signing", body, key: @api_key)

  test "S8: nothing is sent over a link that is not secure, and the error says what to do", c do
    assert {:error, %Aerie.Base.Error{} = error} = Aerie.Vehicle.Enrolment.enrol(c.gateway, {"main", 1})
    assert Exception.message(error) =~ "secure"

    assert {:error, %Aerie.Base.Error{} = error} =
             Aerie.Vehicle.Enrolment.enrol(c.gateway, {"main", 1}, link: "link-1")

    assert Exception.message(error) =~ "secure=true"

    assert {:error, %{reason: {:unknown, :vehicle, "VID-077"}}} =
             Aerie.Vehicle.Enrolment.enrol(c.gateway, "VID-077")
  end

  test "one event for a flood of wrong signatures, in the snapshot, the metrics and NATS; the vehicle is not disturbed",
       c do
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}])
    port = link_port(c.gateway, "link-1")
    forger = MavCodec.Signing.new(MavCodec.Signing.key("another"))

    read = fn -> MavRouter.Link.snapshot(c.gateway, "link-1").counters.bytes_in end

    # No more at once than a link that does not keep up would read.
    for part <- Enum.chunk_every(1..1_200, 50), reduce: forger do
      forger ->
        before = read.()

        {sent, forger} =
          Enum.reduce(part, {0, forger}, fn n, {sent, forger} ->
            heartbeat =
              MavCodec.encode(%M.Heartbeat{type: 2, autopilot: 3, base_mode: 209},
                system: 1,
                seq: rem(n, 256)
              )

            {bytes, forger} = MavCodec.Signing.sign(forger, heartbeat, 50)
            :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, bytes)
            {sent + byte_size(bytes), forger}
          end)

        eventually(fn -> read.() >= before + sent end, "they are read")
        forger
    end

    assert_receive {:fleet, :events, %{type: "signing.rejected", data: data}}
    assert %{"link" => "link-1", "reasons" => %{"wrong_signature" => n}} = data
    assert n >= 20

    eventually(
      fn -> Store.counter(c.gateway, {:signing, "link-1", :rejected}) > 1_000 end,
      "they are counted"
    )

    refute_received {:fleet, :events, %{type: "signing.rejected"}}

    eventually(
      fn -> MavRouter.Link.get(c.gateway, "link-1").signing.alarms == 1 end,
      "it is in the link's snapshot"
    )

    assert %{state: :verified, rejected: rejected} = Store.vehicle(c.gateway, @vehicle).signing
    assert rejected >= 0
    assert Store.vehicle(c.gateway, @vehicle).groups.mode.data.armed == false

    metrics =
      Aerie.Api.Metrics.families(c.gateway) |> Aerie.Api.Metrics.Text.render() |> IO.iodata_to_binary()

    assert metrics =~ ~s(gateway_link_signing_alarms_total{link="link-1",network="main"} 1)
    assert metrics =~ ~s(gateway_vehicle_signed{vehicle="VID-001"} 1)

    conn = nats_client(c.gateway)
    rejected = fn -> Enum.filter(stream_events(conn), &(&1["type"] == "signing.rejected")) end

    assert [%{"data" => %{"component" => 1}}] =
             eventually(fn -> (e = rejected.()) != [] && e end, "it is in NATS")
  end
end
