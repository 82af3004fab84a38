defmodule Aerie.Vehicle.Command.TypesTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.Command.{Param, Type, Types}

  # What an operator expects to find, by the names the field uses.
  @expected ~w(arm disarm force_disarm terminate takeoff land rtl hold resume goto orbit set_mode set_speed set_altitude
               set_yaw set_home set_origin set_roi clear_roi vtol_transition parachute gripper servo actuator relay
               camera_photo camera_video camera_trigger camera_trigger_distance gimbal motor_test calibrate
               calibrate_position calibrate_accept calibrate_cancel reboot set_message_interval request_message
               high_latency mission_start mission_pause mission_set_current jump land_start set_geofence rc_override
               manual_control setpoint_position setpoint_local setpoint_velocity setpoint_attitude prearm_check
               save_params reset_params rx_pair take_control hand_over_control release_control)

  # Doing one of these twice is not the same as once.
  @never ~w(arm force_disarm terminate takeoff parachute gripper motor_test reboot reset_params calibrate camera_photo
            camera_trigger jump set_yaw vtol_transition)

  test "every command that there is to be is there, once" do
    assert Enum.sort(Types.names()) == Enum.sort(@expected)
  end

  test "what is dangerous to do twice is never repeated" do
    for name <- @never, do: assert(Types.fetch!(name).retry == :never, name)
  end

  test "every row is sound" do
    for type <- Types.all() do
      assert type.name =~ ~r/\A[a-z_]{1,32}\z/
      assert type.permission in Type.permissions()
      assert type.meaning =~ ~r/\A[A-Z].*\.\z/
      names = Enum.map(type.params, & &1.name)
      assert names == Enum.uniq(names)
      for {_rule, of} <- type.rules, name <- of, do: assert(name in names)
      for param <- type.params, do: assert_sound(param)
    end
  end

  defp assert_sound(param) do
    assert param.meaning != ""
    if param.required, do: assert(param.default == nil)
    if param.default != nil, do: assert({:ok, _value} = Param.check(param, param.default, "x"))

    case param.type do
      type when type in [:number, :integer] -> assert param.min < param.max
      :choice -> assert [_, _ | _] = param.values
      :text -> assert param.max > 0
      :list -> assert_sound(param.items)
      :boolean -> :ok
    end
  end

  test "permissions that stand alone" do
    for {name, permission} <- [
          {"force_disarm", :force_disarm},
          {"terminate", :terminate},
          {"parachute", :terminate},
          {"rc_override", :manual},
          {"request_message", :telemetry}
        ],
        do: assert(Types.fetch!(name).permission == permission)
  end

  test "the table is JSON, and complete" do
    rows =
      for type <- Types.all(), do: Types.fields() |> Object.show(type) |> JSON.encode!() |> JSON.decode!()

    assert Enum.map(rows, & &1["name"]) == Types.names()
    takeoff = Enum.find(rows, &(&1["name"] == "takeoff"))

    assert %{
             "retry" => "never",
             "permission" => "fly",
             "moves_vehicle" => true,
             "params" => [%{"name" => "altitude", "unit" => "m", "min" => 0.5, "max" => 1000}]
           } = takeoff
  end

  test "unknown names are an error, whatever they are" do
    for name <- ["", "Arm", nil, 7, %{}, ["arm"]], do: assert(Types.fetch(name) == :error)
  end

  defp junk do
    :proper_types.oneof([
      :proper_types.integer(),
      :proper_types.float(),
      :proper_types.boolean(),
      :proper_types.oneof([
        nil,
        10 ** 400,
        -0.0,
        1.0e308,
        "home",
        "release",
        <<255>>,
        %{},
        [],
        [nil],
        %{"a" => []}
      ]),
      :proper_types.list(:proper_types.integer()),
      :proper_types.binary()
    ])
  end

  test "whatever comes is refused with reasons, or in range" do
    property =
      :proper.forall(
        {:proper_types.oneof(Types.all()), :proper_types.list(junk()),
         :proper_types.list(:proper_types.binary())},
        fn {type, values, keys} ->
          names = Enum.map(type.params, &Atom.to_string(&1.name))
          given = Map.new(Enum.zip(names ++ keys, values))

          case Type.check(type, given) do
            {:ok, params} ->
              Enum.all?(params, fn {name, value} ->
                param = Enum.find(type.params, &(&1.name == name))
                Param.check(param, value, "x") == {:ok, value}
              end) and
                match?({:ok, _same}, Type.check(type, Map.new(params, &{"#{elem(&1, 0)}", elem(&1, 1)})))

            {:error, [_ | _] = errors} ->
              String.valid?(Enum.join(errors, "; ")) and byte_size(Enum.join(errors, "; ")) < 10_000
          end
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 2000]) == true, inspect(:proper.counterexample())
  end
end
