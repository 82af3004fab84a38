defmodule Aerie.System.FleetTest do
  @moduledoc "What a plain NATS client sees of a gateway with three flying vehicles."

  use Aerie.SystemCase, async: true

  @moduletag :tmp_dir

  setup %{tmp_dir: folder} do
    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"])
    port = link_port(gateway, "link-1")
    conn = nats_client(gateway)
    %{gateway: gateway, port: port, conn: conn}
  end

  test "a client of fleet.> sees each vehicle's state at the configured rate, and its events", context do
    {:ok, _subscription} = Gnat.sub(context.conn, self(), "fleet.>")

    start_supervised!(
      {SimVehicle.Fleet, count: 3, link: "udpout:127.0.0.1:#{context.port}", ready_s: 1.0, speed: 2.0}
    )

    seen = collect(%{}, fn seen -> complete?(seen) end)

    for name <- ["VID-001", "VID-002", "VID-003"] do
      positions = Enum.reverse(located(seen, name))
      assert length(positions) >= 5

      for position <- positions do
        assert %{"vehicle" => ^name, "group" => "position", "data" => data} = position
        assert data["lat"] > 47.3 and data["lat"] < 47.5
        assert is_number(data["alt_rel"])
      end

      # No more than one a second (the default of position_hz), by the times in the messages.
      gaps = gaps(positions)
      assert Enum.sum(gaps) / length(gaps) > 800

      for type <- ["armed", "takeoff"] do
        assert [%{"vehicle" => ^name, "type" => ^type, "id" => id, "seq" => seq} | _] =
                 seen[{name, "event." <> type}]

        assert is_binary(id) and is_integer(seq)
      end
    end
  end

  test "the stream keeps the last value of each state group and every event once", context do
    start_supervised!(
      {SimVehicle.Fleet, count: 2, link: "udpout:127.0.0.1:#{context.port}", ready_s: 1.0, speed: 4.0}
    )

    eventually(
      fn -> context.conn |> stream_events() |> Enum.count(&(&1["type"] == "takeoff")) >= 2 end,
      "both took off"
    )

    events = stream_events(context.conn)
    assert events |> Enum.map(& &1["id"]) |> Enum.uniq() |> length() == length(events)

    for {_vehicle, events} <- Enum.group_by(events, & &1["vehicle"]) do
      assert Enum.map(events, & &1["seq"]) == Enum.to_list(1..length(events))
    end

    %{state: %{num_subjects: subjects, messages: messages}} =
      jetstream(fn -> Gnat.Jetstream.API.Stream.info(context.conn, "FLEET_STATE") end)

    assert messages == subjects
  end

  test "HTTP shows health, readiness and metrics of the same gateway", context do
    start_supervised!(
      {SimVehicle.Fleet, count: 1, link: "udpout:127.0.0.1:#{context.port}", ready_s: 1.0, fly: false}
    )

    port = Aerie.Api.Endpoint.port(context.gateway)
    eventually(fn -> Store.vehicle(context.gateway, "VID-001") end, "the vehicle is known")

    assert {200, %{"status" => "ok"}} = get_json(port, "/healthz")

    # While the machine is too busy for the frames, it is not ready.
    eventually(
      fn ->
        match?({200, %{"status" => "ready", "nats" => %{"connected" => true}}}, get_json(port, "/readyz"))
      end,
      "it is ready"
    )

    for line <- [
          ~s(gateway_nats_messages_published_total{subject="state.position"}),
          ~s(gateway_mavlink_messages_received_total{type="heartbeat"}),
          ~s(gateway_mavlink_parse_errors_total 0),
          ~s(gateway_link_up{link="link-1",network="main"} 1),
          ~s(gateway_vehicle_online{vehicle="VID-001"} 1),
          ~s(gateway_vehicle_armed{vehicle="VID-001"} 0),
          ~s(gateway_nats_connected 1)
        ] do
      eventually(
        fn ->
          {200, text} = get(port, "/metrics")
          text =~ line
        end,
        line
      )
    end

    assert {404, _text} = get(port, "/nothing")
    assert {405, _text} = request(:post, port, "/metrics")
  end

  defp complete?(seen) do
    Enum.all?(["VID-001", "VID-002", "VID-003"], fn name ->
      regular?(located(seen, name)) and
        Map.has_key?(seen, {name, "event.armed"}) and Map.has_key?(seen, {name, "event.takeoff"})
    end)
  end

  # The last five came about once a second. A vehicle that is simulated on a busy machine is late now and then.
  defp regular?(newest_first) do
    gaps = newest_first |> Enum.take(5) |> Enum.reverse() |> gaps() |> Enum.sort()
    length(gaps) == 4 and Enum.at(gaps, 2) < 2_000
  end

  defp gaps(messages), do: for([a, b] <- Enum.chunk_every(times(messages), 2, 1, :discard), do: b - a)

  # Before its first GPS fix a vehicle reports no latitude: null.
  defp located(seen, name),
    do: for(%{"data" => %{"lat" => lat}} = one <- seen[{name, "state.position"}] || [], lat != nil, do: one)

  defp collect(seen, done?) do
    if done?.(seen) do
      seen
    else
      receive do
        {:msg, %{topic: "fleet.test." <> rest, body: body}} ->
          [vehicle, what] = String.split(rest, ".", parts: 2)
          collect(Map.update(seen, {vehicle, what}, [JSON.decode!(body)], &[JSON.decode!(body) | &1]), done?)
      after
        Aerie.Patience.ms() -> flunk("never complete; seen: #{inspect(Map.keys(seen))}")
      end
    end
  end

  defp times(messages) do
    for message <- messages do
      {:ok, time, 0} = DateTime.from_iso8601(message["time"])
      DateTime.to_unix(time, :millisecond)
    end
  end

  defp get(port, path), do: request(:get, port, path)

  defp get_json(port, path) do
    {status, body} = get(port, path)
    {status, JSON.decode!(body)}
  end

  defp request(method, port, path) do
    url = ~c"http://127.0.0.1:#{port}#{path}"
    headers = [{~c"connection", ~c"close"}]
    request = if method == :get, do: {url, headers}, else: {url, headers, ~c"text/plain", ""}

    {:ok, {{_version, status, _reason}, _headers, body}} =
      http(method, request)

    {status, body}
  end
end
