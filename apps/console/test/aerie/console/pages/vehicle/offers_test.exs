defmodule Aerie.Console.Pages.Vehicle.OffersTest do
  @moduledoc "What a vehicle's page offers is what the policy and the firmware allow this user."
  use Aerie.VehiclePageCase, async: true

  alias Aerie.Control.CommandExecutor.Offers
  alias Aerie.Control.Commands
  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.Users

  @modes %{0 => "ACRO", 1 => "ANGLE", 46 => "GPS RESCUE"}
  @parked [mode: %{mode: "ACRO", armed: false, in_air: false, landed_state: "ON_GROUND"}]

  defp msp(console, autopilot, fields \\ %{}, mode \\ []) do
    memory = %{sources: %{}, mode_names: @modes}

    put(
      console,
      [mode: Map.merge(@parked[:mode], Map.new(mode))],
      Map.merge(%{autopilot: autopilot, firmware: "4.5.5", memory: memory}, fields)
    )
  end

  defp buttons(view),
    do: Regex.scan(~r/id="action-([a-z-]+)"/, render(view)) |> Enum.map(&List.last/1) |> Enum.sort()

  test "Betaflight: nothing that needs a permission which no role includes, and the page says which", %{
    console: console
  } do
    msp(console, :betaflight)

    for role <- [:operator, :admin] do
      view = open(console, role)
      assert buttons(view) == []
      refute has_element?(view, ".fly-aim")
      assert has_element?(view, ".locked", "Arm, Set mode need the permission receiver")
      assert has_element?(view, ".locked", "Return needs the permission receiver")
      # It says itself that it has no such mode.
      refute has_element?(view, ".locked", "Hold")
      assert has_element?(view, ".vehicle-head", "Betaflight 4.5.5")
    end

    assert [] = console |> open(:viewer) |> buttons()
    msp(console, :betaflight, %{}, armed: true)
    # The one button is there, and disarms.
    view = open(console)
    assert ["arm"] = buttons(view)
    assert has_element?(view, "#action-arm[phx-value-type=disarm]", "Disarm")
  end

  test "a user who was given the permission has the buttons", %{console: console} do
    msp(console, :betaflight)
    assert :ok = Users.set_permissions(console.gateway, "operator", ["receiver"])
    view = open(console)
    assert buttons(view) == ~w(arm mode rtl)
    refute has_element?(view, ".locked")
    give(view, "arm", "a1")
    answer(executing(%{id: "a1", type: "arm"}), "a1", :completed)
  end

  test "iNav: what needs no channels is offered", %{console: console} do
    msp(console, :inav)
    view = open(console)
    assert has_element?(view, ".vehicle-head", "iNav 4.5.5")
    assert has_element?(view, ".fly-aim", "Go to…")
    assert buttons(view) == []
  end

  test "the calibrations are those of the firmware", %{console: console} do
    for {autopilot, sensors} <- [
          betaflight: ~w(accelerometer magnetometer),
          px4: ~w(gyro esc rc),
          ardupilot: ~w(gyro compass_motor)
        ],
        all = ~w(accelerometer magnetometer gyro barometer airspeed level esc rc compass_motor) do
      msp(console, autopilot)
      view = open(console, :admin, "/vehicles/VID-007/health")
      shown = for sensor <- all, has_element?(view, "#calibrate-#{sensor}"), do: sensor
      assert sensors -- shown == [], "#{autopilot}: #{inspect(shown)}"
      if autopilot == :betaflight, do: assert(shown == sensors)
      assert has_element?(view, "#calibrate-cancel") == (autopilot != :betaflight)
    end
  end

  test "a rover takes no take-off and no landing", %{console: console} do
    put(console, @parked, %{vehicle_type: "rover"})
    view = open(console)
    refute "takeoff" in buttons(view)
    refute "land" in buttons(view)
    assert "arm" in buttons(view)
  end

  test "only modes that the vehicle has are in the list", %{console: console} do
    put(console, @parked, %{autopilot: :ardupilot})
    view = open(console)
    assert has_element?(view, "#mode-choice option", "GUIDED")
    refute has_element?(view, "#mode-choice option", "AUTO_LOITER")
  end

  # The one function and the policy's answer to the whole command agree, for each type that needs no parameters.
  test "whatever is offered is not refused for a permission or a gap, and the other way round", %{
    console: console
  } do
    for autopilot <- [:ardupilot, :px4, :betaflight, :inav, :generic],
        kind <- ["copter", "rover"],
        {role, permissions} <- [operator: [], admin: [], operator: [:receiver, :motors], viewer: []] do
      msp(console, autopilot, %{vehicle_type: kind})
      vehicle = Aerie.Base.Store.vehicle(console.gateway, "VID-007")
      user = Roles.principal(:user, "ann", role, permissions)

      for %{name: name, params: params} <- Aerie.Vehicle.Command.Types.all(),
          not Enum.any?(params, & &1.required) do
        lacks = Offers.lacks(vehicle, name, user)
        check = Commands.check(console.gateway, vehicle: "VID-007", type: name, as: user)

        case lacks do
          nil ->
            refute match?({:deny, :role, _reason}, check),
                   "#{autopilot} #{kind} #{role} #{name}: #{inspect(check)}"

          _reason ->
            assert elem(check, 0) in [:deny, :error],
                   "#{autopilot} #{kind} #{role} #{name}: #{inspect(check)}"
        end
      end
    end
  end
end
