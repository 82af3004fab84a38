defmodule Aerie.System.TwoGatewaysTest do
  @moduledoc """
  Two gateways on one nats-server hear the same simulated vehicle: one holds it, and the other passes commands on. What reaches the
  vehicle is counted on its only wire.
  """
  use Aerie.SystemCase, async: true

  alias Aerie.{BridgeCase, HubServer}
  alias Aerie.Control.Commands
  alias Aerie.Fleet.{Bridge, Remote}
  alias Aerie.Control.Policy.Roles.Signature

  @moduletag :tmp_dir
  @moduletag :capture_log
  @vehicle "VID-001"
  @set_mode 176
  @lease_s 2

  setup %{tmp_dir: folder} = context do
    nkey = Nkey.generate(:user)
    seed = private_file(folder, "gateways.nk", Nkey.seed(nkey))
    server = HubServer.start(folder, [])
    record_s = context[:record_s] || 60.0
    [a, b] = for name <- ["a", "b"], do: gateway(Path.join(folder, name), record_s, server, seed, nkey.public)
    ports = for %{gateway: gateway} <- [a, b], do: link_port(gateway, "link-1")
    wire = wire(ports)

    sim =
      start_supervised!({SimVehicle, [link: "udpout:127.0.0.1:#{port(wire)}"] ++ fast_vehicle(:ardupilot)})

    SimVehicle.await(sim, & &1.ready)
    for %{gateway: gateway} <- [a, b], do: await_standing(gateway)
    {holder, other} = held(a, b)
    %{server: server, wire: wire, sim: sim, holder: holder, other: other, nkey: nkey}
  end

  defp gateway(dir, record_s, server, seed, public) do
    start_gateway(dir,
      links: ["udpin:127.0.0.1:0"],
      overrides: %{
        "vehicles" => [%{"system_id" => 1, "id" => @vehicle}],
        "nats" => %{
          "url" => "tls://127.0.0.1:#{server.ports.client}",
          "nkey_seed_file" => Path.join(server.set, "hub/gateway.nk"),
          "tls" => %{"ca_file" => Path.join(server.set, "ca.pem")},
          "retry_max_ms" => 500
        },
        "timeouts" => patient(),
        "remote" => %{"nkey_seed_file" => seed},
        "commands" => %{"ledger" => %{"dir" => Path.join(dir, "ledger")}, "record_s" => record_s},
        "shadow" => %{
          "dir" => Path.join(dir, "shadow"),
          "lease_s" => @lease_s,
          "key" => "the key of both gateways"
        },
        "policy" => %{
          "sources" => [%{"name" => "gateways", "nkey" => public, "role" => "admin"}]
        }
      }
    )
  end

  # One holds it and listens, the other one knows. Both are connected.
  defp held(a, b) do
    {holder, other} =
      eventually(
        fn ->
          case {holder(a), holder(b)} do
            {{:mine, _until}, {:other, _name}} -> {a, b}
            {{:other, _name}, {:mine, _until}} -> {b, a}
            _not_yet -> nil
          end
        end,
        fn -> "one holds it: #{inspect({holder(a), holder(b)})}" end
      )

    for %{gateway: gateway} <- [a, b],
        do: eventually(fn -> Bridge.connection(gateway) != nil end, "it is connected")

    BridgeCase.await_listening(holder.gateway, [@vehicle])
    BridgeCase.await_listening(other.gateway, [])
    {holder, other}
  end

  defp holder(%{gateway: gateway}), do: Remote.holder(gateway, @vehicle)

  # Between the vehicle and both gateways. It keeps the commands that pass to the vehicle.
  defp wire(ports) do
    start_supervised!(
      {Agent,
       fn ->
         {:ok, near} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}, active: false])
         fars = for port <- ports, do: {port, open()}
         counts = :ets.new(:counts, [:public, :duplicate_bag])
         {:ok, sim} = Agent.start_link(fn -> nil end)
         spawn_link(fn -> from_vehicle(near, fars, sim) end)
         for {_port, far} <- fars, do: spawn_link(fn -> to_vehicle(far, near, sim, counts) end)
         {:ok, port} = :inet.port(near)
         %{port: port, counts: counts}
       end},
      id: :wire
    )
  end

  defp open do
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    socket
  end

  defp port(wire), do: Agent.get(wire, & &1.port)

  defp from_vehicle(near, fars, sim) do
    with {:ok, {_ip, port, bytes}} <- :gen_udp.recv(near, 0) do
      Agent.update(sim, fn _before -> port end)
      for {to, far} <- fars, do: :gen_udp.send(far, {127, 0, 0, 1}, to, bytes)
      from_vehicle(near, fars, sim)
    end
  end

  defp to_vehicle(far, near, sim, counts) do
    with {:ok, {_ip, _port, bytes}} <- :gen_udp.recv(far, 0) do
      for {command, confirmation} <- commands(bytes),
          do: :ets.insert(counts, {command, confirmation, make_ref()})

      if port = Agent.get(sim, & &1), do: :gen_udp.send(near, {127, 0, 0, 1}, port, bytes)
      to_vehicle(far, near, sim, counts)
    end
  end

  # The COMMAND_LONG in a datagram of MAVLink 2 frames: their commands and confirmations. Zeros at the end are not sent.
  defp commands(<<0xFD, length, flags, _::binary-size(4), id::little-24, rest::binary>>) do
    signature = if Bitwise.band(flags, 1) == 1, do: 13, else: 0
    <<payload::binary-size(^length), _crc::16, _sign::binary-size(^signature), rest::binary>> = rest

    case {id, payload} do
      {76, <<_params::binary-size(28), command::little-16, _to::16, confirmation, _::binary>>} ->
        [{command, confirmation} | commands(rest)]

      {76, <<_params::binary-size(28), command::little-16, _::binary>>} ->
        [{command, 0} | commands(rest)]

      _other ->
        commands(rest)
    end
  end

  defp commands(_end), do: []

  # How many commands were sent. A mode is safe to send again, and is when its answer is late, with a higher
  # confirmation (C1): that is the same command.
  defp reached(wire), do: Enum.count(sent(wire), fn {@set_mode, confirmation, _ref} -> confirmation == 0 end)

  defp sent(wire), do: Agent.get(wire, &:ets.lookup(&1.counts, @set_mode))

  defp mode(%{gateway: gateway}, id, mode) do
    Task.async(fn ->
      {:ok, result} =
        Commands.submit(gateway,
          vehicle: @vehicle,
          type: "set_mode",
          params: %{mode: mode},
          id: id,
          deadline: System.os_time(:second) + 60
        )

      result
    end)
  end

  defp await(task), do: Task.await(task, Aerie.Patience.ms())

  test "the same id at both at once, and over NATS: the vehicle gets it once, and each asker one answer",
       context do
    %{holder: holder, other: other, wire: wire} = context
    before = reached(wire)
    results = for n <- [holder, other, holder, other], do: mode(n, "same", "GUIDED")
    results = Enum.map(results, &await/1)
    assert Enum.map(results, & &1.status) == [:completed, :completed, :completed, :completed]
    assert reached(wire) == before + 1
    assert SimVehicle.state(context.sim).mode == "GUIDED"

    # By NATS, as any program of the fleet asks: the holder alone answers.
    {:ok, conn} = HubServer.client(context.server)
    subject = "fleet.test.#{@vehicle}.cmd.set_mode"

    body =
      JSON.encode!(%{
        "id" => "by-nats",
        "params" => %{"mode" => "LOITER"},
        "deadline" => DateTime.to_iso8601(DateTime.add(DateTime.utc_now(), 60))
      })

    inbox = "_INBOX.two.#{System.unique_integer([:positive])}"
    {:ok, _sid} = Gnat.sub(conn, self(), inbox)
    headers = [{"Aerie-Signature", Signature.sign(context.nkey, subject, body, DateTime.utc_now())}]
    for _copy <- 1..2, do: :ok = Gnat.pub(conn, subject, body, reply_to: inbox, headers: headers)

    answers = for _copy <- 1..2, do: assert_receive({:msg, %{topic: ^inbox, body: _answer}})

    assert [%{"result" => "completed"}, %{"result" => "completed"}] =
             for({:msg, %{body: text}} <- answers, do: JSON.decode!(text))

    assert %{status: status} = other |> mode("by-nats", "LOITER") |> await()
    assert status in [:completed, :rejected]
    refute_received {:msg, %{topic: ^inbox}}
    assert reached(wire) == before + 2
  end

  test "another id at the one that does not hold it goes through the holder", context do
    %{holder: holder, other: other, wire: wire} = context
    {before, copies} = {reached(wire), length(sent(wire))}

    assert %{status: :completed, details: %{"gateway" => _name, "once" => "fleet", "sent" => first}} =
             other |> mode("o1", "GUIDED") |> await()

    assert %{status: :completed, details: %{"once" => "fleet", "sent" => second} = details} =
             holder |> mode("h1", "LOITER") |> await()

    refute is_map_key(details, "gateway")
    assert reached(wire) == before + 2
    # The results count the copies on the wire.
    assert length(sent(wire)) == copies + first + second
  end

  test "the holder ends: the other takes over, and knows what was done", context do
    %{holder: holder, other: other, wire: wire} = context
    assert %{status: :completed} = holder |> mode("first", "GUIDED") |> await()
    sent = reached(wire)
    stop_gateway(holder)
    eventually(fn -> match?({:mine, _until}, holder(other)) end, "the other one holds it")
    assert %{status: :completed} = other |> mode("first", "GUIDED") |> await()
    assert reached(wire) == sent
    assert %{status: :completed, details: %{"once" => "fleet"}} = other |> mode("second", "LOITER") |> await()
    assert reached(wire) == sent + 1
  end

  # How long a gateway waits for what it needs before it sends a command, here for its lease.
  @tag record_s: 5.0
  test "NATS is away: once the lease has ended only what brings the vehicle down is sent; later all passes",
       context do
    %{holder: holder, other: other, wire: wire, server: server} = context
    sent = reached(wire)
    HubServer.kill(server)
    eventually(fn -> match?({:unknown, _why}, holder(holder)) end, "the lease has ended")

    for {gateway, n} <- Enum.with_index([holder, other, holder]) do
      assert %{status: status, reason: why, details: %{"rule" => rule}} =
               gateway |> mode("cut-#{n}", "GUIDED") |> await()

      assert {status, rule} in [{:denied, "holder"}, {:failed, "unreachable"}]
      assert why =~ "nothing was sent"
    end

    assert reached(wire) == sent

    # No lease keeps back what holds a vehicle or brings it down: of a gateway that may not hold it either.
    for {gateway, n} <- Enum.with_index([holder, other]) do
      assert %{status: :completed, details: details} = gateway |> mode("home-#{n}", "RTL") |> await()
      assert details["once"] in ["gateway", nil]
      assert reached(wire) == sent + n + 1
    end

    sent = reached(wire)
    HubServer.restart(server)
    {holder, other} = held(holder, other)
    assert %{status: :completed} = holder |> mode("again-h", "GUIDED") |> await()
    assert %{status: :completed} = other |> mode("again-o", "LOITER") |> await()
    assert reached(wire) == sent + 2
  end
end
