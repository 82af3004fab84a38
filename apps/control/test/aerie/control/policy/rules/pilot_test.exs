defmodule Aerie.Control.Policy.Rules.PilotTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, Mavlink, Roles}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Intent.Protection
  alias MavCodec.Messages, as: M

  @vehicle %{autopilot: :ardupilot, vehicle_type: "copter", component: 1}
  @aloft %{
    position: %{lat: 47.001, lon: 8.001, alt_rel: 20.0, alt_msl: 520.0, heading: 90.0},
    home: %{lat: 47.001, lon: 8.0005, alt_msl: 500.0},
    mode: %{mode: "GUIDED", armed: true, in_air: true}
  }

  defp decide(message, source, section \\ %{}) do
    {:ok, policy} = Policy.compile(section)
    facts = if is_struct(message, Intent), do: message, else: Mavlink.facts(message, @vehicle)

    Policy.decide(policy, facts, %{
      Context.new(@aloft, source, 0)
      | autopilot: :ardupilot,
        vehicle_type: "copter"
    })
  end

  defp role(role, permissions \\ []), do: Roles.principal(:client, "p", role, permissions)
  defp set(name, value), do: %M.ParamSet{param_id: name, param_value: value, param_type: 9}
  defp home, do: %M.CommandLong{command: 179, param5: 47.0011, param6: 8.0011, param7: 500.0}

  test "a role between operator and admin, and a permission for an operator" do
    assert Roles.all() == [:viewer, :operator, :pilot, :admin]
    for {more, least} <- [pilot: :operator, admin: :pilot], do: assert(Roles.at_least?(more, least))
    refute Roles.at_least?(:operator, :pilot)
    assert Roles.permissions(:pilot) -- Roles.permissions(:operator) == [:pilot]
    assert Roles.permissions(:pilot) -- Roles.permissions(:admin) == []
    assert {:ok, :pilot} = Roles.parse("pilot")

    for section <- [%{role: :pilot}, %{role: :operator, permissions: [:pilot]}] do
      listed = Map.merge(%{id: "tablet", permissions: []}, section)
      {:ok, policy} = Policy.compile(%{clients: [listed]})

      origin = %{
        owner: "tablet",
        text: nil,
        principal: nil,
        commands: true,
        local: false,
        side: :client,
        auto: false
      }

      assert decide(set("RTL_ALT", 3_000.0), Policy.principal(policy, origin)) == :allow
    end
  end

  test "every parameter of a pilot has bounds, and none of them protects the vehicle" do
    for {name, least, most, _unit, _meaning} <- MavCodec.Meaning.Pilot.all() do
      refute Protection.parameter?(name)
      assert least > 0 and most > least

      for value <- [least, most], do: assert(decide(set(name, value / 1), role(:pilot)) == :allow, name)

      for value <- [least * 0.9, most * 1.1, 0.0, -1.0, :nan, :infinity] do
        assert {:deny, :role, reason} = decide(set(name, value), role(:pilot))
        assert reason =~ "setting #{name} needs the permission maintain ("
      end

      assert {:deny, :role, reason} = decide(set(name, least / 1), role(:operator))
      assert reason =~ "setting #{name} needs the permission maintain or pilot ("
      assert {:deny, :role, _} = decide(set(name, least / 1), role(:viewer, [:pilot]))
    end
  end

  test "everything else of maintain and protection stays closed to a pilot" do
    for message <- [
          set("FENCE_ENABLE", 0.0),
          set("ARMING_CHECK", 0.0),
          set("FS_THR_ENABLE", 0.0),
          set("SYSID_MYGCS", 1.0),
          set("RTL_TYPE", 1.0),
          set("rtl_alt", 3_000.0),
          set("ATC_RAT_RLL_P", 0.1),
          %M.ParamMapRc{param_index: 3},
          Intent.set_parameters([{"RTL_ALT", 3_000}, {"FENCE_ENABLE", 0}]),
          Intent.set_parameters(["RTL_ALT"]),
          %M.CommandLong{command: 207, param1: 0.0},
          %M.CommandLong{command: 246, param1: 1.0},
          %M.CommandLong{command: 400, param1: 1.0, param2: 2_989.0},
          %M.CommandLong{command: 400, param2: 21_196.0},
          %M.CommandLong{command: 185, param1: 1.0},
          %M.SetGpsGlobalOrigin{},
          %M.MissionClearAll{mission_type: 255},
          %M.MissionItemInt{seq: 1, command: 179, frame: 6, x: 470_000_000, y: 80_000_000, autocontinue: 1},
          %M.SerialControl{}
        ],
        do: assert({:deny, _rule, _why} = decide(message, role(:pilot)), inspect(message))
  end

  test "home moves in flight, as far as the limits allow" do
    assert decide(home(), role(:pilot)) == :allow
    assert {:deny, :role, reason} = decide(home(), role(:operator))
    assert reason =~ "set_home needs the permission protection or pilot"
    higher = %{home() | param7: 900.0}
    assert {:deny, :altitude, _} = decide(higher, role(:pilot), %{max_altitude: 100})
  end

  test "heights stay within the policy's limits" do
    assert decide(set("RTL_ALT", 5_000.0), role(:pilot), %{max_altitude: 60}) == :allow
    assert {:deny, :role, reason} = decide(set("RTL_ALT", 9_000.0), role(:pilot), %{max_altitude: 60})
    assert reason =~ "RTL_ALT is the height of the way home"
  end

  test "the vehicle's fence is removed where the policy has no limit that it may stand for" do
    for clear <- [
          %M.MissionClearAll{mission_type: 1},
          %M.MissionCount{mission_type: 1},
          %M.FencePoint{count: 0}
        ] do
      assert decide(clear, role(:pilot)) == :allow
      assert {:deny, :role, _} = decide(clear, role(:operator))

      for limit <- [%{max_altitude: 100}, %{max_altitude_msl: 900}, %{min_altitude: 10}] do
        assert {:deny, :role, reason} = decide(clear, role(:pilot), limit)

        assert reason =~ "removing the fence needs the permission protection (" or
                 is_struct(clear, M.FencePoint)

        assert decide(clear, role(:admin), limit) == :allow
      end
    end
  end

  test "logs are erased by a pilot, and by a maintainer" do
    assert decide(%M.LogErase{}, role(:pilot)) == :allow
    assert decide(%M.LogErase{}, role(:operator, [:maintain])) == :allow
    assert {:deny, :role, reason} = decide(%M.LogErase{}, role(:operator))
    assert reason =~ "erasing the logs needs the permission maintain or pilot"
  end
end
