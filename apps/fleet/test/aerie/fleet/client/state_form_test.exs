defmodule Aerie.Fleet.Client.StateFormTest do
  use ExUnit.Case, async: true

  import Aerie.ClientCase, only: [vehicle: 0, vehicle: 1]

  alias Aerie.Fleet.Client.StateForm

  defp json(vehicle, links \\ %{}, now \\ System.os_time(:microsecond)),
    do: vehicle |> StateForm.of(links, now) |> JSON.encode!() |> JSON.decode!()

  test "has the fields of the documented form, in its units" do
    vehicle = vehicle()

    links = %{
      "radio" => %{
        id: "radio",
        url: "/dev/ttyS0,921600",
        spec: %{kind: :serial, device: "/dev/ttyS0", baud: 921_600}
      }
    }

    object = json(vehicle, links, vehicle.last_heard + 250_000)

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

  test "while there is no vehicle, one line says that nothing is connected" do
    line = StateForm.lines([], [%{id: "radio", url: "udpin::14550", kind: :udp_server}], 1_500_000)
    assert String.ends_with?(line, "\n")
    object = JSON.decode!(line)

    assert %{"fc_connected" => false, "vehicle" => nil, "timestamp" => 1.5, "status" => nil, "armed" => nil} =
             object

    assert Map.keys(object) == Map.keys(json(vehicle()))
  end

  test "lines: one for each vehicle" do
    remote = StateForm.lines([vehicle(%{id: "VID-003", via: "gateway-VID-003", links: []})], [], 0)
    assert %{"via" => "gateway-VID-003", "age" => age} = JSON.decode!(remote)
    assert is_number(age)
    assert %{"via" => nil} = JSON.decode!(StateForm.lines([vehicle()], [], 0))
    lines = StateForm.lines([vehicle(), vehicle(%{id: "VID-002"})], [], 0)
    assert String.ends_with?(lines, "\n")
    assert [one, two] = String.split(lines, "\n", trim: true)
    assert %{"vehicle" => "VID-001"} = JSON.decode!(one)
    assert %{"vehicle" => "VID-002"} = JSON.decode!(two)
  end
end
