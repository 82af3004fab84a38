defmodule Msp.ParamsTest do
  use ExUnit.Case, async: true

  alias MavCodec.Message.Value
  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.{Frame, Messages, Params, Payload, ShortName}
  alias Msp.Params.Block
  alias Msp.Test.{Line, Simulated}
  alias SimVehicle.Msp.Firmware

  @second 1_000_000

  defp up(firmware, seconds \\ 3, options \\ []) do
    {answer, change, state} = Simulated.controller(firmware, options)
    line = Line.open(fn bytes, us -> with("" <- answer.(bytes, us), do: nil) end)
    {Line.run(line, seconds * @second), change, state}
  end

  defp send_mavlink(line, message),
    do:
      Line.handle(
        line,
        {:mavlink,
         MavCodec.encode(%{message | target_system: 42, target_component: 1}, system: 237, component: 191)}
      )

  defp list(line), do: line |> send_mavlink(%M.ParamRequestList{}) |> Line.run(30 * @second)

  defp read(line, name),
    do:
      line
      |> send_mavlink(%M.ParamRequestRead{param_id: ShortName.of(name), param_index: -1})
      |> Line.run(@second)

  defp set(line, name, value),
    do:
      line
      |> send_mavlink(%M.ParamSet{param_id: ShortName.of(name), param_value: value * 1.0, param_type: 9})
      |> Line.run(3 * @second)

  defp values(line),
    do: for({_at, value} <- Line.told(line, M.ParamValue), do: %{value | param_value: shown(value)})

  # As QGroundControl's ParameterManager reads every autopilot but ArduPilot: the union's member of the type.
  defp shown(%{param_type: type, param_value: wire}) do
    case {type, <<Value.bits32(wire)::32-little>>} do
      {1, <<n, _::binary>>} -> n
      {2, <<n::signed, _::binary>>} -> n
      {3, <<n::16-little, _::binary>>} -> n
      {4, <<n::16-little-signed, _::binary>>} -> n
      {5, <<n::32-little>>} -> n
      {6, <<n::32-little-signed>>} -> n
      {9, <<n::32-little-float>>} -> n
    end
  end

  # As it sets one: the union's member, in a union that is zero before.
  defp union(1, n), do: <<n, 0::24>>
  defp union(2, n), do: <<n::signed, 0::24>>
  defp union(3, n), do: <<n::16-little, 0::16>>
  defp union(4, n), do: <<n::16-little-signed, 0::16>>
  defp union(5, n), do: <<n::32-little>>
  defp union(6, n), do: <<n::32-little-signed>>
  defp union(9, n), do: <<n::32-little-float>>

  defp set_bytes(line, name, type, <<bits::32-little>>) do
    message = %M.ParamSet{param_id: ShortName.of(name), param_value: Value.float32(bits), param_type: type}
    line |> send_mavlink(message) |> Line.run(3 * @second)
  end

  defp last(line, name),
    do: line |> values() |> Enum.filter(&(&1.param_id == ShortName.of(name))) |> List.last()

  defp errors(line),
    do:
      for(
        {_at, error} <- Line.told(line, M.ParamError),
        do: {Params.full(:betaflight, error.param_id), error.error}
      )

  defp texts(line), do: for({_at, text} <- Line.told(line, M.Statustext), do: text.text)

  describe "Betaflight by name, from API 1.48 on" do
    @named [api: {1, 48}]

    test "the list has what is in blocks and what is not, each once, telemetry going on meanwhile" do
      {line, _change, _state} = up(:betaflight, 3, @named)
      line = list(line)
      values = values(line)
      names = for value <- values, do: Params.full(:betaflight, value.param_id)
      named = for %{block: nil, name: name} <- Params.all(:betaflight, {1, 48}), do: name
      assert named -- names == [] and length(names) > 380 and Enum.uniq(names) == names
      assert Enum.map(values, & &1.param_index) == Enum.to_list(0..(length(values) - 1))
      assert %{param_value: 2, param_type: 6} = last(line, "yaw_spin_recovery")
      assert %{param_value: 1950, param_type: 6} = last(line, "yaw_spin_threshold")
      assert %{param_value: 45} = last(line, "p_roll")
      beats = for {at, _} <- Line.told(line, M.Heartbeat), do: at
      assert beats |> Enum.chunk_every(2, 1, :discard) |> Enum.all?(fn [a, b] -> b - a < 1.4 * @second end)
    end

    test "one is set by name: a number, a word, a field of a block, and nothing else changes" do
      {line, _change, state} = up(:betaflight, 3, @named)
      before = state.()
      line = line |> set("acc_lpf_hz", 40) |> set("yaw_spin_recovery", 1) |> set("p_pitch", 48)
      assert %{param_value: 40, param_type: 6} = last(line, "acc_lpf_hz")
      assert %{param_value: 1} = last(line, "yaw_spin_recovery")
      assert %{param_value: 48} = last(line, "p_pitch")
      now = state.()
      assert %{"acc_lpf_hz" => 40, "yaw_spin_recovery" => 1} = now.settings
      assert for({id, bytes} <- now.blocks, bytes != before.blocks[id], do: id) == [112]

      assert Map.drop(now.settings, ["acc_lpf_hz", "yaw_spin_recovery"]) ==
               Map.drop(before.settings, ["acc_lpf_hz", "yaw_spin_recovery"])

      # No block is written.
      assert for({_at, "$M<" <> <<_, 202, _::binary>>} <- line.written, do: :set_pid) == []
      assert Enum.count(texts(line), &(&1 =~ "Settings changed")) == 1
    end

    test "what does not fit, is text, or is not there, is refused; a name of any build may be asked for" do
      {line, _change, state} = up(:betaflight, 3, @named)
      before = state.().settings

      line =
        line
        |> set("acc_lpf_hz", 501)
        |> set("acc_lpf_hz", 12.5)
        |> set("yaw_spin_recovery", 3)
        |> set("craft_name", 1)
        |> set("none_such", 1)
        |> read("none_such")

      assert errors(line) == [
               {"acc_lpf_hz", 2},
               {"acc_lpf_hz", 2},
               {"yaw_spin_recovery", 2},
               {"craft_name", 1},
               {"none_such", 1},
               {"none_such", 1}
             ]

      assert state.().settings == before
      assert Enum.any?(texts(line), &(&1 =~ "it goes from 0 to 500"))
    end

    test "a name that would be a write is never asked for" do
      {line, _change, state} = up(:betaflight, 3, @named)
      before = state.().settings

      for name <- ["acc_lpf_hz=40", "acc_lpf_hz = 40", "craft_name=x", "a\nb=1", "="] do
        line = read(%{line | written: [], told: []}, name)
        assert [{^name, 1}] = errors(line)

        assert for(
                 {_at, "$X<" <> <<_, id::16-little, _::binary>>} <- line.written,
                 id in [0x3010, 0x3011],
                 do: id
               ) == []
      end

      assert state.().settings == before
    end

    test "a build without a command line: what is in a block is read and set there" do
      {answer, _change, state} = Simulated.controller(:betaflight, @named)

      without = fn
        <<"$X<", _flags, id::16-little, _::binary>> = bytes, us when id in [0x3010, 0x3011] ->
          _ = answer.(binary_part(bytes, 0, 0), us)
          IO.iodata_to_binary(Frame.encode(%Frame{form: :v2, direction: :error, id: id}))

        bytes, us ->
          with("" <- answer.(bytes, us), do: nil)
      end

      line = without |> Line.open() |> Line.run(3 * @second) |> set("p_pitch", 48) |> read("acc_lpf_hz")
      assert %{param_value: 48} = last(line, "p_pitch")
      assert <<_::binary-size(3), 48, _::binary>> = state.().blocks[112]
      assert errors(line) == [{"acc_lpf_hz", 1}]
      line = list(%{line | told: []})
      assert length(values(line)) > 180
    end

    test "while it is armed nothing is set, and reading goes on" do
      {line, change, state} = up(:betaflight, 7, @named)
      change.(&Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1900, 1000, 1000, 1000]))
      line = Line.run(line, 2 * @second)
      assert state.().armed
      line = line |> set("acc_lpf_hz", 40) |> read("acc_lpf_hz")
      assert errors(line) == [{"acc_lpf_hz", 3}]
      assert %{param_value: 25} = last(line, "acc_lpf_hz")
    end
  end

  describe "Betaflight" do
    test "the list: each parameter of its build once, numbered without gaps, telemetry going on meanwhile" do
      {line, _change, _state} = up(:betaflight)
      line = list(line)
      values = values(line)
      assert length(values) > 180
      assert Enum.map(values, & &1.param_index) == Enum.to_list(0..(length(values) - 1))
      assert Enum.all?(values, &(&1.param_count == length(values)))
      assert %{param_value: 45, param_type: 6} = last(line, "p_roll")
      assert %{param_value: 15} = last(line, "failsafe_delay")
      assert %{param_value: 330, param_type: 6} = last(line, "vbat_min_cell_voltage")
      # 25 %, which is 1250 on the wire.
      assert %{param_value: 25} = last(line, "airmode_start_throttle_percent")
      beats = for {at, _} <- Line.told(line, M.Heartbeat), do: at
      assert beats |> Enum.chunk_every(2, 1, :discard) |> Enum.all?(fn [a, b] -> b - a < 1.4 * @second end)
    end

    test "one is set, nothing else changes, and what is then there is reported" do
      {line, _change, state} = up(:betaflight)
      before = state.().blocks
      line = set(line, "p_pitch", 48)
      assert %{param_value: 48} = last(line, "p_pitch")
      now = state.().blocks
      assert for({id, bytes} <- now, bytes != before[id], do: id) == [112]
      <<a::binary-size(3), _old, b::binary>> = before[112]
      assert <<^a::binary-size(3), 48, ^b::binary>> = now[112]

      assert "Settings changed, not stored yet: the next res" <> _ =
               List.last(Enum.filter(texts(line), &(&1 =~ "Settings")))

      # Once.
      line = set(line, "p_roll", 46)
      assert Enum.count(texts(line), &(&1 =~ "Settings changed")) == 1
    end

    test "a write of every parameter changes its bytes and no others, in each block" do
      {line, _change, state} = up(:betaflight)
      line = list(line)

      now =
        for value <- values(line),
            into: %{},
            do: {Params.full(:betaflight, value.param_id), trunc(value.param_value)}

      Enum.reduce(Params.all(:betaflight, {1, 46}), line, fn param, line ->
        with true <-
               is_map_key(now, param.name) and
                 param.block not in ["OSD_CONFIG", "VTX_CONFIG", "SIMPLIFIED_TUNING"],
             now = now[param.name],
             other when other != nil <- other(param, now) do
          before = state.().blocks
          # What was told before is of no interest any more.
          line = set(%{line | told: []}, param.name, other)
          assert {param.name, trunc(last(line, param.name).param_value)} == {param.name, other}
          {:ok, block} = Messages.fetch(:betaflight, param.block)
          assert for({id, bytes} <- state.().blocks, bytes != before[id], do: id) == [block.id], param.name
          {:ok, old} = Payload.decode(block.reply, before[block.id], {1, 46})
          {:ok, new} = Payload.decode(block.reply, state.().blocks[block.id], {1, 46})
          changed = for {key, value} <- new, old[key] != value, do: key
          assert param.field in changed and length(changed) <= 2, "#{param.name}: #{inspect(changed)}"
          line
        else
          _left_out -> line
        end
      end)
    end

    defp other(%{low: nil, values: []}, _now), do: nil
    defp other(%{values: [_ | _] = words}, now), do: rem(now + 1, length(words))

    defp other(%{low: low, high: high}, now),
      do: Enum.find([now + 1, now - 1, low, high], &(&1 in low..high and &1 != now))

    test "refused: unknown, out of range, not whole, while it is armed" do
      {line, change, state} = up(:betaflight, 7)
      before = state.().blocks
      line = set(line, "no_such_thing", 1)
      assert {"no_such_thing", 1} in errors(line)
      line = set(line, "p_roll", 251)
      assert {"p_roll", 2} in errors(line)
      line = set(line, "failsafe_procedure", 3)
      assert {"failsafe_procedure", 2} in errors(line)
      line = set(line, "p_roll", 1.5)
      assert Enum.count(errors(line), &(&1 == {"p_roll", 2})) == 2
      assert "p_roll: it is a whole number" in texts(line)
      change.(&Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1900]))
      line = line |> Line.run(2 * @second) |> set("p_roll", 50)
      assert {"p_roll", 3} in errors(line)
      assert "p_roll not set: it is armed" in texts(line)
      assert state.().blocks == before
    end

    test "the range and the words are those of its version, which is 4.5" do
      {line, _change, state} = up(:betaflight)
      before = state.().blocks

      for {name, value, why} <- [
            {"gps_rescue_throttle_hover", 0, "it goes from 1000 to 2000"},
            {"gps_rescue_throttle_min", 900, "it goes from 1000 to 2000"},
            {"gps_rescue_max_angle", 70, "it goes from 30 to 60"},
            {"failsafe_off_delay", 250, "it goes from 0 to 200"},
            # MAVLINK is the 16th of 2026.6.
            {"serialrx_provider", 16, "it goes from 0 to 15"},
            {"motor_pwm_protocol", 10, "it goes from 0 to 9"},
            {"vtx_low_power_disarm", 3, "it goes from 0 to 2"}
          ] do
        line = set(line, name, value)
        assert {name, 2} in errors(line)
        assert Enum.join(texts(line)) =~ "#{name}: #{why}"
        assert state.().blocks == before
      end

      line = line |> set("gps_rescue_throttle_hover", 1900) |> set("serialrx_provider", 15)
      assert %{param_value: 1900} = last(line, "gps_rescue_throttle_hover")
      assert %{param_value: 15} = last(line, "serialrx_provider")
      line = set(line, "ap_hover_throttle", 1300)
      assert {"ap_hover_throttle", 1} in errors(line)
    end

    test "by index, once the list is known" do
      {line, _change, _state} = up(:betaflight)
      line = line |> send_mavlink(%M.ParamRequestRead{param_index: 0, param_id: ""}) |> Line.run(@second)
      assert [{"", 1}] = errors(line)
      line = list(line)
      count = length(values(line))
      line = line |> send_mavlink(%M.ParamRequestRead{param_index: 3, param_id: ""}) |> Line.run(@second)
      assert [%{param_index: 3}] = Enum.drop(values(line), count)
    end

    test "a build without a part has no parameters of it" do
      {line, change, _state} = up(:betaflight)
      change.(fn fc -> %{fc | blocks: Map.delete(fc.blocks, 135)} end)
      line = list(line)
      refute last(line, "gps_rescue_return_alt")
      assert {"gps_rescue_return_alt", 1} in errors(read(line, "gps_rescue_return_alt"))
    end
  end

  describe "blocks" do
    test "a value that stands in two places changes in both" do
      {:ok, filter} = Messages.fetch(:betaflight, "FILTER_CONFIG")
      {:ok, v} = Payload.decode(filter.reply, :binary.copy(<<0>>, 49), {1, 46})

      assert %{gyro_lpf1_static_hz: 500, gyro_lpf1_static_hz_low8: 0xF4} =
               Block.put(v, :gyro_lpf1_static_hz, 500)

      assert %{cell_min_cv: 337, cell_min: 34} =
               Block.put(%{cell_min_cv: 330, cell_min: 33}, :cell_min_cv, 337)
    end

    test "the writes of OSD and VTX have layouts of their own" do
      osd = %{
        video_system: 1,
        units: 1,
        rssi_alarm: 20,
        cap_alarm: 2200,
        alt_alarm: 100,
        warnings16: 7,
        enabled_warnings: 7,
        profile: 1
      }

      assert %{
               address: -1,
               data: <<1, 1, 20, 2200::16-little, 0::16, 100::16-little, 7::16-little, 7::32-little, 1>>
             } = Block.writing("OSD_CONFIG", osd)

      vtx = %{
        band: 5,
        channel: 8,
        power: 2,
        pit_mode: 0,
        frequency: 5917,
        low_power_disarm: 0,
        pit_frequency: 0
      }

      assert %{frequency: 39, exact_frequency: 5917, band: 5} = Block.writing("VTX_CONFIG", vtx)
      assert %{frequency: 5800} = Block.writing("VTX_CONFIG", %{vtx | band: 0, frequency: 5800})
    end
  end

  describe "iNav" do
    test "its settings are read ahead; the list then has all numbers, and no text" do
      {line, _change, _state} = up(:inav, 20)
      assert values(line) == []
      line = list(line)
      numbers = for %{type: type, name: name} <- Params.all(:inav, {9, 0}), type != "str", do: name
      assert Enum.map(values(line), &Params.full(:inav, &1.param_id)) == numbers
      assert Enum.map(values(line), & &1.param_index) == Enum.to_list(0..(length(numbers) - 1))
      assert %{param_type: 9} = last(line, "pitot_scale")
    end

    test "a list that was read before is reported as it is read, each once: a client that waits in vain asks again" do
      {line, _change, _state} = up(:inav, 20)
      line = %{list(line) | told: []}
      line = line |> send_mavlink(%M.ParamRequestList{}) |> Line.run(@second)
      assert length(values(line)) in 10..600
      line = line |> send_mavlink(%M.ParamRequestList{}) |> Line.run(30 * @second)
      assert Enum.map(values(line), & &1.param_index) == Enum.to_list(0..625)
      assert Enum.all?(values(line), &(&1.param_count == 626))
    end

    test "one is set by its full name, and read again" do
      {line, _change, state} = up(:inav)
      line = set(line, "nav_rth_altitude", 5000)
      assert %{param_value: 5000, param_type: 6} = last(line, "nav_rth_altitude")
      assert state.().settings["nav_rth_altitude"] == <<5000::16-little>>
      # The firmware takes what is below its least value.
      line = set(line, "nav_fw_launch_thr", 900)
      assert "nav_fw_launch_thr: it goes from 1000 to 2000" in texts(line)
      assert state.().settings["nav_fw_launch_thr"] == <<1000::16-little>>
      line = set(line, "name", 1)
      assert Enum.any?(texts(line), &(&1 =~ "name: it is text"))
    end

    test "what is not stored is gone after a restart" do
      {line, _change, state} = up(:inav)
      line = set(line, "small_angle", 90)
      line = line |> Line.handle({:mavlink, command(246, %{param1: 1.0})}) |> Line.run(6 * @second)
      assert state.().boots == 2
      assert %{param_value: 0} = line |> read("small_angle") |> last("small_angle")
      line = set(line, "small_angle", 90)
      line = line |> Line.handle({:mavlink, command(245, %{param1: 1.0})}) |> Line.run(@second)
      line = line |> Line.handle({:mavlink, command(246, %{param1: 1.0})}) |> Line.run(6 * @second)
      assert %{param_value: 90} = line |> read("small_angle") |> last("small_angle")
    end
  end

  describe "as ground stations read and set them (P2)" do
    test "every value that QGroundControl shows is the one aboard" do
      {line, change, state} = up(:inav, 20)

      odd = fn {name, bytes} ->
        {name, odd(Enum.find(Params.all(:inav, {9, 0}), &(&1.name == name)), bytes)}
      end

      change.(fn fc -> %{fc | settings: Map.new(fc.settings, odd)} end)
      line = list(line)
      types = Map.new(Params.all(:inav, {9, 0}), &{&1.name, &1.type})
      aboard = state.().settings
      assert length(values(line)) == 626

      for %{param_id: short, param_value: value, param_type: type} <- values(line) do
        name = Params.full(:inav, short)
        assert {name, binary_part(union(type, value), 0, byte_size(aboard[name]))} == {name, aboard[name]}
        assert type == if(types[name] == "f32", do: 9, else: 6) or (types[name] == "u32" and type == 5)
      end
    end

    # Its highest value, or its lowest where that is below 0.
    defp odd(%{type: "str"}, bytes), do: bytes
    defp odd(%{type: "f32"} = row, _bytes), do: <<row.high * 1.0::32-little-float>>
    defp odd(row, bytes), do: <<if(row.low < 0, do: row.low, else: row.high)::size(bit_size(bytes))-little>>

    test "what QGroundControl and MAVSDK send is set, of each type" do
      {line, _change, state} = up(:inav)

      for {name, type, value, bytes} <- [
            {"small_angle", 1, 179, <<179>>},
            {"blackbox_arm_control", 2, -1, <<-1>>},
            {"nav_rth_altitude", 3, 65_000, <<65_000::16-little>>},
            {"align_mag_roll", 4, -1800, <<-1800::16-little>>},
            {"msp_override_channels", 5, 4_026_531_841, <<4_026_531_841::32-little>>},
            {"pitot_scale", 9, 1.5, <<1.5::32-little-float>>},
            {"small_angle", 6, 25, <<25>>},
            {"align_mag_roll", 6, -7, <<-7::16-little>>}
          ] do
        line = set_bytes(line, name, type, union(type, value))
        assert {name, state.().settings[name]} == {name, bytes}
        assert %{param_value: ^value} = last(line, name)
      end
    end

    test "a script's number is set as REAL32; with an integer's type it is refused: an old QGroundControl may mean 0" do
      {line, _change, state} = up(:betaflight)
      line = set(line, "p_roll", 47)
      assert %{param_value: 47} = last(line, "p_roll")
      before = state.().blocks
      line = set_bytes(%{line | told: []}, "p_roll", 1, <<50.0::32-little-float>>)
      assert errors(line) == [{"p_roll", 7}] and state.().blocks == before

      assert Enum.join(texts(line)) =~ "p_roll not set: it has an integer's type, and its float is a number"

      line = set_bytes(%{line | told: []}, "gps_rescue_return_alt", 3, <<50.0::32-little-float>>)
      assert errors(line) == [{"gps_rescue_return_alt", 7}]
      # Other bytes of memory behind the value.
      line = set_bytes(line, "p_roll", 1, <<51, 0xC3, 0x47, 0x7F>>)
      assert %{param_value: 51} = last(line, "p_roll")
      line = set_bytes(line, "p_roll", 1, <<0, 0, 0xC0, 0x7F>>)
      assert %{param_value: 0} = last(line, "p_roll")
      line = set_bytes(%{line | told: []}, "p_roll", 9, <<0, 0, 0xC0, 0x7F>>)
      assert errors(line) == [{"p_roll", 7}]
    end

    test "a number that a float may have changed is not set" do
      {line, _change, state} = up(:inav)
      line = set(line, "msp_override_channels", 0xFFFFFF)
      assert %{param_value: 0xFFFFFF} = last(line, "msp_override_channels")
      before = state.().settings
      # Of 2^24 + 1.
      line = set(line, "msp_override_channels", 0x1000000)
      assert Enum.join(texts(line)) =~ "a float has no room for all its digits"
      assert state.().settings == before
    end

    test "MAVProxy writes names in capitals" do
      {line, _change, state} = up(:betaflight)

      line =
        line
        |> send_mavlink(%M.ParamSet{param_id: "P_PITCH", param_value: 48.0, param_type: 9})
        |> Line.run(3 * @second)

      assert %{param_id: "p_pitch", param_value: 48} = last(line, "p_pitch")
      assert <<_::binary-size(3), 48, _::binary>> = state.().blocks[112]
      capitals = String.upcase(ShortName.of("vbat_warning_cell_voltage"))

      line =
        line |> send_mavlink(%M.ParamRequestRead{param_id: capitals, param_index: -1}) |> Line.run(@second)

      assert %{param_value: 350} = last(line, "vbat_warning_cell_voltage")
    end

    test "a threshold whose number on the wire is below its least one is not shown as a large one" do
      {line, change, _state} = up(:betaflight)
      change.(fn fc -> put_in(fc.blocks[44], zero(fc.blocks[44], 14)) end)
      line = read(line, "airmode_start_throttle_percent")
      assert %{param_value: -100, param_type: 6} = last(line, "airmode_start_throttle_percent")
    end

    defp zero(bytes, at),
      do: binary_part(bytes, 0, at) <> <<0, 0>> <> binary_part(bytes, at + 2, byte_size(bytes) - at - 2)

    test "AUTOPILOT_VERSION says so" do
      for firmware <- [:betaflight, :inav] do
        {line, _change, _state} = up(firmware)
        line = line |> Line.handle({:mavlink, command(512, %{param1: 148.0})}) |> Line.run(@second)
        assert [{_at, %{capabilities: capabilities}} | _] = Line.told(line, M.AutopilotVersion)
        # MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE, and not _C_CAST
        assert Bitwise.band(capabilities, 16 + 131_072) == 16
      end
    end
  end

  defp command(number, fields),
    do:
      MavCodec.encode(struct!(%M.CommandLong{target_system: 42, command: number}, fields),
        system: 237,
        component: 191
      )
end
