defmodule MavCodec.SigningTest do
  use ExUnit.Case, async: true

  import MavCodec.Test.Wire

  alias MavCodec.{Frame, Messages, Parser, Signing}
  alias MavCodec.Test.Captures

  # 2026-11-20T22:28:02Z
  @now 1_795_213_682_000_000
  @key :crypto.hash(:sha256, "gateway-capture-signing-key")
  @minute 6_000_000

  defp new(options \\ []), do: Signing.new(@key, Keyword.put_new(options, :clock, fn -> @now end))

  defp frame(bytes) do
    {[frame], _} = Parser.push_datagram(Parser.new(), bytes)
    frame
  end

  # Signed by another end of the link.
  defp received(options \\ []) do
    {link, options} = Keyword.pop(options, :link_id, 5)
    {timestamp, options} = Keyword.pop(options, :timestamp, div(@now, 10) - 142_007_040_000_000)

    other =
      Signing.new(Keyword.get(options, :key, @key),
        link_id: link,
        clock: fn -> Signing.to_unix(timestamp) end
      )

    {bytes, _} =
      Signing.encode(other, %Messages.Heartbeat{}, Keyword.merge([system: 1], Keyword.delete(options, :key)))

    # The first stamp of a signer is one above its clock's.
    frame(bytes)
  end

  defp verdict(signing, frame), do: signing |> Signing.check(frame) |> elem(0)

  defp accept(signing, frame) do
    {verdict, signing} = Signing.check(signing, frame)
    assert verdict == :signed
    signing
  end

  describe "the recorded link" do
    test "S1: all 6,604 signed frames are right, the 4,435 others are told apart" do
      {frames, _} = Parser.push(Parser.new(), Captures.read("arducopter_signed.bin"))
      {verdicts, signing} = Enum.map_reduce(frames, new(), &Signing.check(&2, &1))
      assert Enum.frequencies(verdicts) == %{:signed => 6604, {:rejected, :unsigned} => 4435}
      # S5: the vehicle's clock was ahead of ours.
      assert Signing.timestamp(signing) >= List.last(frames).signature.timestamp
      # S3: nothing of it is accepted again.
      assert {{:rejected, :replayed}, ^signing} = Signing.check(signing, List.last(frames))
      assert {{:rejected, :replayed}, ^signing} = Signing.check(signing, Enum.find(frames, &Frame.signed?/1))
    end

    test "with another key, no frame is" do
      {frames, _} = Parser.push(Parser.new(), Captures.read("arducopter_signed.bin"))
      signing = Signing.new(:crypto.hash(:sha256, "another"), clock: fn -> @now end)

      for frame <- Enum.filter(frames, &Frame.signed?/1) do
        assert {{:rejected, :wrong_signature}, ^signing} = Signing.check(signing, frame)
      end
    end

    test "what the ground station sent" do
      {frames, _} = Parser.push(Parser.new(), Captures.read("arducopter_signed_tx.bin"))
      signed = Enum.filter(frames, &Frame.signed?/1)
      {verdicts, _} = Enum.map_reduce(signed, new(), &Signing.check(&2, &1))
      assert Enum.uniq(verdicts) == [:signed]
      assert Enum.all?(signed, &(&1.signature.link_id == 0))
    end
  end

  test "S1: the same bytes as pymavlink makes" do
    # MAVLink('', srcSystem=1, srcComponent=1), signing.secret_key = 0x00..0x1f, link_id 3, timestamp 123456789:
    # pack of HEARTBEAT(type 2, autopilot 3, base_mode 81, custom_mode 4, system_status 3), seq 0.
    expected =
      Base.decode16!("FD09010000010100000004000000020351030399DA" <> "0315CD5B070000" <> "C50E5F46E8AF")

    key = :binary.list_to_bin(Enum.to_list(0..31))
    signing = Signing.new(key, link_id: 3, clock: fn -> Signing.to_unix(123_456_788) end)

    message = %Messages.Heartbeat{
      type: 2,
      autopilot: 3,
      base_mode: 81,
      custom_mode: 4,
      system_status: 3,
      mavlink_version: 3
    }

    {bytes, _} = Signing.encode(signing, message, system: 1)
    assert bytes == expected
  end

  describe "sending" do
    test "S1, S2: thirteen bytes: link id, time stamp in 10 us since 2015, signature" do
      {bytes, signing} = Signing.encode(new(link_id: 9), %Messages.Heartbeat{}, system: 1)
      frame = frame(bytes)
      assert %Frame{incompat: 1, signature: %{link_id: 9, timestamp: timestamp, signature: <<_::48>>}} = frame
      assert timestamp == Signing.timestamp(signing)
      assert_in_delta Signing.to_unix(timestamp), @now, 20
      assert verdict(new(), frame) == :signed
    end

    test "S2, S12: strictly increasing, though the clock stands still" do
      {stamps, _} =
        Enum.map_reduce(1..1000, new(), fn _, signing ->
          {bytes, signing} = Signing.encode(signing, %Messages.Heartbeat{}, system: 1)
          {frame(bytes).signature.timestamp, signing}
        end)

      assert stamps == Enum.sort(stamps) |> Enum.uniq()
      assert length(stamps) == 1000
    end

    test "an unsigned frame is signed: flag, CRC, block" do
      {bytes, _} = Signing.sign(new(), attitude(), 39)
      {direct, _} = Signing.encode(new(), elem(MavCodec.decode(frame(attitude())), 1), system: 1)
      assert bytes == direct
      assert verdict(new(), frame(bytes)) == :signed
      assert Signing.strip(frame(bytes)) == frame(attitude())
    end

    test "version 1 has no signatures" do
      assert_raise MavCodec.Message.EncodeError, ~r/version/, fn ->
        Signing.sign(new(), heartbeat(version: 1), 50)
      end

      assert_raise MavCodec.Message.EncodeError, fn ->
        Signing.encode(new(), %Messages.Heartbeat{}, system: 1, version: 1)
      end
    end

    test "N2: the signature covers the longer header" do
      {bytes, _} = Signing.encode(new(), %Messages.Heartbeat{}, system: 70_000, sysid32: true)
      {[frame], _} = Parser.push(Parser.new(sysid32: true), bytes)
      assert %Frame{system: 70_000, incompat: 3} = frame
      assert verdict(new(), frame) == :signed
    end
  end

  describe "receiving" do
    test "any changed byte makes it wrong, and nothing of the state changes (S5)" do
      frame = received()
      signing = new()

      for at <- 1..(byte_size(frame.bytes) - 1) do
        wrong = %{frame | bytes: damage(frame.bytes, at)}
        size = byte_size(wrong.bytes) - 13
        <<_::binary-size(^size), link, timestamp::48-little, signature::binary>> = wrong.bytes
        wrong = %{wrong | signature: %{link_id: link, timestamp: timestamp, signature: signature}}
        assert {{:rejected, :wrong_signature}, ^signing} = Signing.check(signing, wrong)
      end
    end

    test "signatures of memory garbage, as PX4 1.18 forwards: rejected, and the vehicle's own frames go on" do
      <<head::binary-size(21), _::binary>> = received(system: 255, component: 190).bytes
      signing = accept(new(), received())

      for garbage <- [:crypto.strong_rand_bytes(13), <<0::104>>, <<-1::104>>] do
        assert {{:rejected, :wrong_signature}, ^signing} = Signing.check(signing, frame(head <> garbage))
      end

      accept(signing, received(timestamp: Signing.timestamp(signing)))
    end

    test "S3: each stream only forward; streams do not hinder each other" do
      base = Signing.timestamp(new())
      signing = accept(new(), received(timestamp: base + 100))
      assert verdict(signing, received(timestamp: base + 100)) == {:rejected, :replayed}
      assert verdict(signing, received(timestamp: base + 50)) == {:rejected, :replayed}
      assert verdict(signing, received(timestamp: base + 101)) == :signed
      assert verdict(signing, received(timestamp: base + 50, link_id: 6)) == :signed
      assert verdict(signing, received(timestamp: base + 50, component: 2)) == :signed
      assert verdict(signing, received(timestamp: base + 50, system: 2)) == :signed
    end

    test "S4: a new stream may be a minute behind, not more; an old one may lag" do
      base = Signing.timestamp(new())
      assert verdict(new(), received(timestamp: base - @minute + 10)) == :signed
      assert verdict(new(), received(timestamp: base - @minute - 10)) == {:rejected, :stale}

      signing = accept(new(), received(timestamp: base - 100))
      ahead = accept(signing, received(timestamp: base + 10 * @minute, system: 2))
      assert verdict(ahead, received(timestamp: base)) == :signed
      assert verdict(ahead, received(timestamp: base, system: 3)) == {:rejected, :stale}
    end

    test "S4 with our clock, when nothing was received or sent for long" do
      {:ok, clock} = Agent.start_link(fn -> @now end)
      signing = new(clock: fn -> Agent.get(clock, & &1) end)
      base = Signing.timestamp(signing)
      Agent.update(clock, &(&1 + 3_600_000_000))
      assert verdict(signing, received(timestamp: base)) == {:rejected, :stale}
    end

    test "S5: our time is never behind what was received with a right signature" do
      base = Signing.timestamp(new())
      signing = accept(new(), received(timestamp: base + 500_000))
      {bytes, _} = Signing.encode(signing, %Messages.Heartbeat{}, system: 255)
      assert frame(bytes).signature.timestamp > base + 500_000
    end

    test "S4, S5: a clock that is 45 years ahead counts for its own stream only, and is named" do
      base = Signing.timestamp(new())
      # A program that counts from 1970.
      far = base + 142_007_040_000_000
      signing = accept(new(), received(timestamp: far, system: 9))
      assert {{9, 1, by_us}, signing} = Signing.leads(signing)
      assert_in_delta by_us / 1.0e6 / 86_400 / 365.25, 45.0, 0.01
      assert {nil, signing} = Signing.leads(signing)
      assert Signing.timestamp(signing) == base

      # Others, and itself after its clock was set right; what it signed before is not worth a replay.
      signing = accept(signing, received(timestamp: base, system: 1))
      signing = accept(signing, received(timestamp: base, system: 9))
      assert verdict(signing, received(timestamp: far, system: 9)) == {:rejected, :replayed}
      assert verdict(signing, received(timestamp: base - 5, system: 9)) == {:rejected, :replayed}
      assert verdict(signing, received(timestamp: base - 2 * @minute, system: 2)) == {:rejected, :stale}
      # Nor after a restart or a kill.
      again = new(streams: Signing.streams(signing), stored: base)
      assert verdict(again, received(timestamp: far, system: 9)) == {:rejected, :replayed}

      both =
        Map.new(Signing.streams(signing), fn {stream, last} ->
          {stream, {last, Signing.ahead(signing)[stream]}}
        end)

      killed = new(streams: Signing.resumed(both, base + @minute, {@now, @now + 1_000_000}))
      assert verdict(killed, received(timestamp: far + 50_000, system: 9)) == {:rejected, :replayed}
      assert verdict(killed, received(timestamp: far + 500_000, system: 9)) == :signed
    end

    test "S4: one that is hours ahead sets our time, and makes nobody else stale; with a clock of before it does" do
      ahead = 2 * 60 * @minute
      base = Signing.timestamp(new())
      signing = accept(new(), received(timestamp: base + ahead))
      assert Signing.timestamp(signing) > base + ahead
      assert {{1, 1, _by_us}, signing} = Signing.leads(signing)
      assert verdict(signing, received(timestamp: base, system: 2)) == :signed

      without_a_clock = accept(new(clock: fn -> 0 end), received(timestamp: base + ahead))
      assert Signing.timestamp(without_a_clock) > base
      assert verdict(without_a_clock, received(timestamp: base, system: 2)) == {:rejected, :stale}
    end

    test "S5: where nobody else has the key our time follows any clock" do
      far = Signing.timestamp(new()) + 142_007_040_000_000
      signing = accept(new(follow_far: true), received(timestamp: far))
      assert Signing.timestamp(signing) > far and Signing.far?(signing)
      assert verdict(signing, received(timestamp: Signing.timestamp(new()), system: 2)) == :signed
    end

    test "a stream that keeps its distance to the clock has it read five times a second, not for each frame" do
      reads = :counters.new(1, [])
      base = div(@now, 10) - 142_007_040_000_000

      # A frame each millisecond, for two seconds.
      for n <- 1..2000, reduce: new() do
        signing ->
          clock = fn ->
            :counters.add(reads, 1, 1)
            @now + n * 1000
          end

          accept(%{signing | clock: clock}, received(timestamp: base + n * 100))
      end

      assert :counters.get(reads, 1) in 10..25
    end

    test "S7: RADIO_STATUS needs no signature; a list or a function says what else" do
      radio = frame(MavCodec.encode(%Messages.RadioStatus{rssi: 100}, system: 51, component: 68))

      v1_radio =
        frame(MavCodec.encode(%Messages.RadioStatus{rssi: 100}, system: 51, component: 68, version: 1))

      heartbeat = frame(heartbeat())
      assert verdict(new(), radio) == :unsigned
      assert verdict(new(), v1_radio) == :unsigned
      assert verdict(new(), heartbeat) == {:rejected, :unsigned}
      assert verdict(new(accept_unsigned: [0]), heartbeat) == :unsigned
      assert verdict(new(accept_unsigned: &(&1.system == 1)), heartbeat) == :unsigned
      assert verdict(new(accept_unsigned: []), radio) == {:rejected, :unsigned}
    end

    test "streams are bounded, even for those who have the key" do
      base = Signing.timestamp(new())

      frames =
        for system <- 1..255,
            component <- 1..5,
            do: received(timestamp: base, system: system, component: component)

      {verdicts, signing} = Enum.map_reduce(frames, new(), &Signing.check(&2, &1))
      assert %{:signed => 1024, {:rejected, :too_many_streams} => 251} = Enum.frequencies(verdicts)
      assert {:signed, _} = Signing.check(signing, received(timestamp: base + 100))
    end
  end

  describe "S6: time over restarts" do
    test "the start is the later of clock and stored" do
      base = Signing.timestamp(new())
      assert Signing.timestamp(new(stored: base - 5)) == base
      assert Signing.timestamp(new(stored: base + 500)) == base + 500
      assert Signing.timestamp(new(stored: base + 500, clock: fn -> 0 end)) == base + 500
    end

    test "the stored time is always above every time stamp used, and renewed within a minute" do
      test = self()
      save = fn timestamp -> send(test, {:saved, timestamp}) end
      {:ok, clock} = Agent.start_link(fn -> @now end)
      signing = new(save: save, clock: fn -> Agent.get(clock, & &1) end)
      assert_received {:saved, first}
      assert first > Signing.timestamp(signing)

      # Ten minutes, a frame every second.
      {saved, _} =
        Enum.reduce(1..600, {[first], signing}, fn _, {[last | _] = saved, signing} ->
          Agent.update(clock, &(&1 + 1_000_000))
          {bytes, signing} = Signing.encode(signing, %Messages.Heartbeat{}, system: 1)

          saved =
            receive do
              {:saved, timestamp} -> [timestamp | saved]
            after
              0 -> saved
            end

          assert frame(bytes).signature.timestamp < max(last, hd(saved))
          {saved, signing}
        end)

      assert length(saved) in 20..22
      gaps = Enum.zip_with(saved, tl(saved), &(&1 - &2))
      assert Enum.all?(gaps, &(&1 <= @minute))
    end

    test "a restart without a clock uses no time stamp twice" do
      {:ok, disk} = Agent.start_link(fn -> 0 end)
      save = fn timestamp -> Agent.update(disk, fn _ -> timestamp end) end

      Enum.reduce(1..20, 0, fn _, last ->
        signing = new(clock: fn -> 0 end, stored: Agent.get(disk, & &1), save: save)

        Enum.reduce(1..50, {signing, last}, fn _, {signing, last} ->
          {bytes, signing} = Signing.encode(signing, %Messages.Heartbeat{}, system: 1)
          assert frame(bytes).signature.timestamp > last
          {signing, frame(bytes).signature.timestamp}
        end)
        |> elem(1)
      end)
    end
  end

  test "S9: the key is never shown" do
    signing = accept(new(), received())

    for text <- [
          inspect(signing),
          inspect(signing, structs: false, limit: :infinity),
          inspect({:state, signing}),
          :io_lib.format(~c"~p ~w", [signing, signing]) |> to_string()
        ] do
      refute text =~ String.slice(inspect(@key), 3, 12)
      refute text =~ Base.encode16(@key)
      refute text =~ Enum.join(:binary.bin_to_list(@key, 0, 4), ",")
      refute text =~ Enum.join(:binary.bin_to_list(@key, 0, 4), ", ")
    end

    assert inspect(signing) =~ "link_id: 0"
  end

  test "the key of a passphrase is its SHA-256" do
    assert Signing.key("gateway-capture-signing-key") == @key
    assert_raise FunctionClauseError, fn -> Signing.new("short") end
  end
end
