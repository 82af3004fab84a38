defmodule SimVehicle.MspTest do
  @moduledoc "The simulated Betaflight and iNav have the habits of the real ones, which were seen on their firmware."
  use ExUnit.Case, async: true

  alias MavCodec.Msp.{Frame, Messages, Parser, Payload}
  alias SimVehicle.Msp
  alias SimVehicle.Msp.{Firmware, Pilot}

  @second 1_000_000
  @low [1500, 1500, 1000, 1500, 1000, 1000, 1000, 1000]
  @armed [1500, 1500, 1000, 1500, 1900, 1000, 1000, 1000]

  defp on(firmware, options \\ []) do
    {fc, []} =
      firmware
      |> Firmware.new(options)
      |> Firmware.connect(:a)
      |> Firmware.sticks(@low)
      |> Firmware.step(6 * @second)

    fc
  end

  defp after_s(fc, seconds), do: fc |> Firmware.step(round(seconds * @second)) |> elem(0)

  # A request and what comes back for it, with the next turn of the firmware.
  defp ask(fc, bytes, port \\ :a) do
    {fc, first} = Firmware.receive(fc, port, bytes)
    {fc, second} = Firmware.step(fc, 10_000)
    {for({^port, out} <- first ++ second, into: <<>>, do: out), fc}
  end

  defp request(fc, id, payload \\ "", form \\ :v2) do
    {bytes, fc} = ask(fc, Frame.encode(%Frame{form: form, id: id, payload: payload}))
    {frames, _parser} = Parser.push(Parser.new(), bytes)
    {Enum.map(frames, &{&1.direction, &1.payload}), fc}
  end

  defp read(fc, name) do
    {:ok, message} = Messages.fetch(fc.firmware, name)
    {[{:reply, payload}], _fc} = request(fc, message.id)
    {:ok, values} = Payload.decode(message.reply, payload, fc.version)
    values
  end

  describe "both" do
    test "arm by the switch, change the mode by another, and fly" do
      for firmware <- [:betaflight, :inav] do
        fc = firmware |> on() |> Firmware.sticks(@armed) |> after_s(0.1)
        assert fc.armed and :armed in fc.events
        fc = fc |> Firmware.sticks([1500, 1700, 1800, 1600, 1900, 1900, 1000, 1000]) |> after_s(5)
        assert MapSet.equal?(fc.boxes, MapSet.new([0, 1]))
        assert %{altitude: altitude, vario: 300} = read(fc, "ALTITUDE")
        assert_in_delta altitude, 1500, 20
        # The stick forward: the nose is down, which MSP calls positive.
        assert %{pitch: 120} = read(fc, "ATTITUDE")
        assert %{ground_speed: 400} = read(fc, "RAW_GPS")
        fc = fc |> Firmware.sticks(@low) |> after_s(0.1)
        refute fc.armed
      end
    end

    test "do not arm with the throttle up, and say why" do
      for {firmware, name, field, bit} <- [
            {:betaflight, "STATUS_EX", :arming_disable_flags, 7},
            {:inav, "MSP2_INAV_STATUS", :arming_flags, 19}
          ] do
        fc = firmware |> on() |> Firmware.sticks(List.replace_at(@armed, 2, 1500)) |> after_s(0.1)
        refute fc.armed
        assert Bitwise.band(read(fc, name)[field], Bitwise.bsl(1, bit)) != 0
      end
    end

    test "half a frame waits for ever, and swallows what comes" do
      for firmware <- [:betaflight, :inav] do
        <<head::binary-size(6), _tail::binary>> = Frame.encode(%Frame{id: 108, payload: <<0, 0, 0>>})
        {"", fc} = firmware |> on() |> ask(head)
        fc = after_s(fc, 60)
        assert {[], fc} = request(fc, 109)
        assert {[{:reply, _}], _fc} = request(fc, 109)
      end
    end

    test "take 192 bytes, answer in the form of the request, refuse what they do not know" do
      for firmware <- [:betaflight, :inav], form <- [:v2, :v2_over_v1] do
        {[{:error, ""}], fc} = request(on(firmware), 0x4242, :binary.copy(<<0>>, 192), form)
        assert {[{:reply, _}], _fc} = request(fc, 1, "", form)
      end

      assert {[], _fc} = request(on(:inav), 1, :binary.copy(<<0>>, 193))
      # Replies and damaged frames are not answered.
      {"", fc} = ask(on(:betaflight), Frame.encode(%Frame{id: 1, direction: :reply}))
      {"", fc} = ask(fc, "$M<" <> <<0, 1, 9>>)
      assert {[{:reply, _}], _fc} = request(fc, 1, "", :v1)
    end

    test "the command line: # opens it, it echoes what can be printed, arming is blocked, exit restarts" do
      {banner, fc} = ask(on(:betaflight), "#")
      assert banner =~ "Entering CLI Mode"
      assert {"$M<", fc} = ask(fc, Frame.encode(%Frame{id: 1}))
      refute fc |> Firmware.sticks(@armed) |> after_s(0.2) |> Map.get(:armed)
      {_echo, fc} = ask(fc, "\rexit\r")
      assert fc.boots == 2
      fc = after_s(fc, 2)
      assert {[{:reply, _}], _fc} = request(fc, 1)
    end
  end

  describe "Betaflight" do
    test "one request of a port in ten milliseconds" do
      three = for id <- [1, 2, 3], into: <<>>, do: Frame.encode(%Frame{id: id})
      {fc, []} = Firmware.receive(on(:betaflight), :a, three)
      {fc, [_one]} = Firmware.step(fc, 10_000)
      {_fc, [_two, _three]} = Firmware.step(fc, 20_000)
    end

    test "a short write is acknowledged, and filled with what is in the buffer" do
      {[{:reply, ""}], fc} = request(on(:betaflight), 202, :binary.copy(<<77>>, 15))
      {[{:reply, ""}], fc} = request(fc, 202, <<1, 2, 3>>)
      assert %{p_roll: 1, d_roll: 3, p_pitch: 77} = read(fc, "PID")
    end

    test "dies of 200 bytes" do
      {[], fc} = request(on(:betaflight), 1, :binary.copy(<<0>>, 200))
      assert fc.dead and :crashed in fc.events
      assert {[], _fc} = request(after_s(fc, 10), 1)
    end

    test "MULTIPLE_MSP carries out writes" do
      {[{:reply, <<6, _attitude::binary-size(6), 0>>}], fc} = request(on(:betaflight), 230, <<108, 202>>)
      assert fc.blocks[112] != Firmware.new(:betaflight).blocks[112]
    end

    test "restarts although it is armed; calibrations are acknowledged and ignored; the EEPROM is not written" do
      fc = :betaflight |> on() |> Firmware.sticks(@armed) |> after_s(0.1)
      assert {[{:error, ""}], fc} = request(fc, 250)
      assert {[{:reply, ""}], fc} = request(fc, 205)
      refute {:calibrating, 205} in fc.events
      assert {[{:reply, <<0>>}], fc} = request(fc, 68)
      assert :rebooted in fc.events and not fc.armed
      assert {[], _fc} = request(fc, 1)
    end

    test "what was not stored is gone after a restart, what was is not" do
      {[_], fc} = request(on(:betaflight), 202, :binary.copy(<<77>>, 15))
      {[_], fc} = request(fc, 68)
      fc = after_s(fc, 2)
      assert %{p_roll: 45} = read(fc, "PID")
      {[_], fc} = request(fc, 202, :binary.copy(<<77>>, 15))
      {[_], fc} = request(fc, 250)
      {[_], fc} = request(fc, 68)
      assert %{p_roll: 77} = fc |> after_s(2) |> read("PID")
    end

    test "arming that a port disabled stays so when its client is gone" do
      fc = on(:betaflight)
      {[{:reply, ""}], fc} = request(fc, 99, <<1>>)
      fc = Firmware.connect(fc, :b)
      refute fc |> Firmware.sticks(@armed) |> after_s(0.2) |> Map.get(:armed)
      {[{:reply, ""}], fc} = request(fc, 99, <<0>>)
      assert fc |> Firmware.sticks(@armed) |> after_s(0.2) |> Map.get(:armed)
    end

    test "without its receiver: a flag, then a failsafe that drops it, and the switch must go off first" do
      fc =
        :betaflight
        |> on()
        |> Firmware.sticks(@armed)
        |> after_s(0.2)
        |> Firmware.lose_rc(true)
        |> after_s(0.3)

      assert fc.armed and Bitwise.band(Firmware.arming_flags(fc), 0b100) != 0
      fc = after_s(fc, 1.5)
      assert not fc.armed and 27 in fc.boxes
      fc = fc |> Firmware.lose_rc(false) |> Firmware.sticks(@armed) |> after_s(1)
      refute fc.armed
      fc = fc |> Firmware.sticks(@low) |> after_s(0.2) |> Firmware.sticks(@armed) |> after_s(0.2)
      assert fc.armed
    end
  end

  describe "iNav" do
    test "answers at once, and not at all if asked to be silent" do
      {_fc, [{:a, _reply}]} = Firmware.receive(on(:inav), :a, Frame.encode(%Frame{id: 1}))
      {_fc, []} = Firmware.receive(on(:inav), :a, Frame.encode(%Frame{form: :v2, flags: 1, id: 1}))
    end

    test "refuses wrong lengths, and what must not be done while it is armed" do
      assert {[{:error, ""}], fc} = request(on(:inav), 35, :binary.copy(<<0>>, 7))
      assert {[{:reply, ""}], fc} = request(fc, 35, <<5, 1, 0, 10, 20>>)
      fc = fc |> Firmware.sticks(@armed) |> after_s(0.2)
      for id <- [250, 205, 206, 68, 210], do: assert({[{:error, ""}], _fc} = request(fc, id))
    end

    test "its settings, by name and by number" do
      fc = on(:inav)
      assert {[{:reply, <<1>>}], _fc} = request(fc, 0x1003, "nav_wp_multi_mission_index" <> <<0>>)
      {[{:reply, ""}], fc} = request(fc, 0x1004, "nav_wp_multi_mission_index" <> <<0, 7>>)
      assert {[{:reply, <<7>>}], fc} = request(fc, 0x1003, "nav_wp_multi_mission_index" <> <<0>>)
      # Above its limit, too short, unknown, without the NUL.
      for wrong <- [
            "nav_wp_multi_mission_index" <> <<0, 10>>,
            "nav_rth_altitude" <> <<0, 1>>,
            "nope" <> <<0, 1>>,
            "small_angle"
          ],
          do: assert({[{:error, ""}], _fc} = request(fc, 0x1004, wrong))

      {[{:reply, info}], _fc} = request(fc, 0x1007, <<0, 0, 0>>)
      assert "looptime" <> <<0, _::binary>> = info
    end

    test "without its receiver it comes down by itself" do
      fc =
        :inav
        |> on(flight: %{alt: 50.0})
        |> Firmware.sticks(@armed)
        |> after_s(0.2)
        |> Firmware.lose_rc(true)
        |> after_s(2)

      assert fc.armed and 27 in fc.boxes
      assert %{vario: -150} = read(fc, "ALTITUDE")
    end
  end

  test "as a process at a TCP port: three clients, and no fourth" do
    sim = start_supervised!({Msp, firmware: :inav, uid: 5, pilot: true})
    connect = fn -> :gen_tcp.connect({127, 0, 0, 1}, Msp.port(sim), [:binary, active: false]) |> elem(1) end
    clients = for _ <- 1..3, do: connect.()

    for socket <- clients do
      :ok = :gen_tcp.send(socket, Frame.encode(%Frame{id: 2}))
      assert {:ok, "$M>" <> <<4, 2, "INAV", _sum>>} = :gen_tcp.recv(socket, 0, 5_000)
    end

    assert {:error, :closed} = :gen_tcp.recv(connect.(), 0, 5_000)
    :ok = :gen_tcp.close(hd(clients))
    assert Msp.state(sim).blocks[160] == <<5::32-little, 0::64>>
    assert Msp.await(sim, &(&1.now > 100_000))
  end

  test "the pilot flies in the same way again and again" do
    armed = fn s -> Enum.at(Pilot.channels(s * @second), 4) > 1700 end
    assert Enum.chunk_by(0..149, armed) |> Enum.map(&length/1) == [10, 117, 23]
    assert Pilot.channels(5 * @second) == Pilot.channels(155 * @second)
  end
end
