defmodule Aerie.CLI.RenderTest do
  @moduledoc "What `bin/aerie` and its shell print, from values."
  use ExUnit.Case, async: true

  alias Aerie.Shell.Text
  alias Aerie.CLI.Subcommand
  alias Aerie.CLI.Output.Columns
  alias Aerie.CLI.Status.{Table, View}

  test "columns are as wide as their widest text; what is not known is a gap, and nothing steers the terminal" do
    text =
      IO.iodata_to_binary(
        Columns.render(["A", "LONG NAME"], [["x", nil], ["wide one", 1.5], ["\e[2Jx\n", <<0xFF>>]])
      )

    assert text == """
           A         LONG NAME
           x         -
           wide one  1.5
           ?[2Jx?    ?
           """
  end

  @now 1_795_213_318_000_000
  @view %View{
    now: @now,
    started: @now,
    vehicles: [
      %Aerie.Vehicle.Snapshot{
        id: "VID-001",
        status: :online,
        vehicle_type: "copter",
        autopilot: :px4,
        last_heard: @now,
        links: ["radio"],
        groups: %{
          mode: %{at: @now, data: %{mode: "AUTO_LOITER", armed: true}},
          position: %{at: @now, data: %{lat: 47.5, lon: 8.25, alt_rel: 12.5}},
          battery: %{at: @now, data: %{remaining: 0.98}}
        }
      }
    ],
    links: [
      %{
        id: "radio",
        url: "/dev/ttyACM0",
        status: :down,
        text: "no such file",
        rates: %{frames_in: 0.0, writes_out: 0.0, bytes_in: 0.0},
        counters: %{crc_errors: 3, lost: 7}
      }
    ]
  }

  @status %{
    "vehicles" => [%{}],
    "links" => [%{}],
    "health" => %{
      "status" => "not ready",
      "nats" => %{"connected" => false, "url" => nil, "outbox" => 7, "problem" => "connection refused"},
      "identity" => %{"alarm" => nil},
      "audit" => %{"problem" => nil},
      "policy" => %{"problem" => nil},
      "problems" => []
    },
    "conditions" => [
      %{
        "severity" => "error",
        "subject" => "link",
        "id" => "radio",
        "title" => "gone",
        "evidence" => ["e1"],
        "mend" => "plug it in"
      }
    ]
  }

  test "the status says what is there, what is wrong, and the mend" do
    text = IO.iodata_to_binary(Subcommand.Running.Status.render(@status, @view))

    assert text =~
             "not ready: 1 vehicle, 1 link\nNATS not connected, 7 events wait\nproblem: connection refused\n"

    assert text =~ ~r/VID-001 +online +copter px4 +AUTO_LOITER +ARMED +47.500000 +8.250000 +12.5 m +- +98% -/
    assert text =~ ~r/radio +.dev.ttyACM0 +down +0 +0 +0.0 +3 +7 +no such file/
    assert text =~ "error: link radio: gone\n  e1\n  fix: plug it in\n"

    # What a vehicle has not told is a gap.
    silent = %{hd(@view.vehicles) | id: "x", status: :stale, autopilot: nil, vehicle_type: nil, groups: %{}}

    assert IO.iodata_to_binary(Subcommand.Running.Status.render(@status, %{@view | vehicles: [silent]})) =~
             ~r/x +stale +- - +- +- +- +- +- +- +- - +- +0.0 s\n/

    none = IO.iodata_to_binary(Subcommand.Running.Status.render(@status, %{@view | vehicles: [], links: []}))
    assert none =~ "no vehicle was heard" and none =~ "there is no link"
  end

  test "a link that is not up, and the own vehicle that is not heard, are missing" do
    radio = %{id: "radio", status: :down, text: "no such file"}
    online = %{id: "VID-001", status: :online}
    assert Subcommand.Running.Status.missing([radio], [], nil) == ["link radio: no such file"]

    assert Subcommand.Running.Status.missing([%{radio | status: :connecting}], [], nil) == [
             "link radio: no such file"
           ]

    for status <- [:up, :idle, :ended],
        do: assert(Subcommand.Running.Status.missing([%{radio | status: status}], [], nil) == [])

    assert Subcommand.Running.Status.missing([], [online], "VID-001") == []

    for vehicles <- [[], [%{online | status: :lost}], [%{online | id: "VID-002"}]] do
      assert Subcommand.Running.Status.missing([], vehicles, "VID-001") ==
               ["VID-001, aboard which this gateway runs (vehicle_id), is not heard"]
    end
  end

  test "the doctor looks for the devices of configured links" do
    link = fn id, url -> %{id: id, enabled: true, spec: MavRouter.Link.Spec.parse!(url)} end
    gone = link.("gone", "/dev/ttyNONE7,57600")

    assert [
             %{
               what: "link gone",
               level: :error,
               text: "/dev/ttyNONE7: no such file or directory",
               mend: "plug it in" <> _
             }
           ] =
             Subcommand.Machine.Doctor.devices([
               gone,
               link.("there", "/dev/null,57600"),
               link.("net", "udpin::14550"),
               %{gone | enabled: false}
             ])

    assert [%{text: "/dev/ttyNONE8: " <> _}] =
             Subcommand.Machine.Doctor.devices([link.("msp", "msp:ttyNONE8,115200")])

    assert Subcommand.Machine.Doctor.devices([link.("any", "serial:auto")]) == []
  end

  test "parameters of a command are JSON where they can be" do
    assert {:ok, %{"altitude" => 20, "mode" => "RTL", "force" => true, "empty" => "", "x" => "a=b"}} =
             Subcommand.Command.params(~w(altitude=20 mode=RTL force=true empty= x=a=b))

    assert {:error, "'altitude': expected NAME=VALUE"} = Subcommand.Command.params(["altitude"])
    assert {:error, _text} = Subcommand.Command.params(["=5"])
  end

  test "the doctor looks at processes, clock and findings" do
    folder = Path.join(System.tmp_dir!(), "aerie-doctor-#{System.unique_integer([:positive])}")
    File.mkdir_p!(Path.join(folder, "17"))
    on_exit(fn -> File.rm_rf!(folder) end)

    File.write!(Path.join(folder, "17/comm"), "bash\n")
    assert [%{level: :ok}] = Subcommand.Machine.Doctor.modem_manager(folder)
    File.write!(Path.join(folder, "17/comm"), "ModemManager\n")

    assert [%{level: :warning, mend: "sudo systemctl mask" <> _}] =
             Subcommand.Machine.Doctor.modem_manager(folder)

    now = System.os_time(:second)
    mark = Path.join(folder, "timesync/synchronized")
    assert [%{level: :ok}] = Subcommand.Machine.Doctor.clock(mark, now)
    File.mkdir_p!(Path.dirname(mark))
    assert [%{level: :warning}] = Subcommand.Machine.Doctor.clock(mark, now)
    File.write!(mark, "")
    assert [%{level: :ok}] = Subcommand.Machine.Doctor.clock(mark, now)
    assert [%{level: :error, text: "1970-01-01" <> _}] = Subcommand.Machine.Doctor.clock(mark, 0)

    findings = [
      %{what: "disk", level: :ok, text: "much", mend: nil},
      %{what: "clock", level: :error, text: "wrong", mend: "set it"}
    ]

    assert IO.iodata_to_binary(Subcommand.Machine.Doctor.render(findings)) ==
             "error    clock: wrong\n         fix: set it\nok       disk: much\n"
  end

  test "a probe's report names what was heard, or that nothing was" do
    report = %{
      url: "udpin:0.0.0.0:14550",
      status: :up,
      text: "listening",
      baud: nil,
      frames: 120,
      crc_errors: 1,
      protocol: "MAVLink",
      found: [],
      vehicles: [%{system: 1, component: 1, autopilot: :px4, type: :copter, firmware: "1.16.0"}],
      messages: [%{system: 1, component: 1, name: "ATTITUDE", hz: 10.0, count: 50}]
    }

    text = IO.iodata_to_binary(Subcommand.Machine.Probe.render(report))
    assert text =~ "MAVLink: 120 frames, 1 with a wrong checksum"
    assert text =~ ~r/1 +1 +px4 +copter +1.16.0/
    assert text =~ ~r/1 +1 +ATTITUDE +10.0 +50/

    silent = %{
      report
      | frames: 0,
        protocol: nil,
        vehicles: [],
        messages: [],
        baud: 57_600,
        found: ["/dev/ttyUSB0: a GPS receiver (NMEA)"]
    }

    text = IO.iodata_to_binary(Subcommand.Machine.Probe.render(silent))
    assert text =~ "baud rate 57600" and text =~ "no MAVLink was heard" and text =~ "a GPS receiver"
  end

  test "the shell's tree shows restarts" do
    leaf = %{path: [:gateway, :a], name: "Link radio", pid: self(), memory: 10, queue: 0}
    top = %{leaf | path: [:gateway], name: "gateway", pid: nil}
    tree = [{top, nil}, {leaf, %{count: 2, at: 0, reason: "killed"}}]
    text = IO.iodata_to_binary(Text.tree(tree))
    assert text =~ ~r/  Link radio +#PID<.*> +10 +0 +2, the last: killed/
    assert IO.iodata_to_binary(Table.vehicles(%View{now: 0})) =~ "no vehicle"
  end
end
