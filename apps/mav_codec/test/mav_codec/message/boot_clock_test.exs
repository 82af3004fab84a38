defmodule MavCodec.Message.BootClockTest do
  use ExUnit.Case, async: true

  alias MavCodec.Message.BootClock

  @second 1_000_000

  # Readings as {boot_ms, at in s}, or with the message's id behind; the verdicts in order.
  defp verdicts(readings, clock \\ BootClock.new()) do
    {verdicts, _clock} =
      Enum.map_reduce(readings, clock, fn reading, clock ->
        {boot_ms, at, id} = if tuple_size(reading) == 2, do: Tuple.insert_at(reading, 2, 30), else: reading
        {clock, verdict} = BootClock.read(clock, id, boot_ms, round(at * @second))
        {verdict, clock}
      end)

    verdicts
  end

  test "R6: a clock that begins again and stays there is a reboot, once" do
    assert verdicts([{60_000, 0}, {100, 5}, {600, 5.5}, {1100, 6}, {1600, 6.5}]) ==
             [:ok, :behind, :behind, :reboot, :ok]
  end

  test "frames out of order are not a reboot, however many, as long as the clock goes on in between" do
    assert Enum.uniq(verdicts([{60_000, 0}, {59_990, 0.1}, {58_500, 0.2}, {60_100, 0.3}])) == [:ok]
    late = for n <- 1..50, reading <- [{60_000 + n * 100, n / 10}, {50_000 + n * 100, n / 10}], do: reading
    refute :reboot in verdicts(late)
  end

  test "a burst of old frames is not a reboot" do
    burst = for n <- 1..30, do: {50_000 + n, 1 + n / 100}
    refute :reboot in verdicts([{60_000, 0}] ++ burst ++ [{61_500, 1.5}])
  end

  test "the wrap after 49.7 days is not a reboot" do
    assert verdicts([{0xFFFFFFF0, 0}, {500, 1}, {1500, 2}]) == [:ok, :ok, :ok]
  end

  test "nor is the wrap in a silence, however long: the clock shows what it would then" do
    for silent_s <- [90, 3_600, 86_400 * 3] do
      last = 0x100000000 - 1_000 * div(silent_s, 2)
      again = div(silent_s, 2) * 1_000 + 700
      readings = for n <- 0..4, do: {again + n * 1_000, silent_s + n}
      assert verdicts([{last - 1_000, -1}, {last, 0} | readings]) |> Enum.uniq() == [:ok]
      # After a restart of the session too.
      assert verdicts(readings, BootClock.new(last, 0)) |> Enum.uniq() == [:ok]
      # A reboot in the same silence shows another time.
      rebooted = for n <- 0..4, do: {30_000 + n * 1_000, silent_s + n}
      if again > 60_000, do: assert(:reboot in verdicts([{last, 0} | rebooted]))
    end

    assert :reboot in verdicts(for(n <- 0..4, do: {100 + n * 1_000, 90 + n}), BootClock.new(3_000_000_000, 0))
  end

  test "boots are compared past the wrap" do
    assert BootClock.apart(5_000, 5_000 + 0x100000000 * 1_000 + 3) == 3
    assert BootClock.apart(5_000, 4_000) == 1_000
    assert BootClock.wrapped?(0xFFFFFFF0, 500)
    refute BootClock.wrapped?(500, 0xFFFFFFF0)
    refute BootClock.wrapped?(86_400_000 * 30, 500)
  end

  test "a reboot that happened while nobody looked is found" do
    assert :reboot in verdicts([{100, 0}, {1100, 1}, {2100, 2}], BootClock.new(600_000))
  end

  describe "a clock per message" do
    # Betaflight: ATTITUDE (30) in milliseconds, GLOBAL_POSITION_INT (33) in microseconds, which wrap after 71 minutes.
    defp betaflight(from_s, seconds, at \\ 0) do
      for n <- 0..(seconds * 10), id <- if(rem(n, 2) == 0, do: [33, 30], else: [30]) do
        boot = from_s + n / 10
        us = Integer.mod(round(boot * 1_000_000), 0x100000000)
        {if(id == 33, do: us, else: round(boot * 1000)), at + n / 10, id}
      end
    end

    test "microseconds beside milliseconds are not a reboot, and not a time once that is seen" do
      readings = betaflight(4_280, 60)
      verdicts = Enum.zip(readings, verdicts(readings))
      assert verdicts |> Enum.map(&elem(&1, 1)) |> Enum.uniq() |> Enum.sort() == [:none, :ok]
      assert for({{_, at, 33}, :ok} <- verdicts, do: at) |> Enum.max() < 1
      assert for({{_, at, 30}, :none} <- verdicts, do: at) == []
    end

    test "R6: it is restarted, and that is seen once" do
      readings = betaflight(600, 20) ++ betaflight(2, 20, 25)
      assert readings |> verdicts() |> Enum.count(&(&1 == :reboot)) == 1
    end

    test "R6: all clocks of a vehicle begin again, and that is one reboot" do
      all = fn from_s, at ->
        for n <- 0..50, id <- [30, 33, 2], do: {round(from_s * 1000) + n * 200, at + n / 5, id}
      end

      verdicts = verdicts(all.(600, 0) ++ all.(1, 15))
      assert Enum.count(verdicts, &(&1 == :reboot)) == 1
      assert verdicts |> Enum.take(-50) |> Enum.uniq() == [:ok]
    end

    test "a simulator that runs faster than time keeps its clock" do
      assert Enum.uniq(verdicts(for n <- 0..50, do: {n * 20_000, n / 5})) == [:ok]
    end
  end
end
