defmodule Aerie.CLI.IncidentTest do
  @moduledoc "`aerie incident` with the folders of a gateway that has stopped."

  use ExUnit.Case, async: true

  alias Aerie.CLI.Subcommand.Recordings.Incident
  alias Aerie.StandardError

  @moduletag :tmp_dir

  defp incident(dir, options, vehicle \\ "VID-001") do
    config = Path.join(dir, "gateway.yaml")

    folders =
      for {part, name} <- [recorder: "recordings", shadow: "shadow"],
          do: "#{part}: {dir: #{inspect(Path.join(dir, name))}}\n"

    ledger = "commands: {ledger: {dir: #{inspect(Path.join(dir, "ledger"))}}}\n"
    File.write!(config, [folders, ledger, "policy: {audit: {dir: #{inspect(Path.join(dir, "audit"))}}}\n"])
    options = Map.merge(%{config: config, to: "2026-11-28T20:15:00Z"}, options)
    request = %{name: "incident", arguments: %{"VEHICLE" => vehicle}, options: options, folder: dir}
    StandardError.capture(fn -> Incident.run(request) end)
  end

  test "the archive's name goes to standard output, the rest beside it", %{tmp_dir: dir} do
    assert {{:error, text}, _notes} = incident(dir, %{from: "20:00"})
    assert text =~ "nothing is known of VID-001 from 2026-11-28T20:00:00"
    {:ok, time, 0} = DateTime.from_iso8601("2026-11-28T20:05:00Z")
    beat = MavCodec.encode(%MavCodec.Messages.Heartbeat{type: 2, autopilot: 3}, system: 1, component: 1)
    File.mkdir_p!(Path.join(dir, "recordings"))
    recording = Path.join(dir, "recordings/main-VID-001-20261128T200500Z.tlog")
    File.write!(recording, <<DateTime.to_unix(time, :microsecond)::64, beat::binary>>)
    assert {{0, text}, notes} = incident(dir, %{from: "20:00"})
    assert [_all, file] = Regex.run(~r/\A(.+\.tar\.gz): \d+ bytes\n\z/, text)
    assert Path.dirname(file) == dir and File.exists?(file)
    assert notes =~ "VID-001, 2026-11-28T20:00:00" and notes =~ "not included: "
    own = Path.join(dir, "own.tar.gz")
    assert {{0, _text}, _notes} = incident(dir, %{output: own})
    assert File.exists?(own)
  end

  test "a name that no vehicle has is refused before the recordings are read", %{tmp_dir: dir} do
    recording = Path.join(dir, "recordings/main-VID-001-20261128T200500Z.tlog")
    File.mkdir_p!(Path.dirname(recording))
    beat = MavCodec.encode(%MavCodec.Messages.Heartbeat{type: 2, autopilot: 3}, system: 1, component: 1)
    {:ok, time, 0} = DateTime.from_iso8601("2026-11-28T20:05:00Z")
    File.write!(recording, <<DateTime.to_unix(time, :microsecond)::64, beat::binary>>)
    assert {{:error, text}, notes} = incident(dir, %{from: "20:00"}, "VDI-001")
    assert text =~ "no vehicle that this gateway hears has the name VDI-001: others are VID- and three digits"
    refute notes =~ "reading"
    assert {{:error, text}, notes} = incident(dir, %{from: "20:00"}, "VID-002")
    assert text =~ "nothing is known of VID-002"
    assert notes =~ "reading main-VID-001-20261128T200500Z.tlog"
  end

  test "what is wrong is named before anything is read", %{tmp_dir: dir} do
    assert {{:error, text}, _notes} = incident(dir, %{}, "a vehicle")
    assert text =~ "a vehicle's name has 1 to 64 letters"
    assert {{:error, text}, _notes} = incident(dir, %{max_mb: 0})
    assert text =~ "--max-mb 0: expected 1 to 65536"
    assert {{:error, text}, _notes} = incident(dir, %{from: "soon"})
    assert text =~ "soon"
    assert {{:error, text}, _notes} = incident(dir, %{config: Path.join(dir, "gone.yaml")})
    assert text =~ "gone.yaml"
    request = %{name: "incident", arguments: %{"VEHICLE" => "V"}, options: %{dir: dir}, folder: dir}
    assert {3, text} = Incident.run(request)
    assert IO.iodata_to_binary(text) =~ "--config FILE reads the folders of a stopped one"
  end
end
