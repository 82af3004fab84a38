defmodule Aerie.Api.Rest.HTTPTest do
  use Aerie.APICase, async: true

  alias Aerie.Base.Store

  test "GET /api/status has one object per vehicle, in the form of state.sock" do
    %{gateway: gateway, port: port} = start_server()
    assert {200, headers, %{"vehicles" => [], "timestamp" => time}} = request(port, "GET", "/api/status")
    assert is_float(time)
    assert %{"content-type" => "application/json; charset=utf-8", "cache-control" => "no-store"} = headers

    put_vehicle(gateway, "VID-001", 1)
    put_vehicle(gateway, "VID-002", 2)
    {200, _headers, %{"vehicles" => vehicles}} = request(port, "GET", "/api/status")

    assert [%{"vehicle" => "VID-001", "fc_connected" => true}, %{"vehicle" => "VID-002"}] = vehicles
    assert [%{"position" => %{"lat" => 47.1, "lon" => nil, "alt_rel" => 3.5}}, _second] = vehicles
  end

  test "GET /api/vehicles/:id has all groups with their times; an unknown name is an error" do
    %{gateway: gateway, port: port} = start_server()
    put_vehicle(gateway, "VID-001", 1)
    assert {200, _headers, vehicle} = request(port, "GET", "/api/vehicles/VID-001")

    assert %{
             "firmware" => "1.15.4",
             "groups" => %{"position" => %{"data" => %{"lon" => nil}, "time" => time}}
           } =
             vehicle

    assert {:ok, _time, 0} = DateTime.from_iso8601(time)

    for name <- ["VID-009", "%00", String.duplicate("x", 3000)] do
      assert {404, _headers, %{"error" => %{"code" => "not_found", "message" => message}}} =
               request(port, "GET", "/api/vehicles/" <> name)

      assert message =~ "/api/vehicles"
    end
  end

  test "GET /api/links, GET /api and HEAD" do
    %{gateway: gateway, port: port} = start_server()

    Store.put_link(gateway, "radio", %{
      id: "radio",
      network: "main",
      kind: :udp_server,
      url: "udpin::14550",
      status: :up,
      text: "listening",
      since: 1_700_000_000_000_000,
      peers: [],
      rates: %{bytes_in: 1.5},
      counters: %{frames_in: 7, messages: %{0 => 7}}
    })

    assert {200, _headers, %{"links" => [%{"id" => "radio", "counters" => %{"frames_in" => 7} = counters}]}} =
             request(port, "GET", "/api/links")

    refute Map.has_key?(counters, "messages")
    assert {200, _headers, %{"resources" => [_ | _]}} = request(port, "GET", "/api")
    assert {200, _headers, nil} = request(port, "HEAD", "/api/status")
  end

  test "with a key configured, every resource requires it, in either header, and says how" do
    %{port: port} = start_server(key: true)

    for path <- ["/api", "/api/status", "/api/vehicles", "/api/vehicles/x", "/api/links", "/api/nothing"] do
      assert {401, %{"www-authenticate" => "Bearer"},
              %{"error" => %{"code" => "unauthorized", "message" => text}}} =
               request(port, "GET", path)

      assert text =~ "X-Aerie-Key"
      assert {401, _headers, _body} = request(port, "GET", path, [{"x-aerie-key", "not-the-key-of-tests"}])
    end

    assert {200, _headers, _body} = request(port, "GET", "/api/status", [{"x-aerie-key", key()}])

    assert {200, _headers, _body} =
             request(port, "GET", "/api/status", [{"authorization", "Bearer " <> key()}])

    # What tells whether the gateway lives stays open.
    assert {200, _headers, _body} = request(port, "GET", "/healthz")
  end

  test "without a key, a request by a foreign name or through a proxy is refused" do
    %{port: port} = start_server()

    for header <- [{"host", "evil.example"}, {"x-forwarded-for", "10.0.0.9"}, {"forwarded", "for=10.0.0.9"}],
        do: assert({403, _headers, _body} = request(port, "GET", "/api/status", [header]))
  end

  test "foreign pages are refused, allowed ones learn what they may send" do
    %{port: port} = start_server(key: true, origins: ["https://gcs.example.org"])
    key = {"x-aerie-key", key()}

    assert {403, headers, _body} =
             request(port, "GET", "/api/status", [key, {"origin", "https://evil.example"}])

    refute Map.has_key?(headers, "access-control-allow-origin")

    assert {403, _headers, _body} =
             request(port, "OPTIONS", "/api/status", [{"origin", "https://evil.example"}])

    allowed = {"origin", "https://gcs.example.org"}
    assert {204, headers, nil} = request(port, "OPTIONS", "/api/status", [allowed])
    assert %{"access-control-allow-origin" => "https://gcs.example.org"} = headers
    assert {200, headers, _body} = request(port, "GET", "/api/status", [key, allowed])
    assert %{"access-control-allow-origin" => "https://gcs.example.org", "vary" => "origin"} = headers
  end

  test "unknown resources and methods are answered in JSON, and every answer is counted by its status" do
    %{gateway: gateway, port: port} = start_server()
    assert {404, _headers, %{"error" => %{"code" => "not_found"}}} = request(port, "GET", "/api/nothing/here")

    assert {405, %{"allow" => "GET"}, %{"error" => %{"code" => "method_not_allowed"}}} =
             request(port, "DELETE", "/api/status")

    assert {405, %{"allow" => "POST"}, _body} = request(port, "GET", "/api/tickets")
    assert {405, _headers, _body} = request(port, "BREW", "/api/status")

    assert Store.counter(gateway, {:api, 404}) == 1
    assert Store.counter(gateway, {:api, 405}) == 3
    text = IO.iodata_to_binary(Aerie.Api.Metrics.Text.render(Aerie.Api.Metrics.families(gateway)))
    assert text =~ ~s(gateway_api_requests_total{status="405"} 3)
  end

  test "input that is not HTTP closes only its own connection" do
    %{port: port} = start_server()

    for bytes <- [
          "\0\0\0\0\r\n\r\n",
          "GET /api/status\r\n\r\n",
          "GET #{String.duplicate("x", 20_000)} HTTP/1.1\r\n\r\n",
          ["GET /api HTTP/1.1\r\nhost: localhost\r\n", List.duplicate("a: b\r\n", 500), "\r\n"],
          "GET /api/vehicles/%zz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n"
        ] do
      assert answer(port, bytes) =~ ~r/\AHTTP\/1.1 4\d\d /
    end

    assert {200, _headers, _body} = request(port, "GET", "/api/status")
  end

  @tag :tmp_dir
  test "a key with the role viewer reads, and changes nothing; one that expired does not even read", %{
    tmp_dir: dir
  } do
    file = Path.join(dir, "keys")
    File.write!(file, "victor the-key-of-victor role=viewer\nolga the-key-of-olga-0 expires=2020-01-01\n")
    File.chmod!(file, 0o600)
    %{port: port} = start_server(keys_file: file)
    victor = [{"x-aerie-key", "the-key-of-victor"}]
    assert {200, _headers, _body} = request(port, "GET", "/api/status", victor)
    assert {403, _headers, %{"error" => error}} = request(port, "POST", "/api/clients", victor, "{}")
    assert error["message"] == "the key victor may only read (role=viewer)"

    assert {401, _headers, %{"error" => error}} =
             request(port, "GET", "/api/status", [{"x-aerie-key", "the-key-of-olga-0"}])

    assert error["message"] == "this key was good until 2020-01-01"
  end
end
