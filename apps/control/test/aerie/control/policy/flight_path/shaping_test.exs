defmodule Aerie.Control.Policy.FlightPath.ShapingTest do
  @moduledoc "Parameters that shape a path, set by somebody who has `maintain` and not `protection`."
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, Mavlink}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Intent.Protection
  alias MavCodec.Meaning.Shaping
  alias MavCodec.Message.Value
  alias MavCodec.Messages, as: M

  @fence """
  {"type": "Feature", "properties": {"name": "field"},
   "geometry": {"type": "Polygon", "coordinates": [[[8.0, 47.0], [8.03, 47.0], [8.03, 47.02], [8.0, 47.02]]]}}
  """

  defp policy(section, fence \\ nil) do
    {:ok, policy} = Policy.compile(section)
    {:ok, fence} = if fence, do: Policy.Fence.parse(fence), else: {:ok, nil}
    %{policy | fence: fence}
  end

  defp decide(policy, facts, permissions \\ [:maintain], params \\ %{}) do
    source = Policy.Roles.principal(:client, "olga", :operator, permissions)
    context = Context.new(%{}, source, 0)
    Policy.decide(policy, facts, %{context | autopilot: :ardupilot, vehicle_type: "plane", params: params})
  end

  # By MAVLink, and by REST, NATS, the console and files.
  defp sets(name, value) do
    message = %M.ParamSet{param_id: name, param_value: value, param_type: 9}
    vehicle = %{autopilot: :ardupilot, vehicle_type: "plane"}
    [Mavlink.facts(message, vehicle), Intent.set_parameters([{"SERVO9_MIN", 900}, {name, value}])]
  end

  test "every row: within the limits, or with protection; without a fence or limit as before" do
    fence = policy(%{}, @fence)

    for row <- Shaping.all(), not Protection.parameter?(row.name), facts <- sets(row.name, 1.0e6) do
      assert decide(policy(%{}), facts) == :allow, row.name
      assert decide(fence, facts, [:maintain, :protection]) == :allow, row.name

      case row.shapes do
        :speed ->
          assert decide(fence, facts) == :allow

        :height ->
          assert decide(fence, facts) == :allow

        _width_or_path ->
          assert {:deny, :role, "set_parameter needs the permission protection: " <> _} = decide(fence, facts)
      end

      if row.shapes == :height do
        assert {:deny, :role, reason} = decide(policy(%{max_altitude: 60}), facts)
        assert reason =~ row.name and reason =~ row.meaning

        for low <- sets(row.name, 50 / row.metres),
            do: assert(decide(policy(%{max_altitude: 60}), low) == :allow)

        for below <- sets(row.name, -5.0),
            do: assert({:deny, :role, _} = decide(policy(%{max_altitude: 60}), below))

        # A limit above mean sea level, and zones with heights, say nothing about a height above home.
        for low <- sets(row.name, 5 / row.metres) do
          assert {:deny, :role, _} = decide(policy(%{max_altitude_msl: 600}), low)
          banded = String.replace(@fence, ~s("name": "field"), ~s("name": "field", "max_altitude": 100))
          assert {:deny, :role, _} = decide(policy(%{}, banded), low)
        end
      end
    end
  end

  test "a radius may become smaller than it is, as far as that is known" do
    fence = policy(%{}, @fence)

    for facts <- sets("WP_LOITER_RAD", -60.0) do
      assert decide(fence, facts, [:maintain], %{"WP_LOITER_RAD" => 80.0}) == :allow
      assert {:deny, :role, _} = decide(fence, facts, [:maintain], %{"WP_LOITER_RAD" => 40.0})
      assert {:deny, :role, _} = decide(fence, facts)
    end
  end

  test "one of a family without a row, in whatever letters, and one whose value cannot be read" do
    fence = policy(%{}, @fence)

    for name <-
          ~w(WP_NAVALT_MIN rtl_loit_time TERRAIN_OFS_MAX NAV_FW_ALTL_RAD MIS_YAW_TMT NAVL1_PERIOD AUTO_OPTIONS),
        facts <- sets(name, 1.0) do
      assert {:deny, :role, reason} = decide(fence, facts)
      assert reason =~ name and reason =~ "not known how"
      assert decide(policy(%{}), facts) == :allow
    end

    px4 = %{autopilot: :px4, vehicle_type: "plane"}
    # An unknown firmware may take the number of the float, which is 0, or its bytes, which are 7.
    asked = %M.ParamSet{param_id: "RTL_RETURN_ALT", param_value: 1.0e-44, param_type: 6}
    bits = Mavlink.facts(asked, %{px4 | autopilot: :generic})
    assert {:deny, :role, _} = decide(policy(%{max_altitude: 60}), bits)
    # The others take what is judged.
    assert [{_name, 7}] = Mavlink.facts(asked, px4).sets
    assert [{_name, 1.0e-44}] = Mavlink.facts(asked, %{px4 | autopilot: :ardupilot}).sets
    assert [{_name, 7}] = Mavlink.facts(asked, %{px4 | autopilot: :betaflight}).sets
    too_high = %{asked | param_value: Value.float32(61)}
    assert {:deny, :role, _} = decide(policy(%{max_altitude: 60}), Mavlink.facts(too_high, px4))
    assert decide(policy(%{max_altitude: 60}), Mavlink.facts(asked, px4)) == :allow
    nan = Mavlink.facts(%M.ParamSet{param_id: "RTL_RETURN_ALT", param_value: :nan, param_type: 9}, px4)
    assert {:deny, :role, _} = decide(policy(%{max_altitude: 60}), nan)

    for name <- ~w(SERVO9_MIN CAM_EXPOSURE ATC_RAT_RLL_P),
        facts <- sets(name, 1.0),
        do: assert(decide(fence, facts) == :allow)
  end
end
