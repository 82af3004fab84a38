defmodule Aerie.System.CommandFacesTest do
  @moduledoc """
  Simulated ArduPilot and PX4 flown over NATS and over REST through the whole gateway; the examples of docs/commands.md; and `kill -9` of a
  gateway with commands under way.
  """

  use Aerie.SystemCase, async: true

  import Aerie.BridgeCase, only: [await_listening: 2, kill9: 1, other_vm: 2]

  @moduletag :tmp_dir
  @moduletag :capture_log
  @rest_key "key-of-the-operator-1"
  @page File.read!(Path.expand("../../docs/commands.md", __DIR__))

  defp start(context, policy \\ %{}) do
    folder = context.tmp_dir
    keys = private_file(folder, "keys", "ops #{@rest_key} role=operator\n")
    nkey = Nkey.generate(:user)

    policy =
      Map.merge(
        %{
          "max_altitude" => 100,
          "sources" => [%{"name" => "ops", "nkey" => nkey.public, "role" => "operator"}]
        },
        policy
      )

    overrides = %{"policy" => policy, "api" => %{"keys_file" => keys}, "timeouts" => patient()}
    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: overrides)
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"

    fast = fast_vehicle(context[:firmware] || :ardupilot)
    given = if context[:ready_s], do: [ready_s: context[:ready_s]], else: []
    sim = start_supervised!({SimVehicle, [link: link] ++ Keyword.merge(fast, given)})

    ready? = context[:ready_s] == nil
    if ready?, do: SimVehicle.await(sim, & &1.ready)

    known = fn ->
      data(gateway, :mode)[:in_air] == false and (not ready? or data(gateway, :home)[:alt_msl])
    end

    eventually(known, "vehicle, home and landed state are known")

    await_listening(gateway, ["VID-001"])

    %{gateway: gateway, sim: sim, nkey: nkey, conn: nats_client(gateway)}
  end

  # The two faces: type and parameters in, the result out.
  defp nats(%{conn: conn, nkey: nkey}, id \\ nil) do
    fn type, params ->
      body = %{"id" => id || Aerie.Vehicle.Command.id(), "params" => params, "deadline" => deadline()}
      nats_request(conn, "fleet.test.VID-001.cmd.#{type}", body, nkey)
    end
  end

  defp rest(c) do
    fn type, params ->
      c.gateway |> post(%{"type" => type, "params" => params, "deadline" => deadline()}) |> elem(1)
    end
  end

  # A busy machine needs longer than the ten seconds that a command has by itself.
  defp deadline, do: System.os_time(:second) + 120

  defp post(gateway, body, query \\ ""),
    do: rest(gateway, :post, "vehicles/VID-001/commands" <> query, body, key: @rest_key)

  defp fly(%{gateway: gateway, sim: sim}, command, modes) do
    assert %{"result" => "completed"} = command.("set_mode", %{"mode" => modes.first})
    assert %{"result" => "completed"} = command.("arm", %{})
    assert %{"result" => "denied", "rule" => "altitude"} = command.("takeoff", %{"altitude" => 150})
    assert %{"result" => "completed"} = command.("takeoff", %{"altitude" => 10})
    SimVehicle.await(sim, &(&1.alt_rel > 8))
    %{lat: lat, lon: lon} = data(gateway, :position)

    assert %{"result" => "completed"} =
             command.("goto", %{"lat" => lat + 0.0003, "lon" => lon, "altitude" => 12})

    SimVehicle.await(sim, &(&1.lat > lat + 0.0002))
    assert %{"result" => "completed"} = command.("hold", %{})
    assert data(gateway, :mode)[:mode] == modes.hold
    assert %{"result" => "denied", "rule" => "role"} = command.("force_disarm", %{})
    assert %{"result" => "completed"} = command.("rtl", %{})
    assert data(gateway, :mode)[:mode] == modes.rtl
    assert %{"result" => "completed"} = command.("land", %{})
    SimVehicle.await(sim, &(not &1.armed))
  end

  @ardupilot %{first: "GUIDED", hold: "BRAKE", rtl: "RTL"}
  @px4 %{first: "AUTO_LOITER", hold: "AUTO_LOITER", rtl: "AUTO_RTL"}

  test("ArduPilot over NATS", context, do: context |> start() |> then(&fly(&1, nats(&1), @ardupilot)))
  test("ArduPilot over REST", context, do: context |> start() |> then(&fly(&1, rest(&1), @ardupilot)))

  @tag firmware: :px4
  test("PX4 over NATS", context, do: context |> start() |> then(&fly(&1, nats(&1), @px4)))

  @tag firmware: :px4
  test("PX4 over REST", context, do: context |> start() |> then(&fly(&1, rest(&1), @px4)))

  for {firmware, words} <- [ardupilot: "Arm: ", px4: "arm denied resolve failures"] do
    @tag firmware: firmware, ready_s: 3600.0, words: words
    test "#{firmware} says why it does not arm", context do
      flight = start(context)

      # It lasts: without a position alone, ArduPilot's first mode could be armed three seconds after the boot.
      SimVehicle.failsafe(flight.sim, :battery)
      assert %{"result" => result, "reason" => reason} = answer = rest(flight).("arm", %{})
      assert result in ["rejected", "failed"], inspect(answer)
      # What it said of its battery may come with it.
      assert reason =~ "; it said: " and reason =~ context.words
    end
  end

  test "the examples of docs/commands.md do what it says", context do
    %{gateway: gateway} = flight = start(context)

    stands_armed(flight)
    [_all, body, path] = Regex.run(~r/-d '(.+)' http:\/\/localhost:4000(\S+)/, @page)
    assert {200, result} = rest(gateway, :post, path, body, key: @rest_key)
    assert_shown(result)
    # Every command needs an id of its own.
    assert %{"rule" => "id"} = nats(flight, "t1").("takeoff", %{"altitude" => 30})

    stands_armed(flight)
    [_all, code] = Regex.run(~r/```elixir\n(.+?)```/s, @page)

    {{:ok, result}, _binding} =
      code |> String.replace(":default", "gateway") |> Code.eval_string(gateway: gateway)

    assert result.status == :completed
  end

  defp stands_armed(%{sim: sim} = flight) do
    command = rest(flight)
    if SimVehicle.state(sim).armed, do: assert(%{"result" => "completed"} = command.("land", %{}))
    SimVehicle.await(sim, &(not &1.armed))
    eventually(fn -> data(flight.gateway, :mode)[:in_air] == false end, "it is known to stand")
    assert %{"result" => "completed"} = command.("set_mode", %{"mode" => "GUIDED"})
    assert %{"result" => "completed"} = command.("arm", %{})
  end

  # The keys of the answers that the page shows.
  defp assert_shown(answer) do
    for [shown] <- Regex.scan(~r/^\{"id":"t1","result":.*\}$/m, @page) do
      assert Map.keys(JSON.decode!(shown)) -- Map.keys(answer) == []
      assert %{"result" => "completed"} = answer
    end
  end

  test "kill -9 of the gateway: nothing under way is sent again, and the state shows what it can", context do
    folder = context.tmp_dir
    [http, udp] = [free_tcp_port(), free_udp_port()]

    config =
      config_file(folder,
        links: [%{id: "radio", url: "udpin:127.0.0.1:#{udp}"}],
        http: %{port: http},
        api: %{key: @rest_key},
        websocket: %{enabled: false},
        sockets: %{enabled: false},
        nats: %{mode: :off},
        timeouts: patient()
      )

    script = """
    {:ok, _} = Application.ensure_all_started(:aerie)
    {:ok, top} = DynamicTop.start_link([])
    plan = %{config_file: #{inspect(config)}, overrides: %{}, sim: 0}
    {:ok, _run} = Aerie.CLI.Start.Run.start(plan, gateway: :g, supervisor: top, status: false)
    IO.puts("running " <> System.pid())
    Process.sleep(:infinity)
    """

    sim = start_supervised!({SimVehicle, firmware: :ardupilot, ready_s: 1.0, link: "udpout:127.0.0.1:#{udp}"})
    url = "http://127.0.0.1:#{http}/api/vehicles/VID-001/commands"
    {_port, pid} = other_vm(script, "running ")
    done = %{"type" => "set_mode", "id" => "done", "params" => %{"mode" => "GUIDED"}}
    # Until it is heard, there is no such vehicle.
    eventually(fn -> match?({200, _result}, post(http, done)) end, "it obeys")

    # It is done and the answer lost; the gateway cannot know. Killed at once: a command ends some seconds after it was sent, and the
    # disk may take longer for another one.
    :ok = SimVehicle.fault(sim, :silence, true)
    mode = %{"type" => "set_mode", "id" => "mode", "params" => %{"mode" => "LOITER"}}
    assert {202, _state} = post(http, mode, "?wait=0")
    SimVehicle.await(sim, &(&1.mode == "LOITER"))
    kill9(pid)
    ledger = Path.join(folder, "ledger/ledger")
    refute File.read!(ledger) =~ ~s(["done","mode"), "it ended before the gateway was killed"
    :ok = SimVehicle.fault(sim, :silence, false)
    {_port, pid} = other_vm(script, "running ")

    assert {200, %{"result" => "completed"}} =
             eventually(fn -> answered(url, "done") end, "its results are there")

    eventually(
      fn -> match?({200, %{"result" => "completed", "interrupted" => true}}, look(url, "mode")) end,
      fn ->
        "its state shows it: #{inspect(look(url, "mode"))}; it is in #{SimVehicle.state(sim).mode}; the gateway: #{written()}"
      end
    )

    # This one does not arrive. The ledger knows that it may have been sent.
    :ok = SimVehicle.fault(sim, :half_open, true)
    assert {202, _state} = post(http, %{"type" => "arm", "id" => "arm"}, "?wait=0")
    eventually(fn -> File.read!(ledger) =~ ~s(["sent","arm") end, "it is sent")
    kill9(pid)
    refute File.read!(ledger) =~ ~s(["done","arm"), "it ended before the gateway was killed"
    :ok = SimVehicle.fault(sim, :half_open, false)
    other_vm(script, "running ")

    eventually(
      fn -> match?({200, %{"result" => "unknown", "interrupted" => true}}, look(url, "arm")) end,
      fn -> "it is not shown: #{inspect(look(url, "arm"))}; the gateway: #{written()}" end
    )

    assert {200, %{"result" => "completed", "interrupted" => true}} = look(url, "mode")
    assert {504, %{"result" => "unknown", "reason" => reason}} = post(http, %{"type" => "arm", "id" => "arm"})
    assert reason =~ "it is not sent again"
    refute SimVehicle.state(sim).armed
  end

  # By the gateways, since they were up.
  defp written do
    {:messages, messages} = Process.info(self(), :messages)
    for {_port, {:data, {_end, line}}} <- messages, into: "", do: line <> "\n"
  end

  defp answered(url, id), do: with({200, _body} = answer <- look(url, id), do: answer, else: (_other -> nil))

  defp look(url, id) do
    request =
      {to_charlist("#{url}/#{id}"), [{~c"x-aerie-key", to_charlist(@rest_key)}, {~c"connection", ~c"close"}]}

    case http(:get, request) do
      {:ok, {{_version, status, _reason}, _headers, reply}} -> {status, JSON.decode!(reply)}
      {:error, _not_yet} -> nil
    end
  end
end
