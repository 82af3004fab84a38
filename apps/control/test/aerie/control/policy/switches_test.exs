defmodule Aerie.Control.Policy.SwitchesTest do
  @moduledoc "Channels, axes and buttons of overrides and joysticks: what each of them needs, by the parameters that
  are known of the vehicle."
  use ExUnit.Case, async: true

  import MavCodec.Test.Wire, only: [decoded: 1]

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, Mavlink, Roles}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Services.Switches
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @copter %{autopilot: :ardupilot, vehicle_type: "copter"}
  @plane %{autopilot: :ardupilot, vehicle_type: "plane"}
  @rover %{autopilot: :ardupilot, vehicle_type: "rover"}
  @sub %{autopilot: :ardupilot, vehicle_type: "sub"}
  @px4 %{autopilot: :px4, vehicle_type: "copter"}
  @vtol %{autopilot: :px4, vehicle_type: "vtol"}
  @unknown %{autopilot: :generic, vehicle_type: "unknown"}
  @never_heard %{autopilot: nil, vehicle_type: nil}
  @vehicles [@copter, @plane, @rover, @sub, @px4, @vtol, @unknown, @never_heard]
  @now 1_795_340_000_000_000
  @aux MavCmd.value(:MAV_CMD_DO_AUX_FUNCTION)

  # Values that leave a channel alone on every firmware.
  defp override(channels) do
    left_alone = for n <- 1..18, into: %{}, do: {n, if(n <= 8, do: 65_535, else: 0)}

    struct!(
      %M.RcChannelsOverride{},
      for({n, us} <- Map.merge(left_alone, channels), do: {:"chan#{n}_raw", us})
    )
  end

  defp judge(message, vehicle, options \\ []) do
    {:ok, policy} = Policy.compile(Keyword.get(options, :section, %{}))
    vehicle = Map.merge(vehicle, %{params: Keyword.get(options, :params, %{})})
    {role, permissions} = {Keyword.get(options, :role, :operator), Keyword.get(options, :permissions, [])}

    context = %Context{
      now: @now,
      source: Roles.principal(:client, "olga", role, permissions),
      armed: true,
      in_air: true
    }

    context = context |> struct!(vehicle) |> struct!(Keyword.get(options, :more, %{}))
    Policy.decide(policy, facts(message, vehicle), context)
  end

  defp facts(%Command{} = command, _vehicle), do: Intent.of(command)

  defp facts(message, vehicle), do: message |> decoded() |> Mavlink.facts(vehicle)

  # Everything that is read from it, and nothing mapped.
  defp nothing(%{autopilot: autopilot, vehicle_type: kind}) do
    sticks = %{"RCMAP_ROLL" => 1, "RCMAP_PITCH" => 2, "RCMAP_THROTTLE" => 3, "RCMAP_YAW" => 4}
    Map.new(Switches.plan({autopilot, kind}), &{&1, Map.get(sticks, &1, 0)})
  end

  defp command(type, params) do
    {:ok, command} = Command.new([vehicle: "VID-001", type: type, params: params], @now)
    command
  end

  test "while nothing is known of a vehicle, an operator works its sticks and nothing else" do
    sticks = fn %{vehicle_type: kind} -> if kind == "sub", do: 1..6, else: 1..4 end

    for vehicle <- @vehicles do
      # ArduPilot has sixteen channels.
      ignored = if vehicle.autopilot == :ardupilot, do: [17, 18], else: []
      # It may be one with MSP, whose sticks are its receiver's.
      own = if vehicle == @unknown, do: [:receiver], else: []
      if own != [], do: assert({:deny, :role, _} = judge(override(%{1 => 1500}), vehicle))
      if own != [], do: assert({:deny, :role, _} = judge(%M.ManualControl{z: 500}, vehicle))

      for n <- 1..18 do
        expected = if n in sticks.(vehicle) or n in ignored, do: :allow, else: :role

        assert {n, vehicle, rule(judge(override(%{n => 1500}), vehicle, permissions: own))} ==
                 {n, vehicle, expected}

        channels = List.duplicate(0, n - 1) ++ [1500]

        assert {n, vehicle,
                rule(judge(command("rc_override", %{channels: channels}), vehicle, permissions: own))} ==
                 {n, vehicle, expected}
      end

      for message <- [%M.RadioRcChannels{}, %M.CubepilotRawRc{}, %M.RcChannelsOverrideV2{}, %M.RcChannels{}] do
        assert {:deny, :role, reason} = judge(message, vehicle, permissions: own)
        assert reason =~ "needs the permission terminate"
        assert judge(message, vehicle, permissions: own ++ Intent.most()) == :allow
      end

      assert judge(%M.ManualControl{x: 300, y: -300, z: 500, r: 200}, vehicle, permissions: own) == :allow
    end
  end

  test "a refusal says which parameter is not known" do
    assert {:deny, :role, reason} = judge(override(%{7 => 2000}), @copter, params: %{"FLTMODE_CH" => 5})

    assert reason ==
             "rc_override needs the permission terminate, which no role includes; olga (operator) was not given it: " <>
               "what channel 7 switches is not known (RC7_OPTION not read from the vehicle)"

    assert {:deny, :role, reason} = judge(override(%{7 => 2000}), @px4, params: %{"RC_MAP_KILL_SW" => 7})
    assert reason =~ "channel 7 is its kill switch (RC_MAP_KILL_SW)"
  end

  test "what is read from a vehicle proves the channels harmless that nothing maps" do
    for vehicle <- [@copter, @plane, @rover, @sub, @px4, @vtol], n <- 1..18 do
      assert {n, vehicle, judge(override(%{n => 1900}), vehicle, params: nothing(vehicle))} ==
               {n, vehicle, :allow}
    end

    for button <- 0..31 do
      pressed = %M.ManualControl{
        buttons: Bitwise.band(2 ** button, 0xFFFF),
        buttons2: Bitwise.bsr(2 ** button, 16)
      }

      assert judge(pressed, @sub, params: nothing(@sub)) == :allow
      assert {:deny, :role, _} = judge(pressed, @sub)
    end
  end

  test "PX4: each parameter that maps a channel needs what its function needs" do
    needs = %{
      "RC_MAP_KILL_SW" => [:terminate],
      "RC_MAP_TERM_SW" => [:terminate],
      "RC_MAP_ARM_SW" => [:force_disarm],
      "RC_MAP_ENG_MOT" => [:force_disarm],
      "RC_MAP_TRANS_SW" => [:protection],
      "RC_MAP_FAILSAFE" => [:protection],
      "RC_MAP_PARAM1" => [:maintain, :protection],
      "RC_MAP_PARAM2" => [:maintain, :protection],
      "RC_MAP_PARAM3" => [:maintain, :protection]
    }

    for name <- Switches.plan({:px4, "vtol"}),
        String.starts_with?(name, "RC_MAP_") and name != "RC_MAP_FLTM_BTN" do
      # On a stick as well.
      for n <- [2, 5, 18] do
        params = Map.put(nothing(@vtol), name, n)
        needed = Map.get(needs, name, [])
        decision = judge(override(%{n => 1100}), @vtol, params: params)
        assert {name, rule(decision)} == {name, if(needed == [], do: :allow, else: :role)}
        assert judge(override(%{n => 1100}), @vtol, params: params, permissions: needed) == :allow

        # Not known: it may be any of these.
        if is_map_key(needs, name) and name not in ["RC_MAP_TERM_SW", "RC_MAP_ENG_MOT"],
          do:
            assert({:deny, :role, _} = judge(override(%{9 => 1100}), @vtol, params: Map.delete(params, name)))
      end
    end

    # Other channels are not concerned.
    killed = Map.put(nothing(@px4), "RC_MAP_KILL_SW", 7)
    assert judge(override(%{5 => 1900, 6 => 1100}), @px4, params: killed) == :allow

    assert {:deny, :mode, _} =
             judge(override(%{6 => 1900}), @px4,
               params: Map.put(killed, "RC_MAP_FLTM_BTN", 0b100000),
               section: %{modes: %{denied: ["ACRO"]}}
             )
  end

  test "PX4 takes an override as a whole: what stands before its last channel is worked as well" do
    killed = [params: Map.put(nothing(@px4), "RC_MAP_KILL_SW", 7)]
    # Ignored, it is at its highest; 0 does not give it back.
    assert {:deny, :role, _} = judge(override(%{8 => 1500}), @px4, killed)
    assert {:deny, :role, _} = judge(override(%{7 => 0}), @px4, killed)
    assert {:deny, :role, _} = judge(override(%{7 => 65_534}), @px4, killed)

    assert {:deny, :role, _} =
             judge(command("rc_override", %{channels: [0, 0, 0, 0, 0, 0, 0, 1500]}), @px4, killed)

    assert judge(override(%{6 => 1500}), @px4, killed) == :allow
    high = [params: Map.put(nothing(@px4), "RC_MAP_KILL_SW", 10)]
    assert {:deny, :role, _} = judge(override(%{10 => 65_534}), @px4, high)
    assert {:deny, :role, _} = judge(override(%{12 => 1500}), @px4, high)
    assert judge(override(%{10 => 65_535}), @px4, high) == :allow
    assert judge(override(%{9 => 1500, 10 => 0}), @px4, high) == :allow
  end

  test "ArduPilot: 0 gives one of the first eight channels back, 65534 one of the others" do
    for {n, value} <- [{7, 0}, {7, 65_535}, {9, 0}, {9, 65_534}, {9, 65_535}] do
      params = Map.put(nothing(@copter), "RC#{n}_OPTION", 31)
      assert {n, value, judge(override(%{n => value}), @copter, params: params)} == {n, value, :allow}
      assert {:deny, :role, _} = judge(override(%{n => 1900}), @copter, params: params)
    end
  end

  test "ArduPilot: a channel needs what DO_AUX_FUNCTION needs for its function, in each position" do
    for function <- Enum.to_list(1..400) ++ [65_000],
        {us, level} <- [{1000, 0}, {1500, 1}, {2000, 2}],
        role <- [:operator, :admin] do
      params = Map.put(nothing(@copter), "RC9_OPTION", function)
      by_channel = judge(override(%{9 => us}), @copter, params: params, role: role)
      command = %M.CommandLong{command: @aux, param1: function * 1.0, param2: level * 1.0}
      by_command = judge(command, @copter, role: role)
      assert {function, us, role, rule(by_channel)} == {function, us, role, rule(by_command)}
    end
  end

  test "ArduPilot: a function that nobody here knows needs the most, by a channel, a command and a mission" do
    unlisted = %M.CommandLong{command: @aux, param1: 999.0, param2: 2.0}
    item = %M.MissionItemInt{seq: 3, frame: 2, command: @aux, param1: 999.0, param2: 2.0}

    for message <- [unlisted, item] do
      assert {:deny, :role, _} = judge(message, @copter, role: :admin)
      assert judge(message, @copter, role: :admin, permissions: Intent.most()) == :allow
    end

    # A flare idles the throttle.
    flare = %{unlisted | param1: 89.0}
    assert {:deny, :role, _} = judge(flare, @plane, role: :admin)
    assert judge(%{flare | param2: 0.0}, @plane) == :allow
  end

  test "the sticks are the channels that the vehicle says" do
    params = Map.merge(nothing(@copter), %{"RCMAP_THROTTLE" => 6, "RC6_OPTION" => 0})
    unread = Map.drop(params, ["RC3_OPTION", "RC6_OPTION"])
    assert judge(override(%{6 => 1500}), @copter, params: unread) == :allow
    assert {:deny, :role, _} = judge(override(%{3 => 1500}), @copter, params: unread)
    mapped = %{"RC_MAP_THROTTLE" => 6, "RC_MAP_YAW" => 7}
    assert {:deny, :role, _} = judge(override(%{3 => 1500}), @px4, params: mapped)
    # A stick with a function, by a joystick as well.
    stops = Map.put(nothing(@copter), "RC3_OPTION", 31)
    assert {:deny, :role, _} = judge(%M.ManualControl{z: 500}, @copter, params: stops)
    assert judge(%M.ManualControl{x: 32_767, y: 100, z: 32_767, r: 32_767}, @copter, params: stops) == :allow
  end

  test "a joystick's outputs are an output's, and unknown where the firmware is" do
    aux = %M.ManualControl{z: 500, enabled_extensions: 0b100, aux1: 900}
    assert judge(aux, @px4) == :allow
    assert judge(aux, @copter) == :allow
    for vehicle <- [@unknown, @never_heard, @sub], do: assert({:deny, :role, _} = judge(aux, vehicle))

    for vehicle <- [@unknown, @never_heard],
        do: assert({:deny, :role, _} = judge(%M.ManualControl{z: 500, buttons: 1}, vehicle))

    for vehicle <- [@copter, @plane, @px4],
        do: assert(judge(%M.ManualControl{z: 500, buttons: 0xFFFF}, vehicle) == :allow)
  end

  test "sticks in all corners stop PX4's motors, unless that gesture is off" do
    off = [params: %{"MAN_KILL_GEST_T" => -1.0}]
    corner = %M.ManualControl{x: -1000, y: 1000, z: 0, r: -1000}

    for message <- [corner, override(%{1 => 2000, 2 => 1000, 3 => 1000, 4 => 1000}), override(%{4 => 1000})] do
      assert {:deny, :role, reason} = judge(message, @px4)
      assert reason =~ "terminate"
      assert {:deny, :role, _} = judge(message, @px4, params: %{"MAN_KILL_GEST_T" => 1.5})
      assert judge(message, @px4, off) == :allow
      assert judge(message, @copter) == :allow
    end

    assert judge(%{corner | y: 0}, @px4) == :allow
    assert judge(override(%{1 => 1500, 2 => 1000, 3 => 1000, 4 => 1000}), @px4) == :allow
  end

  test "on the ground, sticks that arm need what arming needs" do
    low = [section: %{takeoff_battery: 0.3}, more: %{armed: false, in_air: false, battery: 0.1}]

    for vehicle <- [@copter, @px4],
        message <- [%M.ManualControl{z: 0, r: 1000}, override(%{1 => 1500, 2 => 1500, 3 => 1000, 4 => 2000})] do
      assert {:deny, :battery, _} = judge(message, vehicle, low)
      assert judge(message, vehicle, put_in(low[:more].battery, 0.9)) == :allow
    end

    assert judge(%M.ManualControl{z: 500, r: 100}, @copter, low) == :allow
    switch = Map.put(nothing(@copter), "RC7_OPTION", 153)
    assert {:deny, :battery, _} = judge(override(%{7 => 2000}), @copter, [params: switch] ++ low)
  end

  test "vehicles with MSP ask for `receiver` instead" do
    for autopilot <- [:betaflight, :inav] do
      vehicle = %{autopilot: autopilot, vehicle_type: "copter"}
      assert {:deny, :role, _} = judge(override(%{5 => 1500}), vehicle)
      assert judge(override(%{5 => 1500}), vehicle, permissions: [:receiver]) == :allow
    end
  end

  defp rule({:deny, rule, _reason}), do: rule
  defp rule(:allow), do: :allow
end
