defmodule Aerie.Vehicle.DoubtTest do
  @moduledoc "One vehicle flies; another one with its id is switched on beside it. Until that is certain nothing of the flight is told wrongly."
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [frame: 2, frame: 3, options: 1, step: 2]

  alias Aerie.Vehicle.{Core, Detector}
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @flight ~w(armed disarmed takeoff landed mode_change failsafe gps.lost position.lost)

  defp start do
    options = options([])
    %{core: Core.new(options), detector: Detector.new(options), events: [], actions: [], params: %{}}
  end

  defp run(frames), do: frames |> Enum.sort_by(&elem(&1, 0)) |> Enum.reduce(start(), &play/2)
  defp play({at, way, message}, run), do: step(run, {:frames, way, [frame(message, round(at * @second))]})

  defp play({at, way, message, seq}, run),
    do: step(run, {:frames, way, [frame(message, round(at * @second), seq: seq)]})

  defp types(run), do: run.events |> Enum.reverse() |> Enum.map(& &1.type)
  defp told(run), do: Enum.filter(types(run), &(&1 in @flight))

  # In the air for ten minutes.
  defp flying(way, seconds) do
    for s <- seconds,
        message <- [0.0, 0.25, 0.5, 0.75] |> Enum.map(&{s + &1, &1}) |> Enum.flat_map(&airborne/1) do
      {at, message} = message
      {at, way, message}
    end
  end

  defp airborne({at, part}) do
    beat =
      if part == 0.0,
        do: [{at, %M.Heartbeat{type: 2, autopilot: 3, base_mode: 209, custom_mode: 5, system_status: 4}}],
        else: []

    beat ++
      [
        {at, %M.ExtendedSysState{landed_state: 2}},
        {at, %M.Attitude{time_boot_ms: 600_000 + round(at * 1000)}}
      ]
  end

  # Just switched on, on the ground.
  defp parked(way, seconds) do
    for s <- seconds,
        part <- [0.1, 0.35, 0.6, 0.85],
        at = s + part,
        message <- ground(at, part),
        do: {at, way, message}
  end

  defp ground(at, part) do
    beat =
      if part == 0.6,
        do: [%M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 0, system_status: 3}],
        else: []

    # Behind the same radio nothing but its clock tells it from the first one.
    [%M.Attitude{time_boot_ms: round(at * 1000)}, %M.ExtendedSysState{landed_state: 1}] ++ beat
  end

  for {name, one, other} <- [
        {"on another link", "a", "b"},
        {"behind another peer of one link, known by the link alone before", "udp",
         {"udp", {{10, 0, 0, 1}, 2}}},
        {"behind the same radio", "radio", "radio"}
      ] do
    test "a second one #{name} is told as a collision, and nothing else happens to the first" do
      run = run(flying(unquote(Macro.escape(one)), 0..30) ++ parked(unquote(Macro.escape(other)), 20..30))
      assert told(run) == []
      assert "collision" in types(run)
      refute "stream.contested" in types(run)
    end
  end

  test "what happens to the first one meanwhile is told when it stays so, with the time at which it began" do
    landed = for {at, way, message} <- parked("a", 24..30), do: {at, way, later(message)}
    run = run(flying("a", 0..23) ++ parked("b", 20..30) ++ landed)
    assert Enum.sort(told(run)) == ["disarmed", "landed", "mode_change"]
    [%{time: time} | _] = Enum.filter(run.events, &(&1.type == "disarmed"))
    assert_in_delta time / @second, 24.6, 0.6
  end

  defp later(%M.Attitude{} = message), do: %{message | time_boot_ms: message.time_boot_ms + 600_000}
  defp later(message), do: message

  test "on two links to one vehicle a change counts as soon as both say it" do
    beat = fn at, way, armed, seq ->
      {at, way, %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81 + armed}, seq}
    end

    before = for s <- 0..9, {way, late} <- [{"a", 0}, {"b", 0.2}], do: beat.(s + late, way, 0, s)
    run = run(before ++ [beat.(10, "a", 128, 10), beat.(10.2, "b", 128, 10)])
    assert [%{type: "armed", time: 10_000_000}] = run.events
  end

  test "one vehicle by one link waits for nothing" do
    run =
      run(
        flying("a", 0..3) ++
          [{4.0, "a", %M.Heartbeat{type: 2, autopilot: 3, base_mode: 209, custom_mode: 6, system_status: 4}}]
      )

    assert [%{type: "mode_change", time: 4_000_000}] = run.events
  end

  test "no EVENT is asked for while there may be two" do
    event = fn number, boot ->
      %M.Event{id: 0x01000007, sequence: number, event_time_boot_ms: boot, log_levels: 0x66}
    end

    ones = for n <- 0..10, do: {20 + n / 2, "a", event.(200 + n, 620_000 + n * 500)}
    others = for n <- 0..10, do: {20.7 + n / 2, "b", event.(n, 20_000 + n * 500)}
    run = run(flying("a", 0..30) ++ parked("b", 20..30) ++ ones ++ others)
    assert [] = for({:send, %M.RequestEvent{}, _version} <- run.actions, do: :asked)
    assert Core.snapshot(run.core).reports.lost == 0
  end
end
