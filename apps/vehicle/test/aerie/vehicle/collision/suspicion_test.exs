defmodule Aerie.Vehicle.Collision.SuspicionTest do
  @moduledoc "A vehicle flies, and another one with its id is switched on beside it: no wrong events until the collision is certain."
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [frame: 2, frame: 3, options: 1, step: 2]

  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Session.Core
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @flight ~w(armed disarmed takeoff landed mode_change failsafe gps.lost position.lost)

  defp start do
    options = options([])
    %{core: Core.new(options), detector: Detector.new(options), events: [], actions: [], params: %{}}
  end

  defp run(frames), do: frames |> Enum.sort_by(&elem(&1, 0)) |> Enum.reduce(start(), &play/2)
  defp play({at, path, message}, run), do: step(run, {:frames, path, [frame(message, round(at * @second))]})

  defp play({at, path, message, seq}, run),
    do: step(run, {:frames, path, [frame(message, round(at * @second), seq: seq)]})

  defp types(run), do: run.events |> Enum.reverse() |> Enum.map(& &1.type)
  defp flight_events(run), do: Enum.filter(types(run), &(&1 in @flight))

  # In the air for ten minutes.
  defp flying(path, seconds) do
    for s <- seconds,
        message <- [0.0, 0.25, 0.5, 0.75] |> Enum.map(&{s + &1, &1}) |> Enum.flat_map(&airborne/1) do
      {at, message} = message
      {at, path, message}
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
  defp parked(path, seconds) do
    for s <- seconds,
        part <- [0.1, 0.35, 0.6, 0.85],
        at = s + part,
        message <- ground(at, part),
        do: {at, path, message}
  end

  defp ground(at, part) do
    beat =
      if part == 0.6,
        do: [%M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 0, system_status: 3}],
        else: []

    # Behind the same radio only its clock distinguishes it from the first one.
    [%M.Attitude{time_boot_ms: round(at * 1000)}, %M.ExtendedSysState{landed_state: 1}] ++ beat
  end

  for {name, one, other} <- [
        {"on another link", "a", "b"},
        {"behind another peer of one link, known by the link alone before", "udp",
         {"udp", {{10, 0, 0, 1}, 2}}},
        {"behind the same radio", "radio", "radio"}
      ] do
    test "a second vehicle #{name} is a collision, and no other event of the first" do
      run = run(flying(unquote(Macro.escape(one)), 0..30) ++ parked(unquote(Macro.escape(other)), 20..30))
      assert flight_events(run) == []
      assert "collision" in types(run)
      refute "stream.contested" in types(run)
    end
  end

  test "a real change of the first vehicle meanwhile is an event once it has stayed, with the time at which it began" do
    landed = for {at, path, message} <- parked("a", 24..30), do: {at, path, later(message)}
    run = run(flying("a", 0..23) ++ parked("b", 20..30) ++ landed)
    assert Enum.sort(flight_events(run)) == ["disarmed", "landed", "mode_change"]
    [%{time: time} | _] = Enum.filter(run.events, &(&1.type == "disarmed"))
    assert_in_delta time / @second, 24.6, 0.6
  end

  defp later(%M.Attitude{} = message), do: %{message | time_boot_ms: message.time_boot_ms + 600_000}
  defp later(message), do: message

  test "with two links to one vehicle, a change counts as soon as both show it" do
    beat = fn at, path, armed, seq ->
      {at, path, %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81 + armed}, seq}
    end

    before = for s <- 0..9, {path, late} <- [{"a", 0}, {"b", 0.2}], do: beat.(s + late, path, 0, s)
    run = run(before ++ [beat.(10, "a", 128, 10), beat.(10.2, "b", 128, 10)])
    assert [%{type: "armed", time: 10_000_000}] = run.events
  end

  test "with one vehicle on one link, no change waits" do
    run =
      run(
        flying("a", 0..3) ++
          [{4.0, "a", %M.Heartbeat{type: 2, autopilot: 3, base_mode: 209, custom_mode: 6, system_status: 4}}]
      )

    assert [%{type: "mode_change", time: 4_000_000}] = run.events
  end

  test "no EVENT is requested while there may be two vehicles" do
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
