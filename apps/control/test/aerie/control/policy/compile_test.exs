defmodule Aerie.Control.Policy.CompileTest do
  @moduledoc "What a policy takes it enforces; the rest it refuses."
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command.Types
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, Rate, Roles}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Firmware.Modes

  @now 1_795_514_400_000_000
  @source %{name: "ops", role: :admin, permissions: Roles.own()}
  @nkey "UDXU4RCSJNZOIQHZNWXHXORDPRTGNJAHAHFRGZNEEJCPQTT2M7NLCNF4"

  defp errors(section) do
    assert {:error, errors} = Policy.compile(section)
    errors
  end

  defp compile(section) do
    assert {:ok, policy} = Policy.compile(section)
    policy
  end

  defp disarmed, do: Context.new(%{mode: %{armed: false, in_air: false}}, @source, @now)

  defp context(mode, autopilot \\ :ardupilot) do
    %{disarmed() | mode: mode, autopilot: autopilot, vehicle_type: "copter"}
  end

  defp set_mode(section, context, mode),
    do: Policy.decide(compile(section), Intent.named("set_mode", mode: mode), context)

  defp facts(type), do: if(type in Intent.raw(), do: raw(type), else: Intent.named(type))
  defp raw(type), do: %Intent{type: type, permission: :fly}

  describe "modes" do
    test "unknown names are refused with a suggestion, wherever they stand" do
      expected = "expected a flight mode of ArduPilot or PX4, or MODE(27) for one by its number, got: "

      for name <- ["ACROO", "", "1", "MODE(X)", "MODE(12345678901)", "AUTO RTL"],
          {modes, path} <- [
            {%{denied: [name]}, "denied"},
            {%{transitions: %{name => ["RTL"]}}, "transitions"},
            {%{transitions: %{"AUTO" => [name]}}, "transitions.AUTO"}
          ] do
        assert [error] = errors(%{modes: modes})
        assert String.starts_with?(error, "policy.modes.#{path}: #{expected}\"#{name}\"")
      end

      assert [error] = errors(%{modes: %{denied: ["acroo"]}})
      assert error =~ ~s|(did you mean "ACRO"?)|
    end

    test "every name that is taken is denied to every firmware that has it" do
      for name <- Modes.names() ++ ["hold", "MODE(27)", "mode(4)"],
          {autopilot, kind, _number} <- Modes.meanings(name) do
        context = %{context("STABILIZE", autopilot) | vehicle_type: kind}
        assert {:deny, :mode, _reason} = set_mode(%{modes: %{denied: [name]}}, context, name)

        # A mode that nobody can name counts as denied as soon as anything is.
        allowed = set_mode(%{modes: %{denied: ["MODE(99)"]}}, context, name)

        assert allowed == :allow or
                 (String.upcase(name) =~ "MODE(" and match?({:deny, :mode, _reason}, allowed))
      end
    end

    test "from one mode there is one list, whichever of its names is used" do
      assert errors(%{modes: %{transitions: %{"AUTO" => ["RTL"], "auto" => ["LAND"]}}}) == [
               "policy.modes.transitions: expected each mode once, got: AUTO twice"
             ]

      # ArduPilot's name for the one, PX4's for the other: for PX4 they are the same mode, so both count.
      section = %{
        modes: %{transitions: %{"LOITER" => ["RTL", "LAND"], "AUTO_LOITER" => ["AUTO_LAND", "ACRO"]}}
      }

      px4 = context("AUTO_LOITER", :px4)
      assert :allow = set_mode(section, px4, "AUTO_LAND")
      assert {:deny, :mode, _reason} = set_mode(section, px4, "AUTO_RTL")
      assert {:deny, :mode, _reason} = set_mode(section, px4, "ACRO")
      assert :allow = set_mode(section, context("LOITER"), "RTL")

      assert {:deny, :mode, reason} =
               set_mode(%{modes: %{transitions: %{"AUTO" => []}}}, context("AUTO"), "RTL")

      assert reason =~ "may change to no other one, not to RTL"
    end

    test "what is denied is denied under another name as well" do
      assert [error] = errors(%{modes: %{denied: ["AUTO_LAND"], transitions: %{"AUTO" => ["AUTO_LAND"]}}})
      assert error =~ "AUTO_LAND, which modes.denied denies"

      assert [_error] =
               errors(%{modes: %{denied: ["FOLLOWME"], transitions: %{"AUTO" => ["AUTO_FOLLOW_TARGET"]}}})

      # LAND is ArduPilot's, too.
      compile(%{modes: %{denied: ["AUTO_LAND"], transitions: %{"AUTO" => ["LAND"]}}})
    end
  end

  test "two entries for the same are refused: one of them would do nothing" do
    gripper = %{types: ["gripper"], in_air: false}

    assert errors(%{conditions: [gripper, %{types: ["arm", "gripper"], armed: true}]}) == [
             "policy.conditions: expected one entry for each command, got: gripper twice"
           ]

    viewer = %{id: nil, role: :viewer, permissions: []}

    assert errors(%{clients: [%{viewer | id: "a"}, viewer, %{viewer | id: "a", role: :admin}, viewer]}) == [
             "policy.clients: expected one entry without an id, for all others, got: 2",
             "policy.clients: expected each id once, got: a twice"
           ]

    source = %{name: "a", nkey: @nkey, role: :operator, permissions: []}

    assert errors(%{sources: [source, %{source | nkey: " " <> @nkey}]}) == [
             "policy.sources: expected each name once, got: a twice",
             "policy.sources: expected each nkey once, got: #{@nkey} twice"
           ]

    assert [%{nkey: @nkey}] = compile(%{sources: [%{source | nkey: @nkey <> " "}]}).sources
  end

  test "each type that conditions, windows and rates take is kept from where it must not be" do
    types = Types.names() ++ Intent.raw()
    monday = [%{from: "00:00", to: "00:01", types: nil, days: nil}]

    for type <- types do
      policy = compile(%{conditions: [%{types: [type], armed: true}]})
      assert {:deny, :condition, _reason} = Policy.decide(policy, facts(type), disarmed()), type

      window = [%{hd(monday) | types: [type]}]
      rate = [%{types: [type], per_minute: 1, burst: 1}]

      if type in Intent.ending() do
        for section <- [%{windows: window}, %{rates: rate}],
            do: assert([_error] = errors(section), type)
      else
        assert {:deny, :window, _reason} = Policy.decide(compile(%{windows: window}), facts(type), disarmed()),
               type

        policy = compile(%{rates: rate})
        assert {:ok, taken} = Rate.take(Rate.new(), policy, "ops", "VID-001", type, 0)
        assert {:deny, :rate, _reason} = Rate.take(taken, policy, "ops", "VID-001", type, 1)
      end
    end
  end
end
