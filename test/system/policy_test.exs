defmodule Aerie.System.PolicyTest do
  @moduledoc "The policy of the configuration, between a ground station and a simulated vehicle that flies."

  use Aerie.SystemCase, async: true

  alias Aerie.Control.Policy.Audit
  alias Aerie.Control.Policy.Audit.Verify
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Frame
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @moduletag capture_log: true
  @key {"main", 1}

  test "a fence that changed is in force when the policy is read again over REST; one with errors is not", %{
    tmp_dir: folder
  } do
    fence = Path.join(folder, "fence.geojson")

    file =
      private_file(
        folder,
        "keys",
        "chief key-of-the-chief-0001 role=admin\nops key-of-the-operator-1 role=operator\n"
      )

    square = &~s({"type": "Polygon", "coordinates": [[[8, #{&1}], [9, #{&1}], [9, 48], [8, 48]]]})
    File.write!(fence, square.(46))
    overrides = %{"policy" => %{"geofence_file" => fence}, "api" => %{"keys_file" => file}}
    %{gateway: gateway} = start_gateway(folder, overrides: overrides)
    first = Aerie.Control.Policy.Store.get(gateway)
    chief = "key-of-the-chief-0001"
    assert {200, %{"problem" => nil}} = rest(gateway, :get, "/api/policy", nil, key: chief)
    assert {403, _error} = rest(gateway, :post, "/api/policy/reload", nil, key: "key-of-the-operator-1")
    File.write!(fence, square.(47))
    assert {200, %{"problem" => nil}} = rest(gateway, :post, "/api/policy/reload", nil, key: chief)
    second = Aerie.Control.Policy.Store.get(gateway)
    assert second != first
    File.write!(fence, "{}")

    assert {422, %{"errors" => ["policy.geofence_file: " <> _]}} =
             rest(gateway, :post, "/api/policy/reload", nil, key: chief)

    assert Aerie.Control.Policy.Store.get(gateway) == second
    assert {200, %{"problem" => %{"errors" => [line]}}} = rest(gateway, :get, "/api/policy", nil, key: chief)

    # Ready once all code is loaded, which the work of other tests may delay.
    ready = fn ->
      with({200, body} <- rest(gateway, :get, "/readyz", nil, key: chief), do: body, else: (_not_yet -> nil))
    end

    assert %{"policy" => %{"problem" => ^line}} = eventually(ready, "the gateway is ready")
  end

  test "limits hold for what a ground station commands, the vehicle does the rest, and all of it is on record",
       %{
         tmp_dir: folder
       } do
    audit = Path.join(folder, "audit")

    overrides = %{
      "clients" => [%{"id" => "laptop", "url" => "udpin:127.0.0.1:0"}],
      "policy" => %{
        "max_altitude" => 100,
        "clients" => [%{"id" => "laptop", "role" => "operator"}],
        "audit" => %{"dir" => audit}
      }
    }

    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: overrides)
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    start_supervised!({SimVehicle, firmware: :ardupilot, ready_s: 0.0, link: link})

    eventually(
      fn -> match?(%{groups: %{position: _, mode: _}}, Store.vehicle(gateway, @key)) end,
      "the vehicle is known"
    )

    {:ok, socket} = :gen_udp.open(0, [:binary, active: false, ip: {127, 0, 0, 1}])

    port =
      eventually(fn -> MavRouter.Link.snapshot(gateway, "laptop").port end, "the client's endpoint is open")

    :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, port)

    assert %{result: 2} = command(socket, "NAV_TAKEOFF", param7: 150.0)

    # Among the telemetry of a busy machine it may be lost, or late; then the command is given again.
    assert %{text: "refused: the height to climb to is 150" <> _} =
             eventually(
               fn ->
                 answer(socket, 200, &match?(%M.Statustext{text: "refused" <> _}, &1)) ||
                   (command(socket, "NAV_TAKEOFF", param7: 150.0) && nil)
               end,
               "it is told why"
             )

    assert %{result: 2} = command(socket, "PREFLIGHT_REBOOT_SHUTDOWN", param1: 1.0)

    say(socket, %M.SetMode{target_system: 1, base_mode: 1, custom_mode: 4})
    eventually(fn -> Store.vehicle(gateway, @key).groups.mode.data.mode == "GUIDED" end, "it is in GUIDED")

    assert %{result: 0} = command(socket, "COMPONENT_ARM_DISARM", param1: 1.0)
    assert %{result: 0} = command(socket, "NAV_TAKEOFF", param7: 20.0)
    eventually(fn -> Store.vehicle(gateway, @key).groups.mode.data.in_air end, "it flies")
    assert %{result: 2} = command(socket, "COMPONENT_ARM_DISARM", param2: 21_196.0)
    assert Store.vehicle(gateway, @key).groups.mode.data.armed

    {:ok, _status} = Audit.status(gateway)
    assert {:ok, %{problems: []}} = Verify.folder(audit)

    records =
      audit
      |> Path.join("*.jsonl")
      |> Path.wildcard()
      |> Enum.flat_map(&File.stream!/1)
      |> Enum.map(&JSON.decode!/1)

    assert [
             {"takeoff", "deny"},
             {"reboot", "deny"},
             {"set_mode", "allow"},
             {"arm", "allow"},
             {"takeoff", "allow"},
             {"force_disarm", "deny"}
           ] =
             Enum.dedup(
               for %{"command" => command, "decision" => decision} <- records, do: {command, decision}
             )

    assert Store.counter(gateway, {:policy, :deny, :role}) >= 2
  end

  # Sent again until it is answered, as ground stations do: telemetry that nobody read meanwhile may have filled the socket.
  defp command(socket, name, params) do
    id = MavCmd.value(:"MAV_CMD_#{name}")
    message = struct!(%M.CommandLong{target_system: 1, target_component: 1, command: id}, params)

    eventually(
      fn ->
        say(socket, message)
        answer(socket, 200, &match?(%M.CommandAck{command: ^id}, &1))
      end,
      "#{name} is answered"
    )
  end

  defp say(socket, message),
    do: :ok = :gen_udp.send(socket, MavCodec.encode(message, system: 255, component: 190))

  # The wanted message among the next ones; nil if it does not come soon.
  defp answer(_socket, 0, _wanted?), do: nil

  defp answer(socket, n, wanted?) do
    with {:ok, {_address, _port, bytes}} <- :gen_udp.recv(socket, 0, 500) do
      {:ok, message} = bytes |> Frame.from_bytes(nil) |> MavCodec.decode()
      if wanted?.(message), do: message, else: answer(socket, n - 1, wanted?)
    else
      {:error, :timeout} -> nil
    end
  end
end
