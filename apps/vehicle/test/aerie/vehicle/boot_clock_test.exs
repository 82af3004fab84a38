defmodule Aerie.Vehicle.BootClockTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.BootClock

  @second 1_000_000

  # Readings as {boot_ms, at in s}; the verdicts in order.
  defp verdicts(readings, clock \\ BootClock.new()) do
    {verdicts, _clock} =
      Enum.map_reduce(readings, clock, fn {boot_ms, at}, clock ->
        {clock, verdict} = BootClock.read(clock, boot_ms, round(at * @second))
        {verdict, clock}
      end)

    verdicts
  end

  test "R6: a clock that begins anew and stays there is a reboot, once" do
    assert verdicts([{60_000, 0}, {100, 5}, {600, 5.5}, {1100, 6}, {1600, 6.5}]) ==
             [:ok, :behind, :behind, :reboot, :ok]
  end

  test "frames out of order are no reboot, however many, as long as the clock goes on in between" do
    assert Enum.uniq(verdicts([{60_000, 0}, {59_990, 0.1}, {58_500, 0.2}, {60_100, 0.3}])) == [:ok]
    late = for n <- 1..50, reading <- [{60_000 + n * 100, n / 10}, {50_000 + n * 100, n / 10}], do: reading
    refute :reboot in verdicts(late)
  end

  test "a burst of old frames is no reboot" do
    burst = for n <- 1..30, do: {50_000 + n, 1 + n / 100}
    refute :reboot in verdicts([{60_000, 0}] ++ burst ++ [{61_500, 1.5}])
  end

  test "the wrap after 49.7 days is no reboot" do
    assert verdicts([{0xFFFFFFF0, 0}, {500, 1}, {1500, 2}]) == [:ok, :ok, :ok]
  end

  test "a reboot that happened while nobody looked is found" do
    assert :reboot in verdicts([{100, 0}, {1100, 1}, {2100, 2}], BootClock.new(600_000))
  end
end
