defmodule MavRouter.Recorder.CoreTest do
  use ExUnit.Case, async: true
  use Aerie.RecorderCase

  alias MavRouter.Recorder.Core

  @second 1_000_000

  defp run(core, frames, batch \\ 1) do
    {parts, _core} =
      frames
      |> Enum.chunk_every(batch)
      |> Enum.flat_map_reduce(core, fn frames, core ->
        {core, parts} = Core.frames(core, frames)
        {parts, core}
      end)

    Enum.flat_map(parts, fn
      :close -> [:close]
      frames -> Enum.map(frames, &{&1.system, &1.at})
    end)
  end

  defp flight do
    [
      beat(1, false, 0),
      beat(1, true, 1 * @second),
      beat(1, true, 2 * @second),
      beat(1, false, 3 * @second),
      beat(1, false, 4 * @second),
      beat(1, false, 6 * @second),
      beat(1, true, 7 * @second)
    ]
  end

  test "off is nothing, always is everything" do
    assert run(Core.new(:off, 0), flight()) == []
    assert length(run(Core.new(:always, 0), flight())) == 7
  end

  test "armed: from the heartbeat that says so until some time after the one that says no more; twice" do
    expected = [
      {1, 1 * @second},
      {1, 2 * @second},
      {1, 3 * @second},
      {1, 4 * @second},
      :close,
      {1, 7 * @second}
    ]

    for batch <- [1, 2, 3, 7], do: assert(run(Core.new(:armed, 2 * @second), flight(), batch) == expected)
  end

  test "armed: as long as any vehicle of the link is; ground stations and unknown messages do not count" do
    gcs = frame(heartbeat(255, type: 6, autopilot: 8), 2)

    frames = [
      gcs,
      beat(1, true, 3),
      beat(2, true, 4),
      beat(1, false, 5),
      beat(1, false, 6),
      beat(2, false, 7),
      beat(2, false, 8)
    ]

    assert run(Core.new(:armed, 0), frames) == [{1, 3}, {2, 4}, {1, 5}, {1, 6}, {2, 7}, :close]
    assert run(Core.new(:armed, 0), [%{beat(1, true, 3) | crc_extra: nil}]) == []
    cut = frame(MavCodec.encode(%MavCodec.Messages.Heartbeat{}, system: 1), 3)
    assert run(Core.new(:armed, 0), [cut]) == []
  end

  test "up to a time" do
    core = %{Core.new({:until, 3}, 0) | on: true}
    assert run(core, for(at <- 1..5, do: beat(1, false, at))) == [{1, 1}, {1, 2}, {1, 3}, :close]
  end

  test "the armed vehicles are known when the mode changes" do
    {core, _} = Core.frames(Core.new(:armed, 0), [beat(1, true, 1)])
    assert {core, [:close]} = Core.stop(core)
    assert run(Core.mode(core, :armed), attitudes(1, 1..1, 0)) == [{1, 1000}]
  end
end
