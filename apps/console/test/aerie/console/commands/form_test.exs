defmodule Aerie.Console.Commands.FormTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command.Types
  alias Aerie.Console.Commands.Form

  defp read(name, texts), do: name |> Types.fetch!() |> Form.read(texts)

  defp field(name, field, vehicle \\ nil),
    do: name |> Types.fetch!() |> Form.fields(vehicle) |> Enum.find(&(&1.name == field))

  test "a field has unit, range, default and meaning of its parameter" do
    assert %{
             input: :number,
             unit: "m",
             min: "0.5",
             max: "1000",
             required: true,
             value: ""
           } =
             field("takeoff", "altitude")

    assert %{input: :choice, values: ["home", "msl", "terrain"], value: "home", required: false} =
             field("goto", "altitude_reference")

    assert %{input: :boolean, value: "false"} = field("set_yaw", "relative")
    assert %{input: :tick} = field("set_home", "here")
    assert %{input: :list, unit: "µs"} = field("rc_override", "channels")

    assert Types.fetch!("goto") |> Form.fields(nil, %{"lat" => "47.1"}) |> hd() |> Map.fetch!(:value) ==
             "47.1"
  end

  test "each command has a form, and its defaults are right" do
    for type <- Types.all(), field <- Form.fields(type), field.value != "" do
      assert {:ok, %{}} =
               Form.read(
                 %{
                   type
                   | params: Enum.filter(type.params, &(Atom.to_string(&1.name) == field.name)),
                     rules: []
                 },
                 %{field.name => field.value}
               )
    end
  end

  test "the modes of the vehicle's firmware are offered, and those that it named itself" do
    vehicle = %{autopilot: :ardupilot, vehicle_type: "copter", memory: %{mode_names: %{99 => "MY_SCRIPT"}}}
    assert %{suggestions: modes} = field("set_mode", "mode", vehicle)
    assert "GUIDED" in modes and "MY_SCRIPT" in modes
  end

  test "texts become parameters; what is empty is not given, what is unknown is ignored" do
    assert {:ok, %{"altitude" => 20}} ==
             read("takeoff", %{"altitude" => " 20 ", "_unused_altitude" => "", "x" => "1"})

    assert {:ok, %{"altitude" => 20.5}} == read("takeoff", %{"altitude" => "20.5"})
    assert {:ok, %{}} == read("land", %{"x" => "1"})
    assert {:ok, %{}} == read("land", nil)
    assert {:ok, %{"here" => true}} == read("set_home", %{"here" => "true", "lat" => ""})

    assert {:ok, %{"yaw" => -10, "relative" => true}} ==
             read("set_yaw", %{"yaw" => "-10", "relative" => "true"})

    assert {:ok, %{"channels" => [1500, 0]}} == read("rc_override", %{"channels" => "1500, 0"})
  end

  test "what is wrong stands at its field, what concerns several beside the form" do
    assert {:error,
            %{fields: %{"altitude" => "expected a number from 0.5 to 1000 (m), got \"high\""}, general: []}} =
             read("takeoff", %{"altitude" => "high"})

    assert {:error, %{fields: %{"altitude" => "expected a number from 0.5 to 1000 (m)"}}} =
             read("takeoff", %{})

    assert {:error, %{fields: %{"altitude" => text}}} = read("takeoff", %{"altitude" => "1e9"})
    assert text =~ "got 1000000000.0"
    assert {:error, %{fields: %{"channels" => _text}}} = read("rc_override", %{"channels" => "1500 9999"})

    assert {:error, %{fields: fields, general: ["expected exactly one of mode, standard_mode"]}} =
             read("set_mode", %{})

    assert fields == %{}
  end

  test "no text is too long, and none becomes an atom" do
    long = String.duplicate("x", 10_000)
    assert {:error, %{fields: %{"mode" => _text}}} = read("set_mode", %{"mode" => long})
    assert {:error, _errors} = read("takeoff", %{"altitude" => ["1"]})
  end
end
