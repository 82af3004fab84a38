defmodule Aerie.Api.Rest.ClientsTest do
  use Aerie.APICase, async: true

  alias Aerie.Base.Store
  alias MavRouter.Client.LocalEndpoint

  @json {"content-type", "application/json"}

  defp admin, do: {"x-aerie-key", key()}
  defp post(port, body), do: post(port, body, [@json, admin()])

  defp post(port, body, headers),
    do: request(port, "POST", "/api/clients", headers, if(is_map(body), do: JSON.encode!(body), else: body))

  test "an endpoint for clients is added, carries frames both ways, is listed and removed, while the gateway runs" do
    %{gateway: gateway, port: port} = start_server(key: true, links: true)
    {:ok, radio} = LocalEndpoint.attach(gateway, id: "radio", side: :vehicle)
    {:ok, gcs} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    {:ok, gcs_port} = :inet.port(gcs)

    assert {201, _headers, %{"id" => "field"}} =
             post(port, %{"url" => "udpout:127.0.0.1:#{gcs_port}", "id" => "field"})

    heartbeat =
      &MavCodec.encode(%MavCodec.Messages.Heartbeat{type: &1, autopilot: &2, mavlink_version: 3},
        system: &3,
        component: 1
      )

    {[frame], _parser} = MavCodec.Parser.push(MavCodec.Parser.new(), heartbeat.(2, 3, 1), 1)

    # It is called as soon as its link is up.
    {:ok, {_address, from, bytes}} =
      eventually(fn ->
        LocalEndpoint.ingress(radio, [frame])
        with {:error, :timeout} <- :gen_udp.recv(gcs, 0, 50), do: nil
      end)

    assert bytes == frame.bytes
    :ok = :gen_udp.send(gcs, {127, 0, 0, 1}, from, heartbeat.(6, 8, 255))
    ours = heartbeat.(6, 8, 255)
    assert_receive {:forward, [^ours], :control}
    # A client is not a vehicle, whatever it says.
    :ok = :gen_udp.send(gcs, {127, 0, 0, 1}, from, heartbeat.(2, 3, 77))
    assert_receive {:forward, _frames, _class}
    assert Store.vehicle(gateway, {"main", 77}) == nil

    assert {200, _headers, %{"endpoints" => [%{"id" => "field"}], "clients" => [client]}} =
             request(port, "GET", "/api/clients", [admin()])

    assert %{"id" => "field", "kind" => "link", "access" => "full", "frames_in" => 2, "dropped" => 0} = client

    assert {409, _headers,
            %{"error" => %{"code" => "conflict", "message" => "there is already a client field"}}} =
             post(port, %{"url" => "udpout:127.0.0.1:9", "id" => "field"})

    assert {204, _headers, nil} = request(port, "DELETE", "/api/clients/field", [admin()])
    assert {404, _headers, _body} = request(port, "DELETE", "/api/clients/field", [admin()])

    assert {200, _headers, %{"endpoints" => [], "clients" => []}} =
             request(port, "GET", "/api/clients", [admin()])
  end

  test "a link to vehicles cannot be removed here" do
    %{gateway: gateway, port: port} = start_server(key: true, links: true)
    {:ok, "sim"} = MavRouter.Link.start(gateway, "udpin:127.0.0.1:0", id: "sim")
    assert {409, _headers, _body} = request(port, "DELETE", "/api/clients/sim", [admin()])
    assert %{id: "sim"} = Store.link(gateway, "sim")
  end

  test "invalid requests are refused with what is expected, and change nothing" do
    %{gateway: gateway, port: port} = start_server(key: true, links: true)

    for {body, word} <- [
          {%{}, "udpout:"},
          {%{"url" => 7}, "udpout:"},
          {%{"url" => "udpout:127.0.0.1"}, "port"},
          {%{"url" => "/dev/ttyUSB0,57600"}, "udpin"},
          {%{"url" => "replay:/etc/passwd"}, "udpin"},
          {%{"url" => String.duplicate("x", 600)}, "udpout:"},
          {%{"url" => "udpin:127.0.0.1:0", "id" => "a b"}, "letters"},
          {%{"url" => "udpin:127.0.0.1:0", "id" => 7}, "letters"},
          {%{"url" => "udpin:127.0.0.1:0", "networks" => []}, "names"},
          {%{"url" => "udpin:127.0.0.1:0", "networks" => ["a/b"]}, "names"},
          {%{"url" => "udpin:127.0.0.1:0", "networks" => ["feild"]},
           ~s(unknown network "feild"; known: main)},
          {%{"url" => "udpin:127.0.0.1:0", "access" => "write"}, "one of full, read"},
          {%{"url" => "udpin:127.0.0.1:0", "sudo" => true}, "sudo: expected only url, id"}
        ] do
      assert {422, _headers, %{"error" => %{"code" => "invalid", "message" => message}}} = post(port, body)
      assert message =~ word
    end

    for body <- ["", "{", "[]", "7", "\"x\"", <<0xFF, 0xFE>>, "{\"url\": \"a\"} trailing"],
        do: assert({400, _headers, %{"error" => %{"code" => "bad_request"}}} = post(port, body))

    form = {"content-type", "application/x-www-form-urlencoded"}
    assert {415, _headers, _body} = post(port, "url=udpin", [form, admin()])
    assert {415, _headers, _body} = post(port, "{}", [admin()])
    large = ["{\"url\": \"", String.duplicate("x", 20_000), "\"}"]
    assert {413, _headers, %{"error" => %{"code" => "too_large"}}} = post(port, IO.iodata_to_binary(large))

    assert MavRouter.Client.endpoints(gateway) == []
    assert Store.counter(gateway, {:api, 422}) == 13
  end

  test "if there is a key, it is required" do
    %{port: port} = start_server(key: true, links: true)
    assert {401, _headers, _body} = post(port, %{"url" => "udpin:127.0.0.1:0"}, [@json])
    assert {401, _headers, _body} = request(port, "DELETE", "/api/clients/x")

    assert {201, _headers, _body} =
             post(port, %{"url" => "udpin:127.0.0.1:0"}, [@json, {"x-aerie-key", key()}])
  end

  test "the metrics count clients by kind" do
    %{gateway: gateway} = start_server(links: true)
    {:ok, _endpoint} = LocalEndpoint.attach(gateway, id: "ws-1", kind: :websocket)
    text = IO.iodata_to_binary(Aerie.Api.Metrics.Text.render(Aerie.Api.Metrics.families(gateway)))
    assert text =~ ~s(gateway_clients{kind="websocket"} 1)
    assert text =~ ~s(gateway_client_sent_frames{kind="websocket"} 0)
  end
end
