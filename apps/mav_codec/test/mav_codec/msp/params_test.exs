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

    assert Enum.map(@versions, &length(Params.all(:betaflight, &1))) == [153, 184, 207, 212, 218, 421]
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
