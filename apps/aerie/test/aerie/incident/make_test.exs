defmodule Aerie.Incident.MakeTest do
  @moduledoc "Archives from the folders of a gateway that has stopped: real flights, overlapping recordings, secrets, damage, limits."
  use ExUnit.Case, async: true

  alias Aerie.{Config, Incident}
  alias Aerie.Control.Ledger.Journal
  alias Aerie.Incident.{Source, Span}
  alias MavCodec.{Frame, Parser, Tlog}
  alias MavCodec.Frame.Raw
  alias MavCodec.Messages, as: M
  alias MavRouter.Recorder.Archive.Name

  @moduletag :tmp_dir
  @fixtures Path.expand("../../../../vehicle/test/fixtures", __DIR__)
  @second 1_000_000
  @start 1_795_000_000 * @second

  setup %{tmp_dir: folder} do
    for name <- ~w(recordings out), do: File.mkdir_p!(Path.join(folder, name))

    config =
      Config.default(%{
        "recorder" => %{"dir" => Path.join(folder, "recordings")},
        "commands" => %{"ledger" => %{"dir" => Path.join(folder, "ledger")}},
        "policy" => %{"audit" => %{"dir" => Path.join(folder, "audit")}},
        "shadow" => %{"dir" => Path.join(folder, "shadow"), "key" => "the key of all shadows"}
      })

    %{config: config, span: %Span{from: @start, to: @start + 600 * @second}}
  end

  defp make(c, more \\ %{}) do
    output = Path.join(c.tmp_dir, "out/a.tar.gz")

    request = %{
      source: Source.stopped(c.config),
      vehicle: "VID-001",
      span: c.span,
      output: output,
      machine: [],
      max_bytes: 10_000_000,
      now: c.span.to,
      note: fn _text -> :ok end
    }

    with {:ok, _bytes, notes} <- Incident.make(Map.merge(request, more)) do
      {:ok, files} = :erl_tar.extract(output, [:memory, :compressed])
      File.rm!(output)
      {Map.new(files, fn {name, bytes} -> {name |> to_string() |> Path.basename(), bytes} end), notes}
    end
  end

  defp frame(message, second, system) do
    bytes = MavCodec.encode(message, system: system, component: 1)
    {[frame], _parser} = Parser.push(Parser.new(), bytes, 0)
    at(frame, second)
  end

  defp at(frame, second), do: %{frame | at: @start + round(second * @second)}

  defp beat(second, system \\ 1),
    do:
      frame(
        %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4},
        second,
        system
      )

  defp record(c, label, frames) do
    write(c, label, frames, IO.iodata_to_binary(Tlog.records(frames)))
  end

  # Written when the last frame came, whatever time it is where the test runs.
  defp write(c, label, frames, bytes) do
    path = Path.join([c.tmp_dir, "recordings", Name.attempt(Name.new(label, div(hd(frames).at, @second)), 1)])
    File.write!(path, bytes)
    File.touch!(path, div(List.last(frames).at, @second))
    path
  end

  defp frames(tlog) do
    {items, decoder} = Tlog.Decoder.push(Tlog.Decoder.new([]), tlog)
    for %Frame{} = frame <- items ++ Tlog.Decoder.finish(decoder), do: frame
  end

  test "a real flight: its page has curves, modes, a track and the events of its replay", c do
    bytes = @fixtures |> Path.join("arducopter_flight.tlog.gz") |> File.read!() |> :zlib.gunzip()
    [first | _] = all = frames(bytes)
    span = %Span{from: first.at - 1, to: List.last(all).at + 1}
    write(c, "main-VID-001", all, bytes)

    assert {files, _notes} = make(c, %{span: span})
    assert {:ok, flight} = Aerie.Fleet.Replay.run({:chunks, [files["flight.tlog"]]})
    ids = for line <- String.split(files["events.jsonl"], "\n", trim: true), do: JSON.decode!(line)["id"]
    assert ids == for(%{vehicle: "VID-001"} = event <- flight.events, do: event.id)

    page = files["index.html"]

    for title <- ["Altitude above home, m", "Battery voltage, V", "GUIDED", "armed", "Ground track"],
        do: assert(page =~ title)

    refute page =~ "Nothing was recorded of it"
    assert {^files, _notes} = make(c, %{span: span})
  end

  test "with nothing at all it is an error, with no more than a command an archive that says what is missing",
       c do
    assert {:error, text} = make(c)
    assert text =~ "nothing is known of VID-001" and text =~ "there is no ledger" and text =~ "aerie status"
    assert File.ls!(Path.join(c.tmp_dir, "out")) == []

    {:ok, journal, nil, 0} =
      Journal.open(Path.join(c.tmp_dir, "ledger"), nil, fn _record, nil -> nil end)

    envelope = %{"id" => "x", "vehicle" => "VID-001", "type" => "land", "params" => %{}, "source" => "ann"}
    {:ok, _journal} = Journal.append(journal, [["new", "x", "d", @start + 1, envelope]])
    File.rm_rf!(Path.join(c.tmp_dir, "recordings"))
    assert {files, notes} = make(c)
    assert Enum.any?(notes, &(&1 =~ "nothing was recorded")) and Enum.any?(notes, &(&1 =~ "does not exist"))
    assert files["index.html"] =~ "there is no audit log" and files["events.jsonl"] == ""
    refute is_map_key(files, "flight.tlog")
  end

  test "recordings that overlap are copied once, frames out of the span not at all, and in order", c do
    record(c, "main-VID-001", for(n <- 0..29, do: beat(n - 10)))
    # A ring that was saved later, and has more from before.
    record(c, "main-VID-001-failsafe", [beat(19) | for(n <- -60..40, do: beat(n))])
    assert {files, _notes} = make(c)
    times = for frame <- frames(files["flight.tlog"]), do: div(frame.at - @start, @second)
    assert times == Enum.uniq(times) and Enum.sort(times) == Enum.to_list(0..40)
  end

  test "what a link heard of another vehicle is another incident's, and names do not decide", c do
    record(c, "main-radio", for(n <- 0..5, do: beat(n, 2)))
    record(c, "main-VID-001-x", for(n <- 0..5, do: beat(n, 3)))
    attitude = frame(%M.Attitude{time_boot_ms: 1}, 6, 1)
    record(c, "main-other", for(n <- 0..5, do: beat(n, 1 + rem(n, 2))) ++ [attitude])
    assert {files, _notes} = make(c)
    assert %{"link-main-other.tlog" => tlog} = files
    assert length(frames(tlog)) == 7
    refute is_map_key(files, "flight.tlog") or is_map_key(files, "link-main-radio.tlog")
    # Events of this vehicle only.
    for line <- String.split(files["events.jsonl"], "\n", trim: true),
        do: assert(%{"vehicle" => "VID-001"} = JSON.decode!(line))
  end

  test "a line on which other vehicles are is left out, although the vehicle's heartbeats went over it", c do
    attitude = &frame(%M.Attitude{time_boot_ms: 1}, &1, &2)
    asks = &frame(%M.CommandLong{command: 511, target_system: &2, target_component: 1}, &1, 237)
    both = for n <- 1..5, system <- [1, 2], do: beat(n + system / 10, system)
    # What another one hears of the vehicle; before it has said what it is, the vehicle's telemetry as well.
    record(c, "main-line-2", [attitude.(0, 1), asks.(0.5, 2)] ++ both ++ [attitude.(6, 2), asks.(7, 2)])
    # A radio for both, one that the vehicle left before the other one came, and a line of its own.
    record(c, "main-radio", both ++ [attitude.(6, 1)])
    record(c, "main-left", [beat(0), attitude.(0.5, 1), asks.(1, 1), beat(2, 2), attitude.(3, 2)])
    record(c, "main-line-1", [beat(0), attitude.(1, 1)])
    links = fn files -> for "link-" <> name <- Enum.sort(Map.keys(files)), do: name end
    assert {files, _notes} = make(c)
    assert links.(files) == ["main-left.tlog", "main-line-1.tlog", "main-radio.tlog"]

    # Where nothing that is sent is recorded, a heartbeat was heard.
    config = %{c.config | recorder: %{c.config.recorder | sent: false}}
    assert {files, _notes} = make(c, %{source: Source.stopped(config)})
    assert "main-line-2.tlog" in links.(files)
  end

  test "no key, no password, no signature, wherever somebody has put one", c do
    secret = "the-password-of-the-network-0123"

    setup =
      Raw.frame(256, <<0::64, 1, 1, secret::binary-size(32)>>, 71,
        system: 255,
        component: 190,
        seq: 0,
        compat_flags: 0
      )
      |> Frame.from_bytes(71, nil)
      |> at(3)

    wifi = frame(%M.WifiConfigAp{ssid: "field", password: secret}, 4, 255)
    record(c, "main-VID-001", [beat(1), setup, wifi, beat(5)])

    {:ok, log} = Aerie.Control.Policy.Audit.Log.open(Path.join(c.tmp_dir, "audit"), 1_000_000, @start)

    entry = %{
      "type" => "decision",
      "decision" => "allow",
      "vehicle" => "VID-001",
      "command" => "hold",
      "id" => "a",
      "params" => %{"text" => "the key of all shadows", "url" => "http://ann:#{secret}@host/"}
    }

    {:ok, log} = Aerie.Control.Policy.Audit.Log.append(log, entry, @start + 9 * @second)
    Aerie.Control.Policy.Audit.Log.close(log)
    File.touch!(Path.join(c.tmp_dir, "audit/0000000000000001.jsonl"), div(@start, @second) + 9)
    File.mkdir_p!(Path.join(c.tmp_dir, "shadow/desired"))
    File.write!(Path.join(c.tmp_dir, "shadow/key"), secret)

    File.write!(
      Path.join(c.tmp_dir, "shadow/desired/VID-001.json"),
      ~s({"seal":"#{secret}","fields":{"mode":{"value":"LOITER","actor":"ann"}},"token":"#{secret}"})
    )

    assert {files, notes} = make(c)

    for {name, bytes} <- files,
        word <- [secret, "the key of all shadows"],
        do: refute(String.contains?(bytes, word), name)

    assert "1 frames with passwords or keys (flight.tlog)" in notes
    assert [0, 256, 0] == for(frame <- frames(files["flight.tlog"]), do: frame.id)
    assert %{"shadow" => %{"desired" => %{"mode" => "LOITER"}}} = JSON.decode!(files["shadow.json"])
    assert files["audit.jsonl"] =~ "(hidden)" and files["commands.jsonl"] =~ ~s("type":"hold")
  end

  test "more than the limit, an output that is there or has no folder: an error, and nothing is left behind",
       c do
    record(c, "main-VID-001", for(n <- 0..99, do: beat(n)))
    assert {:error, text} = make(c, %{max_bytes: 1_000})
    assert text =~ "more than 0 MB: take a shorter span" and text =~ "--max-mb"

    there = Path.join(c.tmp_dir, "out/there")
    File.write!(there, "mine")
    assert {:error, text} = make(c, %{output: there})
    assert text =~ "exists already"
    assert File.read!(there) == "mine"
    assert {:error, text} = make(c, %{output: Path.join(c.tmp_dir, "nowhere/a.tar.gz")})
    assert text =~ "is not a folder"
    assert File.ls!(Path.join(c.tmp_dir, "out")) == ["there"]
  end

  test "damaged files cost what is damaged in them, and are named", c do
    frames = for n <- 0..9, do: beat(n)
    bytes = IO.iodata_to_binary(Tlog.records(frames))
    write(c, "main-VID-001", frames, bytes <> String.duplicate("noise ", 20))
    File.mkdir_p!(Path.join(c.tmp_dir, "ledger"))
    File.write!(Path.join(c.tmp_dir, "ledger/ledger"), "nonsense\n")
    File.mkdir_p!(Path.join(c.tmp_dir, "audit"))
    File.write!(Path.join(c.tmp_dir, "audit/0000000000000001.jsonl"), "{}\nnonsense\n")
    # No file: a folder with such a name, and a name without a date that there is.
    File.mkdir_p!(Path.join(c.tmp_dir, "recordings/main-VID-001-20261118T000000Z.tlog"))
    File.write!(Path.join(c.tmp_dir, "recordings/main-VID-001-20261399T000000Z.tlog"), "")

    File.touch!(Path.join(c.tmp_dir, "audit/0000000000000001.jsonl"), div(@start, @second))
    assert {files, notes} = make(c)
    assert length(frames(files["flight.tlog"])) == 10

    for words <- ["damaged parts of main-VID-001", "not a ledger", "2 lines were changed"],
        do: assert(Enum.any?(notes, &(&1 =~ words)), words)
  end

  test "a ledger is read beside its gateway, and not touched", c do
    dir = Path.join(c.tmp_dir, "ledger")
    {:ok, journal, nil, 0} = Journal.open(dir, nil, fn _record, nil -> nil end)
    envelope = %{"id" => "x", "vehicle" => "VID-001", "type" => "land", "params" => %{}, "source" => "ann"}
    at = @start + 5 * @second

    {:ok, journal} =
      Journal.append(journal, [
        ["new", "x", "d", at, envelope],
        ["sent", "x", at + 1],
        ["done", "x", at + 2, "completed", nil, %{"ms" => 3}],
        ["new", "y", "d", at + 9, %{envelope | "id" => "y", "vehicle" => "VID-002"}],
        ["new", 7, [], "odd", nil],
        ["done", "x", at, "odd"]
      ])

    File.write!(journal.path, "torn", [:append])
    before = File.read!(journal.path)
    assert {files, _notes} = make(c)
    assert [line] = String.split(files["commands.jsonl"], "\n", trim: true)

    assert %{"id" => "x", "type" => "land", "result" => "completed", "sent_at" => _, "source" => "ann"} =
             JSON.decode!(line)

    assert File.read!(journal.path) == before
    assert File.ls!(dir) == ["ledger"]
  end
end
