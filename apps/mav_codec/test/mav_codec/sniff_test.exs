defmodule MavCodec.SniffTest do
  use ExUnit.Case, async: true

  alias MavCodec.Test.BaudModel
  alias MavCodec.Sniff

  doctest Sniff
  doctest MavCodec.CRC.DvbS2

  @fixtures Path.expand("../../../mav_router/test/fixtures/serial", __DIR__)
  defp fixture(name), do: File.read!(Path.join(@fixtures, name))

  describe "recordings of real firmware" do
    test "MAVLink 2 and 1 of ArduPilot, cut anywhere" do
      assert %{protocol: :mavlink2, heartbeat: true, confidence: confidence, evidence: evidence} =
               Sniff.classify(fixture("mavlink2.bin"))

      assert confidence > 0.99
      assert evidence =~ ~r/^\d+ frames of system 1, a heartbeat among them$/
      assert %{protocol: :mavlink1, heartbeat: true} = Sniff.classify(fixture("mavlink1.bin"))
    end

    test "ArduPilot's boot text, alone and before the first frames" do
      assert %{protocol: :console, heartbeat: false, evidence: evidence} =
               Sniff.classify(fixture("arducopter_boot.bin"))

      assert evidence =~ "ArduPilot starting"
      assert Sniff.classify(fixture("arducopter_boot.bin") <> fixture("mavlink2.bin")).protocol == :mavlink2
    end

    test "Betaflight: MSP of both versions, and its command line" do
      assert %{protocol: protocol, confidence: confidence, evidence: evidence} =
               Sniff.classify(fixture("betaflight_msp.bin"))

      assert protocol in [:msp1, :msp2] and confidence > 0.99
      assert evidence =~ "answers"
      assert Sniff.classify("$M>\x03\x01\x00\x01.-").protocol == :msp1
      assert Sniff.classify("$X>\x00\x01\x00\x03\x00\x00\x01.\x9c").protocol == :msp2
      assert Sniff.classify("$M>\x03\x01\x00\x01..").protocol == :noise

      assert %{protocol: :console, evidence: "the command line of Betaflight or iNav: " <> _} =
               Sniff.classify(fixture("betaflight_cli.txt"))
    end
  end

  describe "other devices" do
    test "an MSP message of more than 255 bytes" do
      payload = :binary.copy("x", 300)
      body = <<255, 116, 300::16-little, payload::binary>>
      sum = for <<byte <- body>>, reduce: 0, do: (sum -> Bitwise.bxor(sum, byte))
      assert %{protocol: :msp1, evidence: "1 message" <> _} = Sniff.classify(<<"$M>", body::binary, sum>>)
    end

    test "NMEA of a GPS receiver, a wrong checksum does not count" do
      sentences =
        "$GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M,55.2,M,,*76\r\n" <>
          "$GPGSA,A,3,10,07,05,02,29,04,08,13,,,,,1.72,1.03,1.38*0A\r\n"

      assert %{protocol: :nmea, evidence: "2 sentences (GPGGA, GPGSA)"} = Sniff.classify(sentences)

      assert Sniff.classify(String.replace(sentences, "5321", "5322") |> String.replace("1.38", "1.39")).protocol ==
               :console
    end

    test "UBX of a u-blox receiver" do
      # UBX-ACK-ACK of CFG-MSG.
      assert %{protocol: :ublox} = Sniff.classify(<<0, 0xB5, 0x62, 5, 1, 2, 0, 6, 1, 0x0F, 0x38, 0>>)
      assert %{protocol: :noise} = Sniff.classify(<<0, 0xB5, 0x62, 5, 1, 2, 0, 6, 1, 0x0F, 0x39, 0>>)
    end

    test "CRSF of a radio receiver; a single frame may be chance" do
      statistics = <<0x14, 16, 19, 99, 151, 1, 2, 3, 8, 88, 148>>
      frame = <<0xC8, 12, statistics::binary, MavCodec.CRC.DvbS2.of(statistics)>>

      assert %{protocol: :crsf, evidence: "3 frames (link statistics)"} =
               Sniff.classify(:binary.copy(frame, 3))

      assert %{protocol: :noise} = Sniff.classify(frame)
    end

    test "consoles" do
      for {text, who} <- [
            {"NuttShell (NSH) NuttX-11.0.0\r\nnsh> ", "PX4's console"},
            {"U-Boot 2022.04 (Nov 01 2022 - 10:00:00 +0000)\r\n", "the boot loader U-Boot"},
            {"[    0.000000] Linux version 6.1.0\r\n", "a Linux console"},
            {"rst:0x1 (POWERON_RESET),boot:0x13\r\n", "an ESP module starting"},
            {"something else that can be read\r\n", "text"}
          ] do
        assert %{protocol: :console, evidence: evidence} = Sniff.classify(text)
        assert String.starts_with?(evidence, who <> ": \"")
      end
    end
  end

  describe "a wrong baud rate" do
    test "is noise, whichever two rates it is" do
      heard = fixture("mavlink2.bin")
      rates = [9_600, 38_400, 57_600, 115_200, 230_400, 460_800, 500_000, 921_600]

      for sent <- rates, set <- rates, sent != set and abs(sent - set) * 10 > sent do
        garbled = BaudModel.receive(heard, sent, set)
        assert garbled != ""
        assert %{protocol: :noise} = Sniff.classify(garbled), "#{sent} heard at #{set}"
      end
    end

    test "the model itself: the right rate changes nothing, three percent off neither" do
      bytes = fixture("mavlink2.bin")
      assert BaudModel.receive(bytes, 57_600, 57_600) == bytes
      assert BaudModel.receive("a few bytes", 57_600, 59_000) == "a few bytes"
    end

    test "a steady pattern is reported as such" do
      assert Sniff.classify(:binary.copy(<<0>>, 50)).evidence =~ "all of them 0x00"
      assert Sniff.classify(:binary.copy("U", 50)).protocol == :noise
    end
  end

  test "any bytes get an answer of the right form" do
    property =
      :proper.forall(:proper_types.binary(), fn bytes ->
        pieces = ["$M>", <<0xB5, 0x62>>, <<0xC8, 40>>, "$GPGGA,", <<0xFD>>, <<0xFE, 9>>, ""]

        Enum.all?(pieces, fn piece ->
          %{protocol: protocol, confidence: confidence, evidence: evidence, heartbeat: heartbeat} =
            Sniff.classify(bytes <> piece <> bytes)

          Sniff.name(protocol) != "" and confidence >= 0 and confidence <= 1 and
            String.printable?(evidence) and heartbeat == false
        end)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end

  test "the worst case is bounded: only the last bytes are examined" do
    for worst <- ["$M>\xFF", <<0xB5, 0x62, 1, 1, 255, 15>>, <<0xC8, 62>>, "$GPGGA,", <<0xFD, 255, 0>>] do
      bytes = :binary.copy(worst, 100_000)
      {reductions, _} = {elem(Process.info(self(), :reductions), 1), Sniff.classify(bytes)}
      assert elem(Process.info(self(), :reductions), 1) - reductions < 20_000_000
    end

    assert Sniff.classify("$GPGLL,5057.970,N,00146.110,E,142451,A*27\r\n" <> :binary.copy(<<1>>, 5_000)).protocol ==
             :noise
  end
end
