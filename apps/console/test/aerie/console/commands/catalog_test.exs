defmodule Aerie.Console.Commands.CatalogTest do
  use ExUnit.Case, async: true

  alias Aerie.Console.Commands.Catalog

  @copter %Aerie.Vehicle.Snapshot{
    id: "V-1",
    system_id: 1,
    autopilot: :px4,
    vehicle_type: "copter",
    groups: %{}
  }
  @operator %{name: "ann", role: :operator, permissions: []}

  defp names(groups), do: for({_title, entries} <- groups, entry <- entries, do: entry.type.name)

  test "a gap has its reason, and so has what the user may not" do
    assert %{gap: "PX4 has no relays"} = Catalog.entry("relay", @copter, @operator)
    assert %{gap: nil, denied: nil, title: "Take off"} = Catalog.entry("takeoff", @copter, @operator)

    assert %{denied: "terminate needs the permission terminate" <> _} =
             Catalog.entry("terminate", @copter, @operator)

    assert %{denied: denied} =
             Catalog.entry("land", @copter, %{@operator | role: :viewer, permissions: [:fly]})

    assert is_binary(denied)
    assert nil == Catalog.entry("no_such", @copter, @operator)
  end

  test "what is locked is said once for each permission, in the words of the buttons" do
    betaflight = %{@copter | autopilot: :betaflight}
    buttons = [{"arm", "Arm"}, {"hold", "Hold"}, {"goto", "Click to go"}, {"force_disarm", "Force disarm"}]

    assert [
             "Arm, Hold need the permission receiver. An admin gives it to a user in Settings.",
             "Force disarm needs the permission force_disarm. An admin gives it to a user in Settings."
           ] = Catalog.locked(buttons, betaflight, @operator)

    assert [] = Catalog.locked(buttons, betaflight, %{@operator | permissions: [:receiver, :force_disarm]})
  end

  test "a search finds name, group and meaning; groups without a hit are left out" do
    assert "takeoff" in names(Catalog.groups(@copter, @operator, "take off"))
    assert ["gripper"] == names(Catalog.groups(@copter, @operator, "gripper open"))
    assert "calibrate" in names(Catalog.groups(@copter, @operator, "MAINTENANCE sensor"))
    assert [] == Catalog.groups(@copter, @operator, "nothing of the kind")
    assert length(names(Catalog.groups(@copter, @operator, " "))) > 40
  end
end
