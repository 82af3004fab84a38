defmodule Aerie.CLI.PolicyTryTest do
  @moduledoc "`aerie policy try` over files as people have them, good and bad."
  use ExUnit.Case, async: true

  import ExUnit.CaptureIO

  alias Aerie.Control.Ledger.Journal
  alias Aerie.StandardError
  alias MavCodec.Tlog

  @moduletag :tmp_dir
  @flights Path.expand("../../../../vehicle/test/fixtures", __DIR__)
  @damaged Path.expand("../../../../mav_codec/test/fixtures/recordings", __DIR__)

  defp frames(name) do
    sent = Aerie.Flight.parse(File.read!(Path.join(@flights, name <> "_tx.tlog")))
    Enum.sort_by(Aerie.Flight.frames(name) ++ sent, & &1.at)
  end

  defp bytes(name), do: name |> frames() |> Tlog.records() |> IO.iodata_to_binary()

  defp put(dir, name, bytes) do
    path = Path.join([dir, "of a flight", name])
    File.mkdir_p!(Path.dirname(path))
    File.write!(path, bytes)
    path
  end

  defp config(dir, policy, more \\ "") do
    File.write!(
      Path.join(dir, "gateway.yaml"),
      "policy: {#{policy}}\nrecorder: {dir: \"#{dir}/of a flight\"}\n" <> more
    )

    "gateway.yaml"
  end

  # How far it is, which it writes every five seconds: a busy machine reads a flight for longer than that.
  @progress ~r/^\d+ of \d+: \S+, \d+ frames, at \S+\n/m

  # The exit status, standard output and standard error without lines of progress.
  defp try_it(words, dir) do
    {{result, notes}, text} =
      with_io(fn -> StandardError.capture(fn -> Aerie.CLI.call(["policy", "try" | words], dir) end) end)

    case result do
      {status, ""} -> {status, text, String.replace(notes, @progress, "")}
      {:error, why} -> {2, text, why}
    end
  end

  defp lines(text), do: for(line <- String.split(text, "\n", trim: true), do: JSON.decode!(line))

  test "a table for each recording, and what would be refused by which rule", %{tmp_dir: dir} do
    put(dir, "main-VID-001-20261120T222158Z.tlog", bytes("arducopter_flight"))
    file = config(dir, "max_altitude: 15")

    assert {1, text, ""} = try_it([file], dir)
    assert text =~ ~r/\Amain-VID-001-20261120T222158Z.tlog: VID-001\nTIME +WHO +ROLE/

    assert text =~
             ~r/2026-11-20T22:22:40.446Z  255\/190  operator  VID-001  takeoff .* deny +altitude +the height to climb to is 20 m/

    assert text =~ ~r/setpoint_velocity +SET_POSITION_TARGET_LOCAL_NED +12 +allow/
    # A mission that would not have come whole would not have been begun.
    assert text =~ "41 commands in 1 recordings: 12 would be refused (altitude 10, role 1, unknown 1)"

    # The same by its own name, and with nothing to refuse.
    file = config(dir, "unknown: maintain")

    assert {0, text, ""} =
             try_it(
               [file, "--recordings", "of a flight/main-VID-001-20261120T222158Z.tlog", "--as", "admin"],
               dir
             )

    assert text =~ "41 commands in 1 recordings: 0 would be refused\n"
  end

  test "one JSON object a line", %{tmp_dir: dir} do
    put(dir, "px4.tlog.gz", :zlib.gzip(bytes("px4_flight")))
    assert {1, text, ""} = try_it([config(dir, "max_altitude: 15"), "--json"], dir)
    {decisions, [summary]} = text |> lines() |> Enum.split_with(&(&1["type"] == "decision"))

    assert %{"commands" => n, "refused" => 14, "by_rule" => %{"altitude" => 8, "role" => 5, "unknown" => 1}} =
             summary

    assert length(decisions) == n

    assert %{
             "recording" => "px4.tlog.gz",
             "time" => "2026-11-20T23:11:51.894Z",
             "who" => "255/190",
             "role" => "operator",
             "via" => "mavlink",
             "vehicle" => "VID-001",
             "message" => "DO_REPOSITION",
             "command" => "goto",
             "decision" => "deny",
             "rule" => "altitude",
             "not_recorded" => []
           } = Enum.find(decisions, &(&1["command"] == "goto"))
  end

  test "--as chooses the principal: a role, a client of the policy, a source, a key", %{tmp_dir: dir} do
    put(dir, "flight.tlog", bytes("arducopter_flight"))
    File.write!(Path.join(dir, "keys"), "robot 0123456789abcdef0 role=admin\n")
    File.chmod!(Path.join(dir, "keys"), 0o600)

    policy = "clients: [{id: field, role: operator}, {role: viewer}]"
    more = "clients: [{id: field, url: \"tcpin:127.0.0.1:0\"}]\napi: {keys_file: \"#{dir}/keys\"}\n"
    file = config(dir, policy, more)

    refused = fn words ->
      try_it([file, "--json" | words], dir) |> elem(1) |> lines() |> List.last() |> Map.fetch!("by_rule")
    end

    assert %{"role" => many} = refused.([])
    assert many > 30
    assert refused.(["--as", "viewer"]) == refused.([])
    assert refused.(["--as", "field"]) == %{"role" => 1, "unknown" => 1}
    assert refused.(["--as", "robot"]) == %{"unknown" => 1}

    assert {2, "", why} = try_it([file, "--as", "nobody"], dir)
    assert why =~ "--as: nobody is not known; expected viewer, operator, pilot, admin, field, robot"
  end

  test "bad recordings are remarked on, and do not stop the others", %{tmp_dir: dir} do
    whole = bytes("arducopter_flight")
    put(dir, "empty.tlog", "")
    put(dir, "text.tlog", String.duplicate("not a recording\n", 1000))
    put(dir, "notes.txt", "left alone")
    <<start::binary-size(50_000), _lost::binary-size(500), rest::binary>> = :zlib.gzip(whole)
    put(dir, "damaged.tlog.gz", [start, :binary.copy(<<0>>, 500), rest])
    put(dir, "times.tlog", File.read!(Path.join(@damaged, "all-2pow63.tlog")))
    put(dir, "raw.tlog", File.read!(Path.join(@damaged, "raw.rlog")))
    File.mkdir_p!(Path.join([dir, "of a flight", "folder.tlog"]))
    {_text, 0} = System.cmd("mkfifo", [Path.join([dir, "of a flight", "pipe.tlog"])])

    put(
      dir,
      "z.tlog",
      binary_part(whole, 0, 100_000) <> String.duplicate("junk", 50) <> binary_part(whole, 100_000, 200_000)
    )

    file = config(dir, "max_altitude: 1000")

    assert {status, text, notes} = try_it([file, "--as", "admin"], dir)
    assert status in [1, 2]
    assert text =~ "commands in 1 recordings"

    for part <- [
          "empty.tlog: ",
          "text.tlog: not a recording",
          "damaged.tlog.gz: damaged gzip data",
          "times.tlog: ",
          "raw.tlog: ",
          "folder.tlog: not a file",
          "pipe.tlog: not a file"
        ],
        do: assert(notes =~ part)

    assert notes =~ ~r/z.tlog: \d damaged parts were skipped/
    refute notes =~ "notes.txt"

    # Without anything to refuse, what could not be read shows in the status.
    File.rm!(Path.join([dir, "of a flight", "z.tlog"]))
    assert {2, text, _notes} = try_it([file], dir)
    assert text =~ "0 commands in 0 recordings"
  end

  test "input that cannot be read ends with status 2, and says what to do", %{tmp_dir: dir} do
    file = config(dir, "max_altitude: 15")
    assert {2, "", why} = try_it([file], dir)
    assert why =~ "of a flight: no such file or directory"
    File.mkdir_p!(Path.join(dir, "of a flight"))
    assert {2, "", why} = try_it([file], dir)
    assert why =~ "there are no recordings in it (.tlog, .tlog.gz)"

    put(dir, "flight.tlog", bytes("arducopter_flight"))
    assert {2, "", why} = try_it([file, "--ledger", "nowhere"], dir)
    assert why =~ "nowhere/ledger: no such file"
    assert {2, "", why} = try_it(["none.yaml"], dir)
    assert why =~ "none.yaml"
    assert {2, "", why} = try_it([config(dir, "max_altitude: high")], dir)
    assert why =~ "policy.max_altitude"
    assert {2, "", why} = try_it([config(dir, "geofence_file: gone.geojson")], dir)
    assert why =~ "gone.geojson"
    assert {2, "", why} = try_it([], dir)
    assert why =~ "FILE is missing"
  end

  test "a recording's vehicles are those of its network", %{tmp_dir: dir} do
    links = """
    links:
      - {id: a, url: "udpin:127.0.0.1:0", network: west}
      - {id: b, url: "udpin:127.0.0.1:0", network: west-2}
    """

    flight = bytes("arducopter_flight")
    put(dir, "west-VID-001-20261120T222158Z.tlog", flight)
    put(dir, "west-2-b-20261120T222158Z.tlog", flight)
    put(dir, "main-a-20261120T222158Z.tlog", flight)
    file = config(dir, "max_altitude: 15", links)
    assert {1, text, ""} = try_it([file], dir)
    assert text =~ "west-VID-001-20261120T222158Z.tlog: west-001\n"
    assert text =~ "west-2-b-20261120T222158Z.tlog: west-2-001\n"
    assert text =~ "main-a-20261120T222158Z.tlog: VID-001\n"
    # Copies of a frame are judged once.
    west = try_it([file, "--recordings", "of a flight/west-2-b-20261120T222158Z.tlog"], dir)
    assert elem(west, 1) =~ ~r/operator +west-2-001 +takeoff .* deny +altitude/

    # A name that says none.
    put(dir, "mine.tlog", flight)
    assert {1, text, notes} = try_it([file], dir)
    assert text =~ "mine.tlog: VID-001\n"
    assert notes =~ "mine.tlog: its name does not begin with a network of FILE (main, west, west-2)"
    assert {1, text, ""} = try_it([file, "--recordings", "of a flight/mine.tlog", "--network", "west"], dir)
    assert text =~ "mine.tlog: west-001\n"
    assert {2, "", why} = try_it([file, "--network", "east"], dir)
    assert why =~ "--network east: FILE has the networks main, west, west-2"
  end

  test "the commands of a ledger, with the names of their senders", %{tmp_dir: dir} do
    [first | _] = frames = frames("arducopter_flight")
    put(dir, "flight.tlog", Tlog.records(frames))
    at = first.at + 60_000_000

    envelope = fn vehicle, source ->
      time = at |> DateTime.from_unix!(:microsecond) |> DateTime.to_iso8601()
      deadline = (at + 10_000_000) |> DateTime.from_unix!(:microsecond) |> DateTime.to_iso8601()

      %{"id" => "x", "vehicle" => vehicle, "type" => "save_params", "params" => %{}, "source" => source}
      |> Map.merge(%{"issued_at" => time, "deadline" => deadline})
    end

    {:ok, journal, _acc, 0} = Journal.open(Path.join(dir, "the ledger"), nil, fn _record, acc -> acc end)

    {:ok, journal} =
      Journal.append(journal, [
        ["new", "a", "d", at, envelope.("VID-001", "elixir")],
        ["new", "b", "d", at, envelope.("VID-001", "guest")],
        ["new", "c", "d", at, envelope.("VID-777", "guest")],
        ["new", "old", "d", at, nil]
      ])

    :ok = Journal.close(journal)
    assert {1, text, notes} = try_it([config(dir, "unknown: maintain"), "--ledger", "the ledger"], dir)
    assert text =~ ~r/elixir +admin +VID-001 +save_params +save_params +- +allow/
    assert text =~ ~r/guest +operator +VID-001 +save_params +save_params +- +deny +role/
    assert notes =~ "1 commands of the ledger have ended, and their content is not kept"
    assert notes =~ "the ledger's guest has no role in FILE"
    assert notes =~ "1 commands of the ledger are for VID-777"
  end
end
