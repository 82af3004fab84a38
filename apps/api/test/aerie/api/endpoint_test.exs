defmodule Aerie.Api.EndpointTest do
  @moduledoc "A gateway without NATS, a vehicle that is a UDP socket, and the HTTP face as a client sees it."

  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]

  alias Aerie.Base.Json.Object
  alias Aerie.Base.Store
  alias MavCodec.Messages

  setup do
    gateway = make_ref()

    config = %{
      http: %{port: 0},
      websocket: %{port: 0},
      links: [%{id: "radio", url: "udpin:127.0.0.1:0", enabled: true}],
      timeouts: %{vehicle_stale_s: 60.0, vehicle_lost_s: 120.0}
    }

    Aerie.GatewayCase.start_gateway(config, name: gateway, with: [:bridge, :router, :links])
    Aerie.APICase.start_endpoint(gateway, config)
    %{gateway: gateway, port: Aerie.Api.Endpoint.port(gateway)}
  end

  test "a gateway without NATS by configuration is ready; the report lists its links", context do
    assert {200, %{"status" => "ok"}} = json(context.port, "/healthz")
    eventually(fn -> match?(%{status: :up}, Store.link(context.gateway, "radio")) end)

    # Its own loops have answered for the first time.
    {200, report} = eventually(fn -> with {503, _report} <- json(context.port, "/readyz"), do: false end)
    assert %{"status" => "ready", "nats" => %{"connected" => false}, "vehicles" => 0} = report
    assert [%{"id" => "radio", "status" => "up", "text" => "listening" <> _}] = report["links"]
  end

  test "without NATS a restart can also be seen: an epoch in the status and in events, and gateway.started",
       context do
    event = Aerie.Vehicle.Event.new("VID-001", "armed", 1, 1_763_800_000_000_000, nil, %{"mode" => "AUTO"})
    Aerie.Vehicle.Events.Journal.commit(context.gateway, "VID-001", 1, [event])
    assert {200, %{"epoch" => epoch}} = json(context.port, "/api/status")
    assert_in_delta epoch, System.os_time(:millisecond), 300_000
    assert {200, %{"events" => shown}} = json(context.port, "/api/events")
    assert [%{"type" => "armed", "seq" => 1}, %{"type" => "gateway.started", "seq" => 1} = started] = shown
    assert Enum.map(shown, & &1["epoch"]) == [epoch, epoch]
    assert %{"previous_epoch" => nil, "ended" => nil, "vehicles" => []} = started["data"]
  end

  test "a link that drops datagrams makes the gateway unready, with its name and what to do",
       context do
    link = eventually(fn -> link_with_port(context.gateway) end)
    overload = %{since: 1_700_000_000_000_000, datagrams: 12}
    counters = %{link.counters | kernel_dropped: 5, shed: 7}
    busy = %{link | id: "busy", overload: overload, counters: counters}
    Store.put_link(context.gateway, "busy", busy)

    {_, [problem]} =
      eventually(fn ->
        with {503, %{"status" => "not ready", "problems" => [_one] = problems}} <-
               json(context.port, "/readyz"),
             do: {503, problems},
             else: (_starting -> false)
      end)

    assert problem =~ "link busy dropped 12 datagrams since 2023-11-14T22:13:20"
    assert problem =~ "more CPU"
    {200, text} = get(context.port, "/metrics")
    assert text =~ ~r/gateway_link_overloaded\{link="busy".*\} 1\n/
    assert text =~ ~r/gateway_link_overloaded\{link="radio".*\} 0\n/
    assert text =~ ~r/gateway_link_dropped_total\{link="busy".*reason="kernel_dropped"\} 5\n/
    assert text =~ ~r/gateway_link_dropped_total\{link="busy".*reason="shed"\} 7\n/

    Store.put_link(context.gateway, "busy", %{busy | overload: nil})
    # On a busy machine its own loops are late for a moment.
    eventually(fn ->
      match?({200, %{"status" => "ready", "problems" => []}}, json(context.port, "/readyz"))
    end)
  end

  test "a session that does not keep up, and datagrams of clients that nobody read, make it unready",
       context do
    link = eventually(fn -> link_with_port(context.gateway) end)
    eventually(fn -> match?({200, _report}, json(context.port, "/readyz")) end)
    since = 1_700_000_000_000_000
    Store.put_link(context.gateway, "slow", %{link | id: "slow", behind: %{since: since, frames: 8}})
    counters = %{link.counters | kernel_dropped: 5, shed: 7}
    client = %{link | id: "gcs", overload: %{since: since, datagrams: 12}, counters: counters}
    MavRouter.Client.put_link(context.gateway, "gcs", client, [])

    # Its own loops, late on a busy machine, would be further problems.
    %{"problems" => problems, "links" => links} =
      eventually(fn ->
        with {503, %{"problems" => [_, _]} = report} <- json(context.port, "/readyz"),
             do: report,
             else: (_more -> nil)
      end)

    assert [frames, datagrams] = Enum.sort_by(problems, &(&1 =~ "gcs"))
    assert frames =~ "link slow dropped 8 frames since 2023-11-14T22:13:20"
    assert datagrams =~ "client endpoint gcs dropped 12 datagrams since 2023-11-14T22:13:20"
    assert %{"behind" => %{"frames" => 8}} = Enum.find(links, &(&1["id"] == "slow"))

    {200, text} = get(context.port, "/metrics")
    assert text =~ ~r/gateway_link_behind\{link="slow".*\} 1\n/
    assert text =~ ~r/gateway_link_behind\{link="radio".*\} 0\n/
    assert text =~ ~s(gateway_client_unread_datagrams{reason="kernel_dropped"} 5\n)
    assert text =~ ~s(gateway_client_unread_datagrams{reason="shed"} 7\n)
    assert text =~ "gateway_client_endpoints_overloaded 1\n"
    assert %{conditions: conditions} = Aerie.Api.Rest.View.diagnosis(context.gateway)
    assert Enum.any?(conditions, &match?(%{name: :overload, id: "gcs"}, &1))
  end

  test "a missing gateway is unready, and the report names the missing parts", context do
    stop_supervised!({Aerie.Gateway, context.gateway})
    assert {503, %{"status" => "not ready", "parts" => %{"store" => false}}} = json(context.port, "/readyz")
    assert {200, text} = get(context.port, "/metrics")
    assert text =~ "gateway_vehicles 0"
  end

  test "metrics of a vehicle, and of garbage", context do
    heartbeat = %Messages.Heartbeat{type: 2, autopilot: 3, base_mode: 209, custom_mode: 4, system_status: 4}
    battery = %Messages.SysStatus{voltage_battery: 12_600, current_battery: 100, battery_remaining: 87}
    bytes = for message <- [heartbeat, battery], do: MavCodec.encode(message, system: 7)
    <<first::binary-size(15), _byte, rest::binary>> = MavCodec.encode(heartbeat, system: 7)

    %{port: radio} = eventually(fn -> link_with_port(context.gateway) end)
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}])

    for datagram <- bytes ++ [first <> <<99>> <> rest],
        do: :ok = :gen_udp.send(socket, {127, 0, 0, 1}, radio, datagram)

    text =
      eventually(fn ->
        {200, text} = get(context.port, "/metrics")

        # The link is measured once a second.
        if text =~ "gateway_mavlink_parse_errors_total 1" and text =~ "gateway_vehicle_battery_volts" and
             text =~ "gateway_link_score",
           do: text
      end)

    for line <- [
          ~s(gateway_mavlink_messages_received_total{type="heartbeat"} 1),
          ~s(gateway_mavlink_messages_received_total{type="sys_status"} 1),
          ~s(gateway_link_up{link="radio",network="main"} 1),
          ~s(gateway_link_peers{link="radio",network="main"} 1),
          ~s(gateway_link_score{link="radio",network="main"}),
          ~s(gateway_link_crc_errors_total{link="radio",network="main"} 1),
          ~s(gateway_link_dropped_total{link="radio",network="main",reason="overload"} 0),
          ~s(gateway_vehicle_armed{vehicle="VID-007"} 1),
          ~s(gateway_vehicle_high_latency{vehicle="VID-007"} 0),
          ~s(gateway_vehicle_collision{vehicle="VID-007"} 0),
          ~s(gateway_vehicle_streams_wanting{vehicle="VID-007"} 0),
          ~s(gateway_vehicle_battery_ratio{vehicle="VID-007"} 0.87),
          ~s(gateway_vm_memory_bytes{kind="total"})
        ] do
      assert text =~ line
    end

    # Every line is a comment or name, labels and a number: what a scraper takes.
    for line <- String.split(text, "\n", trim: true) do
      assert line =~ ~r/^(# (HELP|TYPE) |[a-z_]+(\{([a-z_]+="[^"]*",?)+\})? -?[0-9.e+-]+$)/
    end
  end

  test "a link has exactly the fields of docs/telemetry.md, rounded", context do
    eventually(fn ->
      {200, %{"links" => [link]}} = json(context.port, "/api/links")

      if is_map(link["quality"]) do
        schema = MavRouter.Link.fields() |> Object.schema() |> JSON.encode!() |> JSON.decode!()
        assert Aerie.JsonSchemaCheck.errors(schema, link, %{}, closed: true) == []
        score = link["quality"]["score"]
        assert score == Float.round(score, 1)
      end
    end)
  end

  test "the armed metric of a lost vehicle is absent", context do
    mode = %{at: 1, time_boot_ms: nil, data: %{armed: true, in_air: true}}
    vehicle = %Aerie.Vehicle.Snapshot{id: "V", groups: %{mode: mode}, status: :online}
    Store.put_vehicle(context.gateway, {"main", 9}, vehicle)
    {200, text} = get(context.port, "/metrics")

    assert text =~ ~s(gateway_vehicle_armed{vehicle="V"} 1) and
             text =~ ~s(gateway_vehicle_in_air{vehicle="V"} 1)

    Store.put_vehicle(context.gateway, {"main", 9}, %{vehicle | status: :lost})
    {200, text} = get(context.port, "/metrics")
    refute text =~ ~s(gateway_vehicle_armed{) or text =~ ~s(gateway_vehicle_in_air{)
    assert text =~ ~s(gateway_vehicle_online{vehicle="V"} 0)
  end

  test "an unknown page and a wrong method say what exists", context do
    assert {200, index} = get(context.port, "/")
    assert index =~ "/metrics"
    assert {404, text} = get(context.port, "/secret/../x")
    assert text =~ "/readyz"

    {:ok, {{_, 405, _}, headers, _}} =
      :httpc.request(:post, {url(context.port, "/metrics"), [], ~c"text/plain", "x"}, [], [])

    assert {~c"allow", ~c"GET, HEAD"} in headers
  end

  test "options are checked", context do
    assert_raise ArgumentError, fn -> Aerie.Api.Endpoint.start_link(gateway: context.gateway, prot: 1) end
  end

  defp link_with_port(gateway) do
    case Store.link(gateway, "radio") do
      %{port: port} = link when is_integer(port) -> link
      _not_yet -> nil
    end
  end

  defp get(port, path) do
    {:ok, {{_version, status, _reason}, _headers, body}} =
      :httpc.request(:get, {url(port, path), [{~c"connection", ~c"close"}]}, [], body_format: :binary)

    {status, body}
  end

  defp json(port, path) do
    {status, body} = get(port, path)
    {status, JSON.decode!(body)}
  end

  defp url(port, path), do: ~c"http://127.0.0.1:#{port}#{path}"
end
