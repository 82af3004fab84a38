defmodule Aerie.Vehicle.StateUnknownTest do
  @moduledoc """
  Numbers by which messages say that they do not know a value: those of the definitions (`invalid`), and those that firmware sends
  besides. Each becomes nil in the state.
  """
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.State
  alias MavCodec.Definition.Facts
  alias MavCodec.Messages, as: M

  @definitions Path.expand("../../../../mav_codec/priv/definitions/upstream", __DIR__)
  @limits %{"UINT8_MAX" => 0xFF, "UINT16_MAX" => 0xFFFF, "INT16_MAX" => 0x7FFF}

  @channels for n <- 1..18, into: %{}, do: {:"chan#{n}_raw", n}
  @raw_channels Map.filter(@channels, fn {_field, n} -> n <= 8 end)

  # Where the state has a field of a message.
  @read %{
    M.GlobalPositionInt => %{hdg: {:position, :heading}},
    M.GpsRawInt => %{eph: {:gps, :hdop}, epv: {:gps, :vdop}, satellites_visible: {:gps, :satellites}},
    M.SysStatus => %{
      voltage_battery: {:battery, :voltage},
      current_battery: {:battery, :current},
      battery_remaining: {:battery, :remaining}
    },
    M.BatteryStatus => %{
      temperature: {:battery, :temperature},
      voltages: {:battery, :voltage},
      voltages_ext: {:battery, :voltage},
      current_battery: {:battery, :current},
      current_consumed: {:battery, :consumed_mah},
      time_remaining: {:battery, :time_remaining},
      battery_remaining: {:battery, :remaining}
    },
    M.MissionCurrent => %{total: {:mission, :total}, mission_state: {:mission, :state}},
    M.RcChannels =>
      Map.put(Map.new(@channels, fn {f, n} -> {f, {:rc, {:channels, n}}} end), :rssi, {:rc, :rssi}),
    M.RcChannelsRaw =>
      Map.put(Map.new(@raw_channels, fn {f, n} -> {f, {:rc, {:channels, n}}} end), :rssi, {:rc, :rssi}),
    M.HighLatency2 => %{battery: {:battery, :remaining}}
  }

  # Fields that the state does not have. 0 of CONTROL_STATUS is nobody, which is an answer.
  @unread %{
    M.GpsRawInt => [:vel, :cog, :yaw],
    M.ComponentInformationBasic => [
      :time_manufacture_s,
      :vendor_name,
      :model_name,
      :software_version,
      :hardware_version,
      :serial_number
    ],
    M.AttitudeQuaternion => [:repr_offset_q],
    M.BatteryStatus => [:energy_consumed],
    M.MissionCurrent => [:mission_mode, :mission_id, :fence_id, :rally_points_id],
    M.HomePosition => [:q],
    M.CurrentMode => [:intended_custom_mode],
    M.ControlStatus => [:gcs_main, :gcs_secondary]
  }

  # What firmware sends besides: {message, the value that it is not}.
  @besides [
    {%M.SysStatus{voltage_battery: 0}, {:battery, :voltage}},
    {%M.SysStatus{current_battery: -0x8000}, {:battery, :current}},
    {%M.SysStatus{battery_remaining: 127}, {:battery, :remaining}},
    {%M.SysStatus{load: 0xFFFF}, {:health, :load}},
    {%M.SysStatus{drop_rate_comm: 0xFFFF}, {:health, :drop_rate}},
    {%M.BatteryStatus{voltages: List.duplicate(0, 10)}, {:battery, :voltage}},
    {%M.BatteryStatus{current_battery: -0x8000}, {:battery, :current}},
    {%M.BatteryStatus{temperature: -0x8000}, {:battery, :temperature}},
    {%M.BatteryStatus{current_consumed: -0x80000000}, {:battery, :consumed_mah}},
    {%M.GpsRawInt{eph: 9_999}, {:gps, :hdop}},
    {%M.GpsRawInt{epv: 9_999}, {:gps, :vdop}},
    {%M.GpsRawInt{h_acc: 0xFFFFFFFF}, {:gps, :h_acc}},
    {%M.GpsRawInt{v_acc: 0xFFFFFFFF}, {:gps, :v_acc}},
    {%M.GpsRawInt{h_acc: 0}, {:gps, :h_acc}},
    {%M.GpsRawInt{lat: 0x7FFFFFFF}, {:gps, :lat}},
    {%M.GpsRawInt{lat: 1, lon: 1, alt: 0x7FFFFFFF}, {:gps, :alt_msl}},
    {%M.GlobalPositionInt{lat: 1, lon: 1, alt: -0x80000000}, {:position, :alt_msl}},
    {%M.GlobalPositionInt{lat: 1, lon: 1, relative_alt: 0x7FFFFFFF}, {:position, :alt_rel}},
    {%M.GlobalPositionInt{hdg: 36_001}, {:position, :heading}},
    {%M.GlobalPositionInt{vx: 0x7FFF}, {:velocity, :vn}},
    {%M.GlobalPositionInt{vy: -0x8000}, {:velocity, :ve}},
    {%M.VfrHud{throttle: 0xFFFF}, {:velocity, :throttle}},
    {%M.VfrHud{throttle: 101}, {:velocity, :throttle}},
    {%M.VfrHud{airspeed: :nan}, {:velocity, :airspeed}},
    {%M.HomePosition{latitude: 1, longitude: 1, altitude: 0x7FFFFFFF}, {:home, :alt_msl}},
    {%M.ExtendedSysState{landed_state: 99}, {:mode, :landed_state}},
    {%M.ExtendedSysState{vtol_state: 99}, {:mode, :vtol_state}},
    {%M.MissionCurrent{seq: 0xFFFF}, {:mission, :seq}},
    {%M.MissionItemReached{seq: 0xFFFF}, {:mission, :reached}},
    {%M.NavControllerOutput{wp_dist: 0xFFFF}, {:mission, :wp_distance}},
    {%M.RcChannels{rssi: 255}, {:rc, :rssi}},
    {%M.HighLatency2{heading: 181}, {:position, :heading}},
    {%M.HighLatency2{heading: 255}, {:position, :heading}},
    {%M.HighLatency2{throttle: 255}, {:velocity, :throttle}},
    {%M.HighLatency2{eph: 255}, {:gps, :h_acc}},
    {%M.HighLatency2{epv: 255}, {:gps, :v_acc}},
    {%M.HighLatency2{wp_num: 0xFFFF}, {:mission, :seq}},
    {%M.HighLatency2{target_distance: 0xFFFF}, {:mission, :wp_distance}},
    {%M.HighLatency2{battery: 101}, {:battery, :remaining}}
  ]

  defp apply_message(%module{} = message, autopilot \\ :ardupilot) do
    {state, _groups} = State.apply(%State{autopilot: autopilot}, module.id(), message, 1_000_000)
    state
  end

  defp value(state, {:rc, {:channels, n}}), do: Enum.at(State.data(state, :rc).channels, n - 1)

  defp value(state, {:battery, :temperature}),
    do: state |> State.data(:battery) |> Map.fetch!(:batteries) |> hd() |> Map.fetch!(:temperature)

  defp value(state, {group, key}), do: state |> State.data(group) |> Map.fetch!(key)

  defp with_invalid(module, field, invalid) do
    message = struct!(module, if(module == M.RcChannels, do: [chancount: 18], else: []))
    Map.put(message, field, invalid(Map.fetch!(message, field), invalid))
  end

  # An array is unknown if all of it is.
  defp invalid(values, "[" <> text) when is_list(values),
    do:
      List.duplicate(
        invalid(nil, text |> String.trim_trailing("]") |> String.trim_trailing(",")),
        length(values)
      )

  defp invalid(_value, text), do: Map.get_lazy(@limits, text, fn -> String.to_integer(text) end)

  # Module and field of everything in the definitions that has an invalid value, in messages that the state is read from.
  defp defined do
    modules = Map.keys(@read) ++ Map.keys(@unread)

    names =
      Map.new(modules, &{&1.__struct__() |> Map.fetch!(:__struct__) |> Module.split() |> List.last(), &1})

    for file <- ~w(common development standard),
        path = Path.join(@definitions, file <> ".facts"),
        {:ok, document} = path |> File.read!() |> Facts.facts() |> Facts.document(path),
        message <- document.messages,
        module = names[Macro.camelize(String.downcase(message.name))],
        field <- message.fields,
        field.invalid != nil,
        do: {module, String.to_existing_atom(field.name), field.invalid}
  end

  test "what the definitions call invalid is nil, and each such field is known here" do
    assert length(defined()) > 50

    for {module, field, invalid} <- defined(), field not in Map.get(@unread, module, []) do
      assert {module, field, place} = {module, field, @read[module][field]}
      assert place != nil, "#{inspect(module)}.#{field} is not in the table"
      state = apply_message(with_invalid(module, field, invalid))
      assert {module, field, value(state, place)} == {module, field, nil}
    end
  end

  test "messages that the state is read from and that have invalid values are in the table" do
    tables = MapSet.new(Map.keys(@read) ++ Map.keys(@unread))

    for file <- ~w(common development standard),
        path = Path.join(@definitions, file <> ".facts"),
        {:ok, document} = path |> File.read!() |> Facts.facts() |> Facts.document(path),
        message <- document.messages,
        Enum.any?(message.fields, & &1.invalid),
        State.wants?(%State{}, message.id, 0) do
      module = Module.concat(M, Macro.camelize(String.downcase(message.name)))
      assert module in tables
    end
  end

  test "what firmware sends for unknown besides is nil" do
    for {message, place} <- @besides do
      assert {message, value(apply_message(message), place)} == {message, nil}
    end
  end

  test "PX4's signal strength is in percent, others' is up to 254" do
    rssi = fn rssi, autopilot -> value(apply_message(%M.RcChannels{rssi: rssi}, autopilot), {:rc, :rssi}) end
    assert rssi.(100, :px4) == 1.0
    assert rssi.(50, :px4) == 0.5
    assert rssi.(101, :px4) == nil
    assert rssi.(254, :ardupilot) == 1.0
    assert rssi.(127, :ardupilot) == 0.5
  end

  test "a heading is below 360" do
    assert value(apply_message(%M.HighLatency2{heading: 180}), {:position, :heading}) == 0.0
    assert value(apply_message(%M.HighLatency2{heading: 179}), {:position, :heading}) == 358.0
    assert value(apply_message(%M.GlobalPositionInt{hdg: 36_000}), {:position, :heading}) == 0.0
  end

  test "a height is known without a place" do
    state = apply_message(%M.GlobalPositionInt{lat: 0, lon: 0, alt: 584_000, relative_alt: 20_500})
    assert %{lat: nil, lon: nil, alt_msl: 584.0, alt_rel: 20.5} = State.data(state, :position)
    assert value(apply_message(%M.GlobalPositionInt{relative_alt: -300}), {:position, :alt_rel}) == -0.3
    assert value(apply_message(%M.GlobalPositionInt{}), {:position, :alt_rel}) == nil
    assert %{lat: nil, alt_msl: 584.0} = State.data(apply_message(%M.GpsRawInt{alt: 584_000}), :gps)
  end

  test "whatever a message has, no field of the state has a number that no vehicle can have" do
    ratio = {0.0, 1.0}
    limits = %{throttle: ratio, load: ratio, rssi: ratio, remaining: ratio, lat: {-90, 90}, lon: {-180, 180}}
    limits = Map.put(limits, :heading, {0.0, 359.99})

    modules = [
      M.GlobalPositionInt,
      M.VfrHud,
      M.SysStatus,
      M.RcChannels,
      M.HighLatency2,
      M.BatteryStatus,
      M.GpsRawInt
    ]

    :rand.seed(:exsss, {20, 20, 20})

    for module <- modules, _ <- 1..500, autopilot <- [:ardupilot, :px4] do
      {:ok, message} = MavCodec.Dialects.All.decode(module.id(), :rand.bytes(60))

      with {%State{} = state, _groups} <- State.apply(%State{autopilot: autopilot}, module.id(), message, 1) do
        for {group, keys} <- State.Groups.keys(), key <- keys, {low, high} <- [limits[key]] do
          value = State.data(state, group)[key]

          assert value == nil or (value >= low and value <= high),
                 "#{group}.#{key} is #{value} of #{inspect(message)}"
        end
      end
    end
  end
end
