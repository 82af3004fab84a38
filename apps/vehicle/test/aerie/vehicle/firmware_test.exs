defmodule Aerie.Vehicle.FirmwareTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Firmware

  test "a firmware is known by its number in MAV_AUTOPILOT, or by the name of its vendor" do
    assert for(number <- [3, 12, 0, 99], do: Firmware.heard(number)) ==
             [:ardupilot, :px4, :generic, :generic]

    assert for(name <- ["Betaflight", "iNav", "PX4", ""], do: Firmware.vendor(name)) ==
             [:betaflight, :inav, :generic, :generic]
  end

  test "a heartbeat without a number takes nothing from what a vendor's name has told" do
    assert for(known <- Firmware.names(), do: Firmware.heard(0, known)) ==
             [:generic, :generic, :betaflight, :inav]

    assert for(known <- Firmware.names(), do: Firmware.heard(12, known)) == List.duplicate(:px4, 4)
  end

  test "each has a name for people, and one that texts may have" do
    assert Enum.map(Firmware.names(), &Firmware.title/1) == ~w(ArduPilot PX4 Betaflight iNav)
    assert Firmware.title(:generic) == "unknown firmware"
    assert Enum.sort(Map.keys(Firmware.by_text())) == ~w(ardupilot betaflight generic inav px4)
  end
end
