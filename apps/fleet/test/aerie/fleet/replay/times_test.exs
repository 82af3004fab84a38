defmodule Aerie.Fleet.Replay.TimesTest do
  @moduledoc "Recordings whose times are none (`mav_codec/test/fixtures/recordings`)."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Replay

  @fixtures Path.expand("../../../../../mav_codec/test/fixtures/recordings", __DIR__)

  defp file(name), do: Path.join(@fixtures, name)

  for {name, text} <- [
        {"nanoseconds.tlog", "not nanoseconds"},
        {"all-2pow63.tlog", "not nanoseconds"},
        {"raw.rlog", "raw MAVLink log, not a tlog"}
      ] do
    test "#{name} is refused with a text" do
      path = file(unquote(name))
      assert {:error, text} = Replay.run(path)
      assert text =~ path
      assert text =~ unquote(text)
      assert {:error, ^text} = Replay.Source.recording(path)
    end
  end

  for {name, seconds} <- [{"clock-set.tlog", 9}, {"first-zero.tlog", 19}] do
    test "#{name} is a flight of seconds, and no link was lost in it" do
      assert {:ok, %{events: events, summary: summary}} = Replay.run(file(unquote(name)))
      refute Enum.any?(events, &(&1.type == "link.lost"))
      assert div(summary.duration_us, 1_000_000) == unquote(seconds)
      assert %{jumps: 1, frames: 41, vehicles: [_one]} = summary
      assert summary.from > 1_600_000_000_000_000
      assert summary.from < summary.to
    end
  end
end
