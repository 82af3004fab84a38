defmodule MavRouter.ClientTest do
  use ExUnit.Case, async: true

  import Aerie.LinkCase, only: [eventually: 1, start_parts: 0]

  alias Aerie.Base.Error
  alias MavRouter.Client
  alias MavRouter.Client.LocalEndpoint

  test "an endpoint for clients is a link of the clients' side, with its networks and access" do
    gateway = start_parts()

    {:ok, "field"} =
      Client.add(gateway, "udpin:127.0.0.1:0", id: "field", networks: ["field"], role: :read_only)

    assert [%{id: "field", kind: :udp_server}] = Client.endpoints(gateway)
    port = fn -> gateway |> Client.endpoints() |> hd() |> Map.get(:port) end
    {:ok, gcs} = :gen_udp.open(0, [:binary, active: false])

    :ok =
      :gen_udp.send(
        gcs,
        {127, 0, 0, 1},
        port.(),
        Aerie.LinkCase.heartbeat(255, type: 6, autopilot: 8)
      )

    assert [client] = eventually(fn -> with [] <- Client.list(gateway), do: nil end)
    assert %{owner: "field", side: :client, networks: ["field"], role: :read_only} = client
    assert :ok = Client.remove(gateway, "field")
    assert Client.endpoints(gateway) == []
    assert {:error, %Error{reason: {:unknown, :client, "field"}}} = Client.remove(gateway, "field")
  end

  test "a client that names no networks sees a link of a network that is added later" do
    gateway = start_parts()
    {:ok, _id} = Client.add(gateway, "udpin:127.0.0.1:0", id: "gcs")
    {:ok, gcs} = :gen_udp.open(0, [:binary, active: true])
    [%{port: port}] = Client.endpoints(gateway)
    :ok = :gen_udp.send(gcs, {127, 0, 0, 1}, port, Aerie.LinkCase.heartbeat(255, type: 6, autopilot: 8))
    eventually(fn -> match?([%{networks: ["main"]}], Client.list(gateway)) end)

    {:ok, _id} = MavRouter.Link.start(gateway, "udpin:127.0.0.1:0?network=late", id: "radio")
    {:ok, vehicle} = :gen_udp.open(0, [:binary, active: false])

    %{port: port} =
      eventually(fn -> with %{port: nil} <- MavRouter.Link.snapshot(gateway, "radio"), do: nil end)

    beat = Aerie.LinkCase.heartbeat(7)
    :ok = :gen_udp.send(vehicle, {127, 0, 0, 1}, port, beat)
    assert_receive {:udp, ^gcs, _address, _port, ^beat}
    assert [%{networks: ["main", "late"]}] = Client.list(gateway)
  end

  describe "frames that a vehicle packs in one datagram" do
    setup do
      gateway = start_parts()
      {:ok, _id} = MavRouter.Link.start(gateway, "udpin:127.0.0.1:0", id: "radio")
      {:ok, gcs} = :gen_udp.open(0, [:binary, active: true])
      {:ok, gateway: gateway, gcs: gcs, radio: MavRouter.Link.snapshot(gateway, "radio").port}
    end

    # 20 frames in one datagram, and what comes of them: [datagram].
    defp packed(c, rules) do
      {:ok, port} = :inet.port(c.gcs)
      {:ok, id} = MavRouter.Client.add(c.gateway, Map.put(rules, :url, "udpout:127.0.0.1:#{port}"))
      eventually(fn -> match?([_there], MavRouter.Router.endpoints(c.gateway)) end)
      frames = for n <- 1..20, do: Aerie.LinkCase.attitude(7, n)
      {:ok, vehicle} = :gen_udp.open(0, [:binary, active: false])
      :ok = :gen_udp.send(vehicle, {127, 0, 0, 1}, c.radio, frames)
      {frames, collect(c.gcs, IO.iodata_length(frames), []), id}
    end

    defp collect(_gcs, left, got) when left <= 0, do: Enum.reverse(got)

    defp collect(gcs, left, got) do
      assert_receive {:udp, ^gcs, _address, _port, bytes}
      collect(gcs, left - byte_size(bytes), [bytes | got])
    end

    test "go out one each: there are routers that read the first one only", c do
      {frames, got, _id} = packed(c, %{})
      assert got == frames
    end

    test "so too with a budget, where `coalesce` is off", c do
      {frames, got, _id} = packed(c, %{bytes_per_s: 100_000, coalesce: false})
      assert got == frames
    end

    test "and with a budget share one when they have to wait, no larger than what mavlink-router reads", c do
      {frames, got, _id} = packed(c, %{bytes_per_s: 100_000})
      assert IO.iodata_to_binary(got) == IO.iodata_to_binary(frames)
      assert length(got) < 20 and Enum.all?(got, &(byte_size(&1) <= 1_024))
    end
  end

  test "what is not an endpoint for clients is refused in words" do
    gateway = start_parts()
    assert {:error, %Error{reason: {:invalid, words}}} = Client.add(gateway, "replay:/tmp/x.tlog")
    assert words =~ "not a client"
    assert {:error, %Error{reason: {:invalid, words}}} = Client.add(gateway, "tcp:nowhere")
    assert words =~ "port"
    {:ok, _id} = Client.add(gateway, "udpin:127.0.0.1:0", id: "a")
    process = Aerie.Base.Names.whereis(gateway, :link, "a")

    assert {:error, %Error{reason: {:exists, :client, "a"}}} =
             Client.add(gateway, "udpin:127.0.0.1:0", id: "a")

    # The one that was there is not disturbed.
    assert process == Aerie.Base.Names.whereis(gateway, :link, "a")
    {:ok, _id} = MavRouter.Link.start(gateway, "udpin:127.0.0.1:0", id: "radio")
    assert {:error, %{reason: {:conflict, _text}}} = Client.remove(gateway, "radio")
  end

  test "a client's process is ended by its id" do
    gateway = start_parts()
    :ok = Aerie.Base.Names.register(gateway, :websocket_client, "ws-1")
    {:ok, _endpoint} = LocalEndpoint.attach(gateway, id: "ws-1", kind: :websocket)
    assert [_one] = Aerie.Base.Names.processes(gateway, :websocket_client)
    assert :ok = Client.remove(gateway, "ws-1")
    assert_receive :disconnect
  end
end
