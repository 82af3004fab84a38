defmodule MavRouter.Signing.AlarmTest do
  use ExUnit.Case, async: true

  alias MavRouter.Signing.Alarm

  defp feed(burst, times), do: Enum.map_reduce(times, burst, &swap(Alarm.add(&2, :wrong_signature, 1, &1)))
  defp swap({burst, verdict}), do: {verdict, burst}
  defp alarms(verdicts), do: Enum.count(verdicts, &match?({:alarm, _}, &1))

  test "one a second, as PX4 forwards other ground stations' frames, is never an alarm" do
    {verdicts, _} = feed(Alarm.new(), Enum.map(1..3600, &(&1 * 1000)))
    assert alarms(verdicts) == 0
  end

  test "a burst is one alarm, and one a minute while it lasts" do
    {verdicts, burst} = feed(Alarm.new(), Enum.map(1..20, &(&1 * 10)))
    assert List.last(verdicts) == {:alarm, %{wrong_signature: 20}}
    assert alarms(verdicts) == 1
    {verdicts, _} = feed(burst, Enum.map(21..18_000, &(&1 * 10)))
    assert alarms(verdicts) == 2
  end

  test "the alarm says what was refused and why" do
    {burst, :quiet} = Alarm.add(Alarm.new(), :replayed, 5, 0)
    assert {_burst, {:alarm, %{replayed: 5, unsigned: 30}}} = Alarm.add(burst, :unsigned, 30, 9_999)
    assert {_burst, :quiet} = Alarm.add(burst, :unsigned, 15, 10_001)
  end
end
