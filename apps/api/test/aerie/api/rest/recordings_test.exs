defmodule Aerie.Api.Rest.RecordingsTest do
  use Aerie.APICase, async: true

  alias MavRouter.Recorder

  @moduletag :tmp_dir
  @json {"content-type", "application/json"}
  @key {"main", 1}

  setup %{tmp_dir: dir} do
    server =
      start_server(key: true, links: true, recorder: %{dir: dir, min_free_mb: 0, flush_ms: 5, after_s: 60})

    put_vehicle(server.gateway, "VID-001", 1)
    server
  end

  defp send_json(port, method, path, object),
    do: request(port, method, path, [@json, admin()], JSON.encode!(object))

  defp admin, do: {"x-aerie-key", key()}
  defp get(port, path), do: request(port, "GET", path, [admin()])
  defp raw_head(port), do: "host: 127.0.0.1:#{port}\r\nx-aerie-key: #{key()}\r\nconnection: close\r\n\r\n"

  defp hear(gateway, numbers), do: Recorder.vehicle_frames(gateway, @key, Enum.map(numbers, &frame/1))

  defp frame(n) do
    bytes = MavCodec.encode(%MavCodec.Messages.Attitude{time_boot_ms: n}, system: 1, component: 1)

    {[frame], _parser} =
      MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, 1_000_000_000_000_000 + n)

    frame
  end

  test "the last minutes of a vehicle are saved on request and fetched as a file", %{
    gateway: gateway,
    port: port
  } do
    hear(gateway, 1..50)

    assert {201, _headers, %{"name" => name, "url" => url}} =
             send_json(port, "POST", "/api/vehicles/VID-001/save", %{"reason" => "near miss"})

    assert name =~ ~r/\Amain-VID-001-near_miss-\d{8}T\d{6}Z\.tlog\z/
    answer = answer(port, "GET #{url} HTTP/1.1\r\n" <> raw_head(port))
    assert [head, bytes] = String.split(answer, "\r\n\r\n", parts: 2)
    only_head = answer(port, "HEAD #{url} HTTP/1.1\r\n" <> raw_head(port))
    assert String.ends_with?(only_head, "\r\n\r\n") and only_head =~ "content-length: #{byte_size(bytes)}\r\n"
    assert head =~ "200 OK"
    assert head =~ "content-type: application/octet-stream"
    assert head =~ ~s(attachment; filename="#{name}")
    {frames, _decoder} = MavCodec.Tlog.Decoder.push(MavCodec.Tlog.Decoder.new(), bytes)
    assert Enum.map(frames, & &1.at) == for(n <- 1..50, do: 1_000_000_000_000_000 + n)

    assert {200, _headers, %{"files" => [file], "rings" => [ring]}} = get(port, "/api/recorder")
    assert %{"name" => ^name, "open" => true, "bytes" => size} = file
    assert size == byte_size(bytes)
    assert %{"network" => "main", "system" => 1, "entries" => 1} = ring
  end

  test "a recording is started, shown and stopped", %{gateway: gateway, port: port} do
    assert {200, _headers, %{"recording" => %{"state" => "recording", "mode" => "always"}}} =
             begin(gateway, port)

    assert {200, _headers, status} = get(port, "/api/status")

    assert %{"recording" => 1, "paused" => 0, "dropped" => 0, "error" => nil, "low" => false} =
             status["recorder"]

    assert {200, _headers, %{"recordings" => [recording]}} = get(port, "/api/recorder")
    assert %{"kind" => "vehicle", "frames" => 10, "since" => _, "file" => "main-VID-001-" <> _} = recording

    assert {200, _headers, %{"recording" => %{"state" => "off", "frames" => 10, "file" => nil}}} =
             send_json(port, "PUT", "/api/vehicles/VID-001/recording", %{"mode" => "off"})
  end

  defp begin(gateway, port) do
    {200, _headers, %{"recording" => %{"state" => "waiting"}}} =
      send_json(port, "PUT", "/api/vehicles/VID-001/recording", %{"mode" => "always"})

    hear(gateway, 1..10)
    eventually(fn -> Recorder.status(gateway, {:vehicle, @key}).frames == 10 end)
    send_json(port, "PUT", "/api/vehicles/VID-001/recording", %{"mode" => "always"})
  end

  test "a link's recording too, and its object says so", %{gateway: gateway, port: port} do
    {:ok, "radio"} = MavRouter.Link.start(gateway, "udpin:127.0.0.1:0", id: "radio")

    assert {200, _headers, %{"recording" => %{"mode" => "armed", "state" => "waiting"}}} =
             send_json(port, "PUT", "/api/links/radio/recording", %{"mode" => "armed"})

    assert %{"mode" => "armed", "state" => "waiting"} =
             eventually(fn ->
               {200, _headers, %{"links" => [link]}} = get(port, "/api/links")
               link["recording"]["mode"] == "armed" && link["recording"]
             end)
  end

  test "invalid requests are refused with what is expected", %{port: port, tmp_dir: dir} do
    File.write!(Path.join(dir, "secret"), "secret")
    File.write!(Path.join(dir, "foreign-20260101T000000Z.tlog"), "secret")

    for {status, method, path, object} <- [
          {404, "POST", "/api/vehicles/VID-009/save", %{}},
          {503, "POST", "/api/vehicles/VID-001/save", %{}},
          {422, "POST", "/api/vehicles/VID-001/save", %{"reason" => 7}},
          {422, "POST", "/api/vehicles/VID-001/save", %{"reason" => String.duplicate("x", 41)}},
          {422, "PUT", "/api/vehicles/VID-001/recording", %{"mode" => "sometimes"}},
          {422, "PUT", "/api/vehicles/VID-001/recording", %{}},
          {404, "PUT", "/api/vehicles/VID-009/recording", %{"mode" => "off"}},
          {404, "PUT", "/api/links/radio/recording", %{"mode" => "always"}},
          {405, "DELETE", "/api/recordings/x.tlog", %{}}
        ] do
      assert {^status, _headers, %{"error" => %{"message" => _}}} = send_json(port, method, path, object)
    end

    for name <- ["secret", "..%2Fsecret", "recordings.index", "foreign-20260101T000000Z.tlog"],
        do: assert({404, _headers, _body} = get(port, "/api/recordings/#{name}"))
  end
end
