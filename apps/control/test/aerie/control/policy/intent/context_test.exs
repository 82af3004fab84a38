defmodule Aerie.Control.Policy.Intent.ContextTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.CommandExecutor.Observed
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.{Firmware, Protocol}

  # AUTO with the sub-mode of an external program, as PX4 numbers it.
  @external 0x0B040000

  test "policy and commands know a standard mode by the name that the vehicle gave it (X4)" do
    snapshot = %Aerie.Vehicle.Snapshot{
      key: {"main", 1},
      system_id: 1,
      component: 1,
      autopilot: :px4,
      vehicle_type: "copter",
      groups: %{mode: %{data: %{mode: "POSCTL"}, at: 1}},
      memory: %{mode_names: %{@external => "Soft landing"}, standard_modes: %{"land" => @external}}
    }

    context = Context.of(make_ref(), snapshot, nil, 0)
    assert %{"land" => "Soft landing", "safe_recovery" => "AUTO_RTL"} = context.standard_modes
    vehicle = Observed.vehicle(snapshot, {245, 191})
    command = Aerie.CommandSamples.command("set_mode", %{standard_mode: "land"})

    assert {:ok, [%{confirm: {:mode, ["Soft landing"]}}]} =
             Protocol.plan(Firmware.Px4.Adapter, command, vehicle)
  end
end
