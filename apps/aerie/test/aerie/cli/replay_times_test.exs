defmodule Aerie.CLI.ReplayTimesTest do
  @moduledoc "`--replay FILE --events` of recordings whose times are none (`mav_codec/test/fixtures/recordings`)."
  use ExUnit.Case, async: true

  alias Aerie.CLI.{Options, ReplayEvents}

  @fixtures Path.expand("../../../../mav_codec/test/fixtures/recordings", __DIR__)

  defp events(name) do
    {:ok, device} = StringIO.open("")
    {:ok, notes} = StringIO.open("")
    options = %Options{replay: Path.join(@fixtures, name), print: [:events, :samples]}
    answer = ReplayEvents.print(options, @fixtures, device: device, notes: notes)
    {answer, StringIO.flush(device), StringIO.flush(notes)}
  end

  for {name, text} <- [
        {"nanoseconds.tlog", "microseconds since 1970, not nanoseconds"},
        {"all-2pow63.tlog", "microseconds since 1970, not nanoseconds"},
        {"raw.rlog", "raw MAVLink log, not a tlog"}
      ] do
    test "#{name}: a text instead of events" do
      assert {{:error, text}, "", ""} = events(unquote(name))
      assert text =~ unquote(text)
    end
  end

  for {name, seconds} <- [{"clock-set.tlog", 9}, {"first-zero.tlog", 19}] do
    test "#{name}: its events, and how long it is" do
      assert {:ok, lines, notes} = events(unquote(name))
      assert [_ | _] = lines |> String.split("\n", trim: true) |> Enum.map(&JSON.decode!/1)
      assert notes =~ "41 frames in #{unquote(seconds)} s"
    end
  end
end
