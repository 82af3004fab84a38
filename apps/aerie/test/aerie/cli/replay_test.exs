defmodule Aerie.CLI.ReplayTest do
  @moduledoc "`aerie replay` of flights, and of recordings with damaged times (`mav_codec/test/fixtures/recordings`)."
  use ExUnit.Case, async: true

  import ExUnit.CaptureIO

  alias Aerie.StandardError

  @fixtures Path.expand("../../../../mav_codec/test/fixtures/recordings", __DIR__)
  @flight Path.expand("../../../../vehicle/test/fixtures/px4_flight.tlog.gz", __DIR__)

  # The answer, standard output and standard error.
  defp replay(words, folder \\ @fixtures) do
    {{answer, notes}, text} =
      with_io(fn -> StandardError.capture(fn -> Aerie.CLI.call(["replay" | words], folder) end) end)

    {answer, text, notes}
  end

  defp lines(text), do: text |> String.split("\n", trim: true) |> Enum.map(&JSON.decode!/1)

  @tag :tmp_dir
  test "events are JSON lines, the same bytes each time", %{tmp_dir: dir} do
    File.write!(Path.join(dir, "gateway.yaml"), "vehicles: [{id: HAWK, system_id: 1}]\n")
    words = [@flight, "--config", "gateway.yaml"]
    assert {{0, ""}, once, notes} = replay(words, dir)
    assert {{0, ""}, ^once, ^notes} = replay(words, dir)

    events = lines(once)
    assert Enum.all?(events, &(&1["vehicle"] == "HAWK"))

    assert %{
             "type" => "takeoff",
             "time" => "2026-11-20T23:11:38.009Z",
             "data" => %{"mode" => "AUTO_TAKEOFF"}
           } = Enum.find(events, &(&1["type"] == "takeoff"))

    assert notes =~ "HAWK: 5312 frames in 158 s\n"
    assert String.starts_with?(once, ~s({"data":{"severity":6,"severity_name":"INFO","text":"[logger]))
  end

  test "--samples adds the state samples" do
    assert {{0, ""}, text, _notes} = replay([@flight, "--samples"])
    {samples, events} = text |> lines() |> Enum.split_with(&is_map_key(&1, "group"))
    assert length(samples) > 800
    assert length(events) == 38
  end

  @tag :tmp_dir
  test "says what is wrong with a file, and which parts of it are damaged", %{tmp_dir: dir} do
    assert {{:error, "/nowhere.tlog: no such file or directory"}, "", ""} = replay(["/nowhere.tlog"])
    cut = Path.join(dir, "cut.tlog")
    File.write!(cut, @flight |> File.read!() |> :zlib.gunzip() |> binary_part(0, 100_001))
    assert {{0, ""}, _text, notes} = replay([cut])
    assert notes =~ "the file ends in the middle of a record"
  end

  for {name, text} <- [
        {"nanoseconds.tlog", "microseconds since 1970, not nanoseconds"},
        {"all-2pow63.tlog", "microseconds since 1970, not nanoseconds"},
        {"raw.rlog", "raw MAVLink log, not a tlog"}
      ] do
    test "#{name}: a text instead of events" do
      assert {{:error, text}, "", ""} = replay([unquote(name), "--samples"])
      assert text =~ unquote(text)
    end
  end

  for {name, seconds} <- [{"clock-set.tlog", 9}, {"first-zero.tlog", 19}] do
    test "#{name}: its events, and how long it is" do
      assert {{0, ""}, text, notes} = replay([unquote(name), "--samples"])
      assert [_ | _] = lines(text)
      assert notes =~ "41 frames in #{unquote(seconds)} s"
    end
  end
end
