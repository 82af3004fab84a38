defmodule Aerie.Fleet.Inspector.ComposeTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Inspector.{Compose, Fields}
  alias MavCodec.{Frame, Parser}
  alias MavCodec.Messages, as: M

  defp fields(message, options \\ []) do
    bytes = MavCodec.encode(message, [system: 1] ++ options)
    {[frame], _parser} = Parser.push_datagram(Parser.new(), bytes, 5)
    Map.new(Fields.of(frame), &{&1.name, &1})
  end

  test "fields have units, names of enums, flags, and values in a usual unit" do
    shown = fields(%M.Heartbeat{type: 2, autopilot: 3, base_mode: 0x81, system_status: 4})
    assert %{value: "2", means: "QUADROTOR"} = shown["type"]
    assert %{value: "129", means: means} = shown["base_mode"]
    assert means =~ "SAFETY_ARMED" and means =~ " | "
    position = fields(%M.GlobalPositionInt{lat: 473_977_420, alt: 12_340, vx: -150})
    assert %{value: "473977420", units: "degE7", means: "47.3977420 °"} = position["lat"]
    assert %{means: "12.340 m"} = position["alt"]
    assert %{means: "-1.50 m/s"} = position["vx"]
    assert %{value: "0.5", means: "28.65 °"} = fields(%M.Attitude{roll: 0.5})["roll"]
    assert %{value: "NaN"} = fields(%M.Attitude{roll: :nan})["roll"]
    assert %{value: "hello", means: nil} = fields(%M.Statustext{text: "hello"})["text"]
    assert %{value: "0.1"} = fields(%M.Attitude{roll: 0.1})["roll"]

    assert %{type: "uint16[10]", value: "1 2 3 0 0 0 0 0 0 0"} =
             fields(%M.BatteryStatus{voltages: [1, 2, 3, 0, 0, 0, 0, 0, 0, 0]})["voltages"]
  end

  test "an unknown message has bytes and no fields" do
    assert Fields.of(%Frame{id: 0xABCDE}) == nil
    assert Fields.name(0xABCDE) == "#703710"
    assert Fields.hex(<<0, 255, 10>>) == "00 FF 0A"
  end

  test "a message of what somebody typed: numbers, hexadecimal, names, flags, arrays, text" do
    assert {:ok, %M.CommandLong{target_system: 7, command: 400, param1: 1.0, param2: :nan}} =
             Compose.message("COMMAND_LONG", %{
               "target_system" => " 7 ",
               "command" => "MAV_CMD_COMPONENT_ARM_DISARM",
               "param1" => "1",
               "param2" => "NaN"
             })

    assert {:ok, %M.Heartbeat{type: 6, base_mode: 192}} =
             Compose.message("HEARTBEAT", %{
               "type" => "gcs",
               "base_mode" => "SAFETY_ARMED | MANUAL_INPUT_ENABLED"
             })

    assert {:ok, %M.BatteryStatus{voltages: [1, 0x20, 0, 0, 0, 0, 0, 0, 0, 0]}} =
             Compose.message("BATTERY_STATUS", %{"voltages" => "1, 0x20"})

    assert {:ok, %M.Statustext{text: "hi"}} = Compose.message("STATUSTEXT", %{"text" => "hi"})

    assert {:ok, %M.SerialControl{data: <<10, 255>>}} =
             Compose.message("SERIAL_CONTROL", %{"data" => "0A FF"})

    assert {:ok, %M.Heartbeat{type: 0}} = Compose.message("HEARTBEAT", %{})
  end

  test "what is wrong is said for each field, and no text becomes an atom" do
    assert {:error, %{"message" => text}} = Compose.message("NO_SUCH", %{})
    assert text =~ "NO_SUCH"

    assert {:error, errors} =
             Compose.message("COMMAND_LONG", %{
               "target_system" => "256",
               "command" => "FLY_AWAY",
               "param1" => "x"
             })

    assert errors == %{
             "target_system" => "expected an integer from 0 to 255",
             "command" => "expected an integer from 0 to 65535, or a name of MavCmd",
             "param1" => "expected a number or nan"
           }

    assert {:error, %{"text" => _too_long}} =
             Compose.message("STATUSTEXT", %{"text" => String.duplicate("x", 60)})

    assert {:error, %{"data" => "expected bytes" <> _}} = Compose.message("SERIAL_CONTROL", %{"data" => "zz"})
    name = "A_NAME_THAT_IS_NO_ATOM_#{System.unique_integer([:positive])}"
    assert {:error, _errors} = Compose.message("HEARTBEAT", %{"type" => name})
    assert_raise ArgumentError, fn -> String.to_existing_atom(name) end
  end

  test "every message can be chosen, has fields, and can be made with nothing filled in" do
    names = Compose.names()
    assert "HEARTBEAT" in names and length(names) > 300

    for name <- names do
      assert [_ | _] = fields = Compose.fields(name)
      for field <- fields, do: assert(is_list(field.choices))
      assert {:ok, %_module{}} = Compose.message(name, %{})
    end

    assert Compose.fields("NO_SUCH") == []
  end
end
