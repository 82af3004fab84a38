defmodule Aerie.Fleet.Bridge.CommandsTest do
  @moduledoc "Commands by a real nats-server; the test is the vehicle's executor."
  use Aerie.BridgeCase, async: true

  import Aerie.CommandCase

  alias Aerie.Control.Policy.Roles.Signature

  @moduletag :tmp_dir
  @moduletag :capture_log

  setup %{tmp_dir: dir} = context do
    gateway = start_bridge(config(dir))
    key = Nkey.generate(:user)
    wall = Nkey.generate(:user)

    sources = [
      %{name: "ops", nkey: key.public},
      %{name: "wall", nkey: wall.public, role: :viewer}
    ]

    policy =
      [sources: sources, rates: [%{types: ["gripper"], per_minute: 1, burst: 1}]] ++ (context[:policy] || [])

    start_commands(dir, gateway: gateway, policy: policy)
    conn = client(await_up(gateway))
    await_listening(gateway, ["VID-007"])
    %{gateway: gateway, conn: conn, key: key, wall: wall}
  end

  defp subject(type), do: "fleet.test.VID-007.cmd.#{type}"

  # Asks in a task, signed if there is a key.
  defp ask(context, type, body, options \\ []) do
    body = if is_binary(body), do: body, else: JSON.encode!(body)
    key = Keyword.get(options, :key, context.key)

    signature =
      if key,
        do: [{"Aerie-Signature", Signature.sign(key, subject(type), body, DateTime.utc_now())}],
        else: []

    headers = signature ++ Keyword.get(options, :headers, [])

    Task.async(fn ->
      # What a flood left in the server's buffer for the gateway comes first, and a busy machine is slow to read it.
      options = [headers: headers, receive_timeout: Aerie.Patience.ms()]
      {:ok, %{body: reply}} = Gnat.request(context.conn, subject(type), body, options)
      JSON.decode!(reply)
    end)
  end

  defp reply(task), do: Task.await(task, Aerie.Patience.ms())

  test "a signed command: carried out in the name of the key, with progress, and again the stored result",
       context do
    {:ok, _sid} = Gnat.sub(context.conn, self(), subject("takeoff") <> ".progress.*")
    body = %{"id" => "t1", "params" => %{"altitude" => 20}, "source" => "tablet 3"}
    task = ask(context, "takeoff", body)

    assert_receive {:"$gen_call", from,
                    {:submit, %{id: "t1", source: "ops", params: %{altitude: 20.0}}, desk, _still?}}

    send(desk, {:command_progress, "t1", %{"progress" => 0.25, "text" => "climbing"}})
    assert_receive {:msg, %{topic: "fleet.test.VID-007.cmd.takeoff.progress.t1", body: progress}}
    assert JSON.decode!(progress) == %{"id" => "t1", "progress" => 0.25, "text" => "climbing"}
    answer(from, "t1", :completed)
    assert %{"id" => "t1", "result" => "completed", "reason" => nil} = reply(task)
    assert %{"id" => "t1", "result" => "completed"} = context |> ask("takeoff", body) |> reply()

    assert [%{"says" => "tablet 3", "source" => "ops", "via" => "nats"}] =
             for(%{"decision" => "allow"} = record <- audit(context.tmp_dir), do: record)
  end

  test "out of the box nobody commands: unsigned, by an unknown key, for another subject, changed", context do
    begun = System.monotonic_time(:millisecond)
    land = %{"id" => "l"}

    assert %{"id" => "l", "result" => "denied", "rule" => "signature"} =
             context |> ask("land", land, key: nil) |> reply()

    other = Nkey.generate(:user)
    assert %{"rule" => "signature", "reason" => reason} = context |> ask("land", land, key: other) |> reply()
    assert reason =~ "is not one of policy.sources"

    signature = Signature.sign(context.key, subject("hold"), JSON.encode!(land), DateTime.utc_now())
    headers = [{"Aerie-Signature", signature}]
    assert %{"rule" => "signature"} = context |> ask("land", land, key: nil, headers: headers) |> reply()

    old =
      Signature.sign(context.key, subject("land"), JSON.encode!(land), DateTime.add(DateTime.utc_now(), -90))

    assert %{"rule" => "signature"} =
             context |> ask("land", land, key: nil, headers: [{"Aerie-Signature", old}]) |> reply()

    refute_submitted()
    # A flood has one record in five seconds.
    [%{"type" => "opened"} | records] =
      eventually(fn -> with [_opened] <- audit(context.tmp_dir), do: nil end)

    assert Enum.all?(records, &match?(%{"rule" => "signature", "command" => "land"}, &1))
    assert length(records) <= 1 + div(System.monotonic_time(:millisecond) - begun, 5_000)
  end

  @tag policy: [unsigned: :operator]
  test "policy.unsigned: every publisher has that role; headers stand for keys of the body", context do
    past = "#{System.os_time(:second) - 1}"

    assert %{"result" => "expired"} =
             context |> ask("land", %{"id" => "e"}, key: nil, headers: [{"Aerie-Deadline", past}]) |> reply()

    task = ask(context, "land", %{"id" => "l"}, key: nil, headers: [{"Aerie-Source", "tower"}])
    answer(executing(%{id: "l", source: "unsigned"}), "l", :completed)
    assert %{"result" => "completed"} = reply(task)
    assert %{"rule" => "role"} = context |> ask("force_disarm", %{"id" => "f"}, key: nil) |> reply()
    assert "tower" in for(%{"says" => says} <- audit(context.tmp_dir), do: says)
  end

  test "each refusal says why", context do
    assert %{"rule" => "malformed", "errors" => [%{"key" => "id"}]} = context |> ask("land", %{}) |> reply()
    assert %{"rule" => "malformed"} = context |> ask("land", "[]") |> reply()

    assert %{"rule" => "malformed", "errors" => [%{"key" => "type"}]} =
             context |> ask("dance", %{"id" => "d"}) |> reply()

    assert %{"result" => "rejected", "errors" => [%{"key" => "params.altitude", "got" => "5000"}]} =
             context |> ask("takeoff", %{"id" => "t", "params" => %{"altitude" => 5000}}) |> reply()

    assert %{"rule" => "malformed"} =
             context |> ask("land", %{"id" => "x", "vehicle" => "VID-008"}) |> reply()

    deadline = [{"Aerie-Deadline", "2026-11-22T09:00:10Z"}]

    assert %{"rule" => "malformed", "reason" => "Aerie-Deadline" <> _} =
             context |> ask("land", %{"id" => "x"}, headers: deadline) |> reply()

    long = %{"id" => "long", "source" => String.duplicate("x", 20_000)}
    assert %{"result" => "rejected", "rule" => "size"} = context |> ask("land", long) |> reply()
    assert %{"rule" => "role"} = context |> ask("reboot", %{"id" => "r"}) |> reply()

    assert %{"result" => "expired"} =
             context |> ask("arm", %{"id" => "e", "deadline" => System.os_time(:second) - 1}) |> reply()

    grip = %{"id" => "g", "params" => %{"action" => "grab"}}
    task = ask(context, "gripper", grip)
    answer(executing(%{id: "g"}), "g", :accepted)
    assert %{"result" => "accepted"} = reply(task)

    assert %{"result" => "denied", "rule" => "rate"} =
             context |> ask("gripper", %{grip | "id" => "g2"}) |> reply()

    assert %{"result" => "rejected", "rule" => "id"} = context |> ask("land", %{"id" => "g"}) |> reply()
  end

  test "cancelling", context do
    task = ask(context, "takeoff", %{"id" => "t", "params" => %{"altitude" => 5}})
    from = executing(%{id: "t"})
    cancel = ask(context, "cancel", %{"id" => "t"})
    assert_receive {:"$gen_call", canceller, {:cancel, "t"}}
    GenServer.reply(canceller, :ok)
    assert %{"id" => "t", "result" => "accepted"} = reply(cancel)
    answer(from, "t", :cancelled)
    assert %{"result" => "cancelled"} = reply(task)
    assert %{"result" => "rejected"} = context |> ask("cancel", %{"id" => "t"}) |> reply()
  end

  test "only vehicles that were heard have a subject, and a new connection listens again", context do
    %{gateway: gateway, tmp_dir: dir} = context
    {:ok, asker} = Gnat.start_link(Map.merge(login(gateway), %{no_responders: true}))
    assert {:error, :no_responders} = Gnat.request(asker, "fleet.test.VID-008.cmd.land", "{}")

    old = Bridge.connection(gateway)
    for conn <- [asker, context.conn], do: Process.unlink(conn)
    kill9(server_pid(dir))
    url = await_reconnected(gateway, old)
    await_listening(gateway, ["VID-007"])
    context = %{context | conn: client(url)}
    task = ask(context, "land", %{"id" => "l"})
    answer(executing(%{id: "l"}), "l", :completed)
    assert %{"result" => "completed"} = reply(task)
    :ok = Store.delete_vehicle(gateway, {"main", 7})
    eventually(fn -> Bridge.Commands.vehicles(gateway) == [] end)
  end

  defp login(gateway) do
    uri = URI.parse(Bridge.login_url(gateway))
    %{token: uri.userinfo, host: uri.host, port: uri.port, connection_timeout: Aerie.Patience.ms()}
  end

  # Three connections that publish as fast as the server takes it, until the test ends.
  defp flood(context, headers, body) do
    for _n <- 1..3 do
      {:ok, conn} = Gnat.start_link(login(context.gateway))

      start_supervised!(
        {Task, fn -> Stream.repeatedly(fn -> burst(conn, headers, body) end) |> Stream.run() end},
        id: make_ref()
      )
    end

    # It has begun to be more than is answered.
    eventually(fn -> unread(context.gateway) > 100 end)
  end

  # The ping that waits for its pong is what bounds the sender's own queue.
  defp burst(conn, headers, body) do
    for n <- 1..200, do: Gnat.pub(conn, subject("set_yaw"), body, headers: headers, reply_to: "_Z.#{n}")
    with {:error, _the_test_has_ended} <- Gnat.active_subscriptions(conn), do: exit(:normal)
  end

  defp unread(gateway) do
    for %{name: name, samples: [{[], n}]} <- Bridge.metrics(gateway),
        name in ["gateway_nats_commands_unread_total", "gateway_nats_commands_dropped_total"],
        reduce: 0,
        do: (sum -> sum + n)
  end

  # Each is carried out; none is told that there is no place.
  defp seven(context) do
    for n <- 1..7 do
      task = ask(context, "hold", %{"id" => "h#{n}"})
      id = "h#{n}"
      answer(executing(%{id: id}), id, :completed)
      assert %{"id" => ^id, "result" => "completed"} = reply(task)
    end
  end

  test "a flood without a signature keeps no signed command away", context do
    flood(context, [], ~s({"id": "flood", "params": {"yaw": 1}}))
    seven(context)
  end

  test "nor does one by a key that is not listed", context do
    body = ~s({"id": "flood", "params": {"yaw": 1}})
    signature = Signature.sign(Nkey.generate(:user), subject("set_yaw"), body, DateTime.utc_now())
    flood(context, [{"Aerie-Signature", signature}], body)
    seven(context)
  end

  test "nor do forged ones that name another listed key", context do
    body = ~s({"id": "flood", "params": {"yaw": 1}})

    [signer, at, _signature] =
      String.split(Signature.sign(context.wall, subject("set_yaw"), body, DateTime.utc_now()))

    forged = Base.url_encode64(:crypto.strong_rand_bytes(64), padding: false)
    flood(context, [{"Aerie-Signature", Enum.join([signer, at, forged], " ")}], body)
    seven(context)
  end

  test "nor does one that comes faster than it is dropped", context do
    pid = Aerie.Base.Names.whereis(context.gateway, :bridge_commands)
    :ok = :sys.suspend(pid)
    task = ask(context, "hold", %{"id" => "h"})
    eventually(fn -> Process.info(pid, :message_queue_len) == {:message_queue_len, 1} end)
    unsigned = %{topic: subject("set_yaw"), body: "{}", reply_to: nil, gnat: context.conn, sid: 1}
    for _n <- 1..20_000, do: send(pid, {:msg, unsigned})
    :ok = :sys.resume(pid)
    answer(executing(%{id: "h"}), "h", :completed)
    assert %{"result" => "completed"} = reply(task)
    eventually(fn -> unread(context.gateway) >= 19_000 end)
  end

  test "no command is in a stream", context do
    task = ask(context, "land", %{"id" => "l"})
    answer(executing(%{id: "l"}), "l", :completed)
    assert %{"result" => "completed"} = reply(task)

    for stream <- ~w(FLEET_STATE FLEET_EVENTS) do
      %{config: %{subjects: subjects}} = stream(context.conn, stream)
      refute Enum.any?(subjects, &(&1 =~ "cmd" or &1 =~ ~r/\*\.>$/))
    end
  end
end
