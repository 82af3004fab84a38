defmodule Aerie.Api.Rest.VehicleTest do
  @moduledoc "What `/api` shows of a vehicle: its whole snapshot and its latest events."
  use Aerie.APICase, async: true

  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.Store
  alias Aerie.Vehicle.Event

  @now 1_763_800_000_000_000

  # Parts as the vehicle's session shows them (`Aerie.Vehicle.Session.Core.Services.show/1`).
  defp dealings do
    %{
      streams: %{
        30 => %{state: :ok, wanted: 4.0, asked: nil, measured: 49.98765},
        245 => %{state: :short, wanted: nil, asked: 1, measured: 0.0}
      },
      gcs: %{
        known_by: [255],
        failsafe_gcs: 255,
        failsafe_range: {255, 255},
        heard_gcs: 255,
        last_heard: @now,
        quiet?: true,
        enabled?: nil,
        timeout_s: 5.0,
        params: %{"SYSID_MYGCS" => 255.0},
        stations: [%{system: 255, component: 190, type: 6, via: "tcp-1", last_heard: @now, keeps?: true}],
        by_us?: false,
        withheld?: false
      },
      clock: %{
        offset_us: -1_763_000_000_123_456,
        error_us: 1_500,
        rtt_us: 3_000,
        boot_at: 1_763_000_000_123_456,
        at: @now,
        samples: 5,
        foreign: 0
      },
      reports: %{
        recent: [
          %{
            at: @now,
            boot_ms: 1234,
            component: 1,
            sequence: 7,
            id: "0x01000002",
            name: "commander_gcs_lost",
            severity: 4,
            internal: 4,
            arguments: "ff",
            values: [1, :nan],
            text: nil
          }
        ],
        lost: 2
      },
      high_latency: %{only?: false, links: []},
      time_boot_ms: 99,
      capabilities: 64
    }
  end

  test "a vehicle has streams, ground stations, clock and reports beside its state" do
    %{gateway: gateway, port: port} = start_server()
    put_vehicle(gateway, "VID-001", 1)
    Store.put_vehicle(gateway, {"main", 1}, Map.merge(Store.vehicle(gateway, "VID-001"), dealings()))
    {200, _headers, vehicle} = request(port, "GET", "/api/vehicles/VID-001")

    assert [
             %{
               "id" => 30,
               "message" => "ATTITUDE",
               "wanted_hz" => 4.0,
               "measured_hz" => 49.99,
               "state" => "ok"
             },
             %{"id" => 245, "wanted_hz" => nil, "asked_hz" => 1, "state" => "short"}
           ] = vehicle["streams"]

    assert %{"quiet" => true, "enabled" => nil, "failsafe_range" => [255, 255], "stations" => [station]} =
             vehicle["gcs"]

    assert %{"system" => 255, "keeps" => true, "via" => "tcp-1", "last_heard" => "2025-11-22T" <> _} = station
    assert %{"error_s" => 0.0015, "round_trip_s" => 0.003, "boot" => "2025-11-13T" <> _} = vehicle["clock"]

    assert %{"lost" => 2, "recent" => [%{"name" => "commander_gcs_lost", "values" => [1, nil]}]} =
             vehicle["reports"]

    assert %{"only" => false, "links" => []} = vehicle["high_latency"]
    assert %{"time_boot_ms" => 99, "capabilities" => 64} = vehicle

    # All of it is declared, and nothing that is declared is missing.
    document = Aerie.Api.Rest.OpenAPI.document() |> JSON.encode!() |> JSON.decode!()
    schema = document["components"]["schemas"]["vehicle"]
    assert Aerie.JsonSchemaCheck.errors(schema, vehicle, document, closed: true) == []
  end

  test "unknown ones are null" do
    %{gateway: gateway, port: port} = start_server()
    put_vehicle(gateway, "VID-001", 1)
    assert {200, _headers, vehicle} = request(port, "GET", "/api/vehicles/VID-001")
    for part <- ~w(streams gcs clock reports high_latency), do: assert({part, vehicle[part]} == {part, nil})
  end

  test "numbers are rounded to meaningful decimals" do
    %{gateway: gateway, port: port} = start_server()
    put_vehicle(gateway, "VID-001", 1)
    position = %{at: @now, time_boot_ms: 5, data: %{lat: 47.39774189999998, heading: 90.2170000000073}}
    vehicle = %{Store.vehicle(gateway, "VID-001") | groups: %{position: position}}
    Store.put_vehicle(gateway, {"main", 1}, vehicle)
    {200, _headers, %{"groups" => groups}} = request(port, "GET", "/api/vehicles/VID-001")
    assert groups["position"]["data"] == %{"lat" => 47.3977419, "heading" => 90.22}
    {200, _headers, %{"vehicles" => [short]}} = request(port, "GET", "/api/status")
    assert %{"lat" => 47.3977419, "heading" => 90.22} = short["position"]
  end

  describe "events" do
    setup do
      server = start_server()
      Journal.epoch(server.gateway, 1)

      for vehicle <- ["V-2", "V-1"], seq <- 1..5 do
        event = Event.new(vehicle, "armed", seq, @now + seq * 1_000_000, seq, %{"mode" => "AUTO"})
        Journal.commit(server.gateway, vehicle, seq, [event])
      end

      server
    end

    defp events(port, path) do
      {200, _headers, %{"events" => events, "more" => more}} = request(port, "GET", path)
      {Enum.map(events, &{&1["vehicle"], &1["seq"]}), more}
    end

    test "of all vehicles by their time, in the form of NATS", %{port: port, gateway: gateway} do
      {all, false} = events(port, "/api/events")
      assert all == for(seq <- 1..5, vehicle <- ["V-1", "V-2"], do: {vehicle, seq})
      {200, _headers, %{"events" => [first | _]}} = request(port, "GET", "/api/vehicles/V-1/events")
      [event | _] = Journal.recent(gateway, "V-1")
      assert first == JSON.decode!(Aerie.Fleet.Bridge.Message.event(event, 1))
    end

    test "limit gives the latest ones, since the first ones from then on", %{port: port} do
      assert events(port, "/api/events?limit=1") == {[{"V-2", 5}], true}
      assert events(port, "/api/vehicles/V-1/events?limit=2") == {[{"V-1", 4}, {"V-1", 5}], true}
      since = @now |> div(1_000_000) |> Kernel.+(3)

      assert events(port, "/api/events?limit=3&since=#{since}") ==
               {[{"V-1", 3}, {"V-2", 3}, {"V-1", 4}], true}

      iso = since |> DateTime.from_unix!() |> DateTime.to_iso8601()

      assert events(port, "/api/vehicles/V-2/events?since=#{iso}") ==
               {[{"V-2", 3}, {"V-2", 4}, {"V-2", 5}], false}

      assert events(port, "/api/events?since=#{since + 60}") == {[], false}
    end

    test "a vehicle without events has none, an unknown one is not found", %{
      port: port,
      gateway: gateway
    } do
      put_vehicle(gateway, "V-3", 3)
      assert events(port, "/api/vehicles/V-3/events") == {[], false}
      assert {404, _headers, _error} = request(port, "GET", "/api/vehicles/V-4/events")
    end

    test "invalid parameters are refused, with what is expected", %{port: port} do
      for query <-
            ~w(limit=0 limit=1001 limit=x limit limit= since=yesterday since since=-1 since=1e300 since=nan x=1) do
        assert {^query, {422, _headers, %{"error" => %{"message" => message}}}} =
                 {query, request(port, "GET", "/api/events?" <> query)}

        assert message =~ ~r/(limit|since|x): expected/
      end
    end
  end
end
