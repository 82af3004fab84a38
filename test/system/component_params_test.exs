defmodule Aerie.System.ComponentParamsTest do
  @moduledoc """
  The parameters of a vehicle's camera (PARAM_EXT, P8) over REST and NATS through the whole gateway, with the examples
  of docs/transfers.md, and by pymavlink as a ground station of the gateway.
  """

  use Aerie.SystemCase, async: true

  import Aerie.PeerCase, only: [findings: 1, start_peer: 2]

  alias MavRouter.Client

  @moduletag :tmp_dir
  @chief "key-of-the-chief-0001"
  @wall "key-of-the-wall-00001"
  @page File.read!(Path.expand("../../docs/transfers.md", __DIR__))

  setup %{tmp_dir: folder} = context do
    keys = private_file(folder, "keys", "chief #{@chief} role=admin\nwall #{@wall} role=viewer\n")
    policy = context[:policy] || %{}
    overrides = %{"policy" => policy, "api" => %{"keys_file" => keys}, "timeouts" => patient()}

    %{gateway: gateway} =
      start_gateway(folder, links: ["udpin:127.0.0.1:0"], stations: ["maintain"], overrides: overrides)

    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    start_supervised!({SimVehicle, firmware: :px4, camera: 100, ready_s: 1.0, link: link})
    Aerie.BridgeCase.await_listening(gateway, ["VID-001"])
    %{gateway: gateway, conn: nats_client(gateway)}
  end

  defp vehicle(c, method, path, body \\ nil, key \\ @chief),
    do: rest(c.gateway, method, "vehicles/VID-001/#{path}", body, key: key)

  defp nats(c, operation, body), do: nats_request(c.conn, "fleet.test.VID-001.#{operation}", body)

  @tag policy: %{"unsigned" => "admin"}
  test "over REST and NATS", c do
    assert {200, %{"count" => 12, "params" => params}} = vehicle(c, :get, "params?component=100", nil, @wall)
    assert %{"value" => 0xFFFF_FFFF_FFFF_FFFF, "type" => 7} = Enum.find(params, &(&1["name"] == "CAM_FREE"))
    assert %{"result" => "completed", "count" => 12} = nats(c, "params.list", %{"component" => 100})
    get = %{"component" => 100, "name" => "CAM_SERIAL"}
    assert %{"value" => "base64:AAEC/w==", "type" => 11} = nats(c, "params.get", get)

    assert {200, %{"result" => "completed", "value" => "Rear"}} =
             vehicle(c, :put, "params/CAM_NAME?component=100", %{"value" => "Rear", "id" => "c1"})

    set = %{"id" => "c2", "component" => 100, "name" => "CAM_MODE", "value" => 7}
    assert %{"result" => "rejected", "value" => 1} = nats(c, "params.set", set)

    assert {422, %{"result" => "rejected"}} =
             vehicle(c, :put, "params/CAM_MODE?component=100", %{"value" => "x"})

    assert {403, _refused} = vehicle(c, :put, "params/CAM_NAME?component=100", %{"value" => "x"}, @wall)

    for wrong <- ["params?component=0", "params/A?component=x", "params?component=100&format=param"],
        do: assert({422, %{"error" => %{"message" => "component: " <> _}}} = vehicle(c, :get, wrong))

    assert {422, _error} = vehicle(c, :put, "params?component=100", %{"values" => %{"CAM_MODE" => 1}})
    assert %{"errors" => [%{"key" => "component"}]} = nats(c, "params.set", %{set | "component" => "camera"})

    assert %{"errors" => [%{"key" => "component"}]} =
             nats(c, "params.load", %{"id" => "c4", "component" => 100})
  end

  @tag policy: %{"unsigned" => "viewer"}
  test "setting a camera's parameter needs the autopilot's permission", c do
    set = %{"id" => "c1", "component" => 100, "name" => "CAM_MODE", "value" => 2}
    assert %{"result" => "denied", "rule" => "role"} = nats(c, "params.set", set)
  end

  @tag policy: %{"unsigned" => "operator"}
  test "P8: an operator sets a camera's parameters, and not those of another component", c do
    set = %{"id" => "c1", "component" => 100, "name" => "CAM_MODE", "value" => 2}
    assert %{"result" => "completed"} = nats(c, "params.set", set)

    for component <- [1, 25, 191] do
      denied = nats(c, "params.set", %{set | "id" => "d#{component}", "component" => component})
      assert %{"result" => "denied", "rule" => "role"} = denied
    end
  end

  @tag policy: %{"unsigned" => "admin"}
  test "the examples of docs/transfers.md do what it says", c do
    [_all, section] = Regex.run(~r/## Parameters of cameras.*?\n(.*?)\n## /s, @page)
    [got, set] = for [line] <- Regex.scan(~r/^\{.*\}$/m, section), do: JSON.decode!(line)
    [_all, path] = Regex.run(~r/"http:\/\/localhost:4000\/api\/vehicles\/VID-001\/(\S+)"/, section)
    assert vehicle(c, :get, path) == {200, got}
    [_all, body] = Regex.run(~r/VID-001\.params\.set '(.+)' --timeout/, section)
    assert nats(c, "params.set", JSON.decode!(body)) == set
  end

  @tag :python
  test "pymavlink reads and sets what the camera has", %{gateway: gateway} do
    {:ok, id} = Client.add(gateway, "tcpin:127.0.0.1:0")
    port = Enum.find(Client.endpoints(gateway), &(&1.id == id)).port
    findings = findings(start_peer("pymavlink_camera.py", ["tcp:127.0.0.1:#{port}", 1, 100]))

    # As the gateway reads them.
    {:ok, table} = Aerie.Control.Params.list(gateway, "VID-001", component: 100)
    changed = ["CAM_ISO", "CAM_FORMAT", "CAM_NAME", "CAM_SERIAL"]

    for {name, %{value: value}} <- table.params,
        name not in changed,
        do: assert({name, findings[name]} == {name, "#{value}"})

    assert %{"type" => "30", "CAM_ISO" => "16777728", "CAM_FORMAT" => "256", "CAM_NAME" => "b'Nadir'"} =
             findings

    assert findings["CAM_SERIAL"] == ~S(b'\x00\x01\x02\xff')
    assert %{"set" => "0 33554688", "unsupported" => "1 1", "begun" => "3", "done" => "0 512"} = findings
    assert table.params["CAM_ISO"].value == 33_554_688
    assert table.params["CAM_FORMAT"].value == 512
  end

  @tag :python
  @tag policy: %{"clients" => [%{"role" => "viewer"}]}
  test "pymavlink that may not set it gets an answer that says so", %{gateway: gateway} do
    {:ok, id} = Client.add(gateway, "tcpin:127.0.0.1:0")
    port = Enum.find(Client.endpoints(gateway), &(&1.id == id)).port
    findings = findings(start_peer("pymavlink_camera.py", ["tcp:127.0.0.1:#{port}", 1, 100, "refused"]))
    # PARAM_ACK_FAILED, of the type that was set.
    assert %{"set" => "2 5"} = findings

    assert {:ok, %{value: 16_777_728}} =
             Aerie.Control.Params.get(gateway, "VID-001", "CAM_ISO", component: 100)
  end
end
