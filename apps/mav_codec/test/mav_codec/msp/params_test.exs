defmodule MavCodec.Msp.ParamsTest do
  use ExUnit.Case, async: true

  alias MavCodec.Msp.{Field, Messages, Params, ShortName}

  doctest MavCodec.Msp.Params
  doctest MavCodec.Msp.ShortName

  @versions [{1, 40}, {1, 42}, {1, 44}, {1, 46}, {1, 47}, {1, 49}]

  test "each parameter of Betaflight is a field of a message that can be read and written" do
    for version <- @versions, param <- Params.all(:betaflight, version), param.block do
      {:ok, block} = Messages.fetch(:betaflight, param.block)
      assert %Field{} = Enum.find(block.reply, &(is_struct(&1, Field) and &1.key == param.field)), param.name
      assert param.default == nil or param.low == nil or param.default in param.low..param.high, param.name
    end

    assert Enum.map(@versions, &length(Params.all(:betaflight, &1))) == [133, 164, 200, 209, 217, 419]
  end

  test "what no block has is there by name, from API 1.48 on" do
    named = for %{block: nil} = param <- Params.all(:betaflight, {1, 48}), do: param
    assert length(named) == 201
    assert Enum.all?(named, &(&1.type in ~w(u8 i8 u16 i16 u32) and &1.low <= &1.high))
    assert Enum.all?(named, &(&1.values == [] or length(&1.values) == &1.high + 1))
    assert %{values: ["OFF", "ON", "AUTO"], default: 2} = Enum.find(named, &(&1.name == "yaw_spin_recovery"))
    assert Enum.all?(Params.all(:betaflight, {1, 47}), & &1.block)
    assert Params.by_name?(:betaflight, {1, 48}) and not Params.by_name?(:betaflight, {1, 47})
  end

  test "names follow the version" do
    names = fn version -> for param <- Params.all(:betaflight, version), do: param.name end
    assert "gyro_lowpass_hz" in names.({1, 43}) and "gyro_lpf1_static_hz" in names.({1, 44})
    assert "d_min_roll" in names.({1, 46}) and "d_max_roll" in names.({1, 47})
  end

  # As the settings.c of these tags have them.
  test "ranges and words follow the version" do
    row = fn version, name -> Enum.find(Params.all(:betaflight, version), &(&1.name == name)) end

    for {version, name, low, high} <- [
          {{1, 46}, "gps_rescue_throttle_hover", 1000, 2000},
          {{1, 47}, "ap_hover_throttle", 1100, 1700},
          {{1, 48}, "ap_hover_throttle", 0, 1700},
          {{1, 46}, "gps_rescue_throttle_min", 1000, 2000},
          {{1, 47}, "ap_throttle_min", 1050, 1400},
          {{1, 40}, "gps_rescue_angle", 0, 200},
          {{1, 46}, "gps_rescue_max_angle", 30, 60},
          {{1, 49}, "ap_max_angle", 10, 70},
          {{1, 43}, "failsafe_delay", 0, 200},
          {{1, 45}, "failsafe_delay", 2, 200},
          {{1, 46}, "failsafe_delay", 1, 200},
          {{1, 46}, "failsafe_off_delay", 0, 200},
          {{1, 43}, "p_roll", 0, 200},
          {{1, 44}, "p_roll", 0, 250},
          {{1, 44}, "gps_rescue_min_dth", 50, 1000},
          {{1, 46}, "mag_declination", 0, 3599},
          # Where point releases differ, the narrowest.
          {{1, 45}, "gps_rescue_min_start_dist", 20, 30},
          {{1, 47}, "gyro_enabled_bitmask", 1, 3}
        ],
        do: assert(%{low: ^low, high: ^high, default: _} = row.(version, name), name)

    assert %{values: ["FIRST", "SECOND", "BOTH"]} = row.({1, 46}, "gyro_to_use")
    assert %{unit: "s*0.1", default: nil} = row.({1, 46}, "failsafe_off_delay")
    assert %{unit: "s", default: 60} = row.({1, 48}, "failsafe_landing_time")
    # What was in its place in the block was something else, or nothing.
    for name <- ["rc_smoothing_auto_factor_throttle", "pos_hold_deadband"],
        do: refute(row.({1, 46}, name), name)

    refute row.({1, 45}, "mag_declination")
    refute row.({1, 49}, "use_integrated_yaw")
    assert %{high: 10} = Enum.find(Params.all(:inav, {7, 1}), &(&1.name == "osd_snr_alarm"))
    assert %{high: 30} = Enum.find(Params.all(:inav, {9, 1}), &(&1.name == "osd_snr_alarm"))
  end

  test "before 2026.6 the gateway alone checks values, so each parameter of a block has a range or words" do
    for {_numbers, version, release} <- Params.releases(:betaflight),
        not Params.by_name?(:betaflight, version),
        param <- Params.all(:betaflight, version),
        do: assert(is_integer(param.low) or param.values != [], "#{release} #{param.name}")
  end

  test "MAVLink's names are unique, and long ones are found again" do
    for firmware <- [:betaflight, :inav] do
      names = Params.names(firmware)
      assert map_size(names) == names |> Map.values() |> Enum.uniq() |> length()

      for {short, full} <- names,
          do:
            assert(
              byte_size(short) <= 16 and Params.full(firmware, short) == full and ShortName.of(full) == short
            )
    end

    assert map_size(Params.names(:inav)) == 634
    assert Params.full(:inav, "nobody_knows~12") == "nobody_knows~12"
  end

  test "words for numbers" do
    assert %{values: ["AUTO-LAND", "DROP", "GPS-RESCUE"]} =
             Enum.find(Params.all(:betaflight, {1, 46}), &(&1.name == "failsafe_procedure"))

    assert %{values: ["NONE", "SERIAL", "MSP", "SIM (SITL)"], type: "u8"} =
             Enum.find(Params.all(:inav, {9, 0}), &(&1.name == "receiver_type"))
  end
end
