defmodule Aerie.Vehicle.Snapshot.FieldsTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Snapshot

  @now 1_763_800_000_000_000

  # A hovering copter.
  defp vehicle(changes \\ %{}) do
    group = fn data -> %{at: @now, time_boot_ms: 1000, data: data} end

    snapshot = %Snapshot{
      id: "VID-001",
      key: {"main", 1},
      network: "main",
      system_id: 1,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      status: :online,
      last_heard: @now,
      links: ["radio"],
      groups: %{
        mode: group.(%{mode: "GUIDED", armed: true, in_air: true}),
        attitude: group.(%{roll: 1.234567, pitch: -0.5, yaw: 178.5}),
        position:
          group.(%{lat: 12.97161234567, lon: 77.5946, alt_msl: 920.0, alt_rel: 10.25, heading: 178.5}),
        velocity: group.(%{groundspeed: 3.21, airspeed: nil, climb: -0.1}),
        battery: group.(%{voltage: 22.8, current: 0.5, remaining: 0.98}),
        gps: group.(%{fix: 3, satellites: 14, hdop: 0.9})
      }
    }

    struct!(snapshot, changes)
  end

  defp json(vehicle, links \\ %{}, now \\ @now),
    do: vehicle |> Snapshot.Fields.show(:short, %{now: now, links: links}) |> JSON.encode!() |> JSON.decode!()

  test "has the fields of the documented form, in its units" do
    vehicle = vehicle()

    links = %{
      "radio" => %{
        id: "radio",
        url: "/dev/ttyS0,921600",
        spec: %{kind: :serial, device: "/dev/ttyS0", baud: 921_600}
      }
    }

    object = json(vehicle, links, @now + 250_000)

    assert %{
             "fc_connected" => true,
             "fc_port" => "/dev/ttyS0",
             "fc_baud" => 921_600,
             "armed" => true,
             "mode" => "GUIDED",
             "attitude" => %{"roll" => 1.23, "pitch" => -0.5, "yaw" => 178.5},
             "position" => %{"lat" => 12.9716123, "lon" => 77.5946, "alt_msl" => 920.0, "alt_rel" => 10.25},
             "velocity" => %{"groundspeed" => 3.21, "airspeed" => nil},
             "battery" => %{"voltage" => 22.8, "current" => 0.5, "remaining" => 0.98},
             "gps" => %{"fix" => 3, "satellites" => 14, "hdop" => 0.9},
             "vehicle" => "VID-001",
             "status" => "online",
             "age" => 0.25
           } = object

    assert_in_delta object["timestamp"], vehicle.last_heard / 1_000_000, 1.0
    assert object["ages"] == Map.new(~w(attitude position velocity battery gps), &{&1, 0.25})
  end

  test "a port that was found by listening is named with the rate at which it was" do
    spec = %{kind: :serial, detect: :port, device: nil, baud: 115_200}
    found = %{id: "radio", kind: :serial, url: "serial:auto", local: "/dev/ttyACM1", baud: 57_600, spec: spec}
    object = json(vehicle(), %{"radio" => found})
    assert %{"fc_port" => "/dev/ttyACM1", "fc_baud" => 57_600} = object
  end

  test "a recorded vehicle's ages are those in the recording" do
    vehicle = vehicle()

    replay = %{
      id: "radio",
      kind: :replay,
      url: "replay:x",
      last_heard: vehicle.last_heard + 500_000,
      spec: %{kind: :replay, recorded: true}
    }

    object = json(vehicle, %{"radio" => replay}, vehicle.last_heard + 86_400_000_000)
    assert object["age"] == 0.5
    assert object["ages"]["attitude"] == 0.5
  end

  test "a vehicle of which nothing is known but that it spoke has all fields, null" do
    object = json(vehicle(%{groups: %{}, links: [], last_heard: nil, status: :lost}))
    assert object["fc_connected"] == false
    assert object["fc_port"] == nil
    assert object["age"] == nil

    assert object["position"] == %{
             "lat" => nil,
             "lon" => nil,
             "alt_msl" => nil,
             "alt_rel" => nil,
             "heading" => nil
           }

    assert Map.keys(object) -- Map.keys(json(vehicle())) == []
  end

  test "values that JSON has no form for become null, and invalid text valid text" do
    odd = %{mode: <<"A", 0xFF>>, armed: nil, in_air: nil}
    attitude = %{roll: :nan, pitch: :infinity, yaw: {:nan, 1}}
    groups = %{mode: %{at: 1, data: odd}, attitude: %{at: 1, data: attitude}}
    object = json(vehicle(%{groups: groups}))
    assert object["attitude"] == %{"roll" => nil, "pitch" => nil, "yaw" => nil}
    assert String.valid?(object["mode"])
  end

  test "a snapshot of no vehicle has all fields, null" do
    object = json(%Snapshot{}, %{"radio" => %{id: "radio", url: "udpin::14550"}}, 1_500_000)

    assert %{"fc_connected" => false, "vehicle" => nil, "timestamp" => 1.5, "status" => nil, "armed" => nil} =
             object

    assert Map.keys(object) == Map.keys(json(vehicle()))
  end

  test "the gateway by which a vehicle is reached is named" do
    assert %{"via" => "gateway-VID-003", "age" => age} =
             json(vehicle(%{id: "VID-003", via: "gateway-VID-003", links: []}))

    assert is_number(age)
    assert %{"via" => nil} = json(vehicle())
  end
end
