defmodule Aerie.Control.Params.CommandLineTest do
  @moduledoc "Files of the command lines and configurators of Betaflight and iNav."
  use ExUnit.Case, async: true

  alias Aerie.Control.Params.{File, Param, Table}

  # As Betaflight 4.5 prints it.
  @diff """
  # diff all

  # version
  # Betaflight / STM32F7X2 (S7X2) 4.5.1 Jul 27 2024 / 07:53:51 (77d01ba3b) MSP API: 1.46

  # start the command batch
  batch start
  # reset configuration to default settings
  defaults nosave

  board_name SPEEDYBEEF7V3
  manufacturer_id SPBE

  # name: racer

  # feature
  feature -RX_SERIAL
  feature RX_MSP
  # serial
  serial 0 64 115200 57600 0 115200
  # aux
  aux 0 0 0 1700 2100 0 0
  # master
  set acc_calibration = 12,-4,33,1
  set vbat_warning_cell_voltage = 360
  set failsafe_procedure = DROP
  set craft_name = racer
  set blackbox_mode = normal

  profile 0

  # profile 0
  set p_pitch = 52

  profile 1
  set p_pitch = 99

  # restore original profile selection
  profile 0

  rateprofile 1
  set roll_rc_rate = 120

  # save configuration
  save
  """

  test "diff all: numbers and words of what is active; the rest is said" do
    assert {:ok, entries, remarks} = File.read(@diff, {7, 1})
    values = Map.new(entries, &{&1.name, &1.value})

    assert %{
             "vbat_warning_cell_voltage" => 360,
             "failsafe_procedure" => 1,
             "p_pitch" => 52,
             "roll_rc_rate" => 120
           } = values

    refute is_map_key(values, "acc_calibration") or is_map_key(values, "craft_name")

    assert Enum.any?(remarks, &(&1 =~ "they are not numbers: acc_calibration, craft_name, blackbox_mode"))
    assert Enum.any?(remarks, &(&1 =~ "they are of another profile: p_pitch"))
    assert Enum.any?(remarks, &(&1 =~ "they are not settings: feature, serial, aux"))
    assert %{line: line} = Enum.find(entries, &(&1.name == "p_pitch"))
    assert @diff |> String.split("\n") |> Enum.at(line - 1) == "set p_pitch = 52"
  end

  test "written, and read again: the same values, with words where the firmware has them" do
    table =
      Table.new([
        %Param{name: "failsafe_procedure", value: 1, type: 1},
        %Param{name: "p_pitch", value: 52, type: 1},
        %Param{name: "vbat_warning_cell_voltage", value: 360, type: 3}
      ])

    text = File.format(table, {:txt, {:betaflight, {1, 46}}}, {7, 1})
    assert text =~ "# Betaflight 4.5: save stores"

    assert text =~
             "set failsafe_procedure = DROP\nset p_pitch = 52\nset vbat_warning_cell_voltage = 360\nsave\n"

    assert {:ok, entries, []} = File.read(text, {7, 1})

    assert Map.new(entries, &{&1.name, &1.value}) == %{
             "failsafe_procedure" => 1,
             "p_pitch" => 52,
             "vbat_warning_cell_voltage" => 360
           }

    assert File.format(table, {:txt, {:inav, {9, 0}}}, {7, 1}) =~ "# iNav 9.0: save stores"
    # A vehicle of the other firmware understands other numbers by the same words.
    assert {:error, [{nil, "the file is of Betaflight" <> _}]} = File.read(text, {7, 1}, {:inav, {9, 0}})
    assert {:ok, _entries, []} = File.read(text, {7, 1}, {:betaflight, {1, 46}})
  end

  test "words are those of the vehicle's version, whichever version wrote the file" do
    # The same word has another number in each of these, and iNav 7 has one more receiver of GPS.
    for {release, name, word, number} <- [
          {{:inav, {7, 1}}, "gps_provider", "MSP", 2},
          {{:inav, {9, 0}}, "gps_provider", "MSP", 1},
          {{:inav, {7, 0}}, "dynamic_gyro_notch_mode", "3D", 7},
          {{:inav, {9, 0}}, "dynamic_gyro_notch_mode", "3D", 1},
          {{:betaflight, {1, 46}}, "serialrx_provider", "SPEK1024", 15},
          {{:betaflight, {1, 45}}, "serialrx_provider", "SPEK1024", 0},
          {{:betaflight, {1, 42}}, "motor_pwm_protocol", "OFF", 0},
          {{:betaflight, {1, 48}}, "motor_pwm_protocol", "DISABLED", 9},
          {{:betaflight, {1, 43}}, "gyro_lowpass_type", "BIQUAD", 1}
        ] do
      table = Table.new([%Param{name: name, value: number, type: 6}])
      assert File.format(table, {:txt, release}, {7, 1}) =~ "set #{name} = #{word}\n"
      text = "set #{name} = #{String.downcase(word)}\n"
      assert {:ok, [%{value: ^number}], []} = File.read(text, {7, 1}, release)
      # Numbers are read as well, though a command line refuses them there.
      assert {:ok, [%{value: ^number}], []} = File.read("set #{name} = #{number}\n", {7, 1}, release)
    end

    newer = "# Betaflight / STM32F405 (S405) 2026.6.1\nset serialrx_provider = MAVLINK\nset p_roll = 47\n"
    assert {:ok, [%{name: "p_roll"}], [remark]} = File.read(newer, {7, 1}, {:betaflight, {1, 46}})
    assert remark =~ "this version does not have the word: serialrx_provider (MAVLINK)"
    # For any vehicle: the version that the file names.
    assert {:ok, [%{name: "serialrx_provider", value: 16}, _p_roll], []} = File.read(newer, {7, 1})
  end

  test "a version that is not known has no words, and the file says so" do
    table = Table.new([%Param{name: "failsafe_procedure", value: 1, type: 6}])
    text = File.format(table, {:txt, {:betaflight, nil}}, {7, 1})
    assert text =~ "# The words of this version are not known" and text =~ "set failsafe_procedure = 1\n"
    file = "set failsafe_procedure = DROP\nset p_roll = 47\n"
    assert {:ok, [%{name: "p_roll"}], remarks} = File.read(file, {7, 1}, {:betaflight, nil})
    assert "the words of this version of Betaflight are not known: only numbers are read" in remarks
  end

  test "iNav's words, and a file without anything that can be set" do
    assert {:ok, [%{name: "receiver_type", value: 2}], []} =
             File.read("# version\nset receiver_type = msp\n", {7, 1}, {:inav, {9, 0}})

    assert {:error, [{nil, "the file has no parameters"}]} =
             File.read("set name = x y\nfeature GPS\n", {7, 1})

    assert {:error, [{1, "gone: expected" <> _}]} = File.read("gone,abc\n", {7, 1})
  end

  test "any bytes between its lines: a result or errors" do
    property =
      :proper.forall({:proper_types.range(0, byte_size(@diff)), :proper_types.binary()}, fn {at, bytes} ->
        <<before::binary-size(^at), behind::binary>> = @diff

        match?({kind, _, _} when kind == :ok, File.read(before <> bytes <> behind, {7, 1})) or
          match?({:error, [_ | _]}, File.read(before <> bytes <> behind, {7, 1}))
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end
end
