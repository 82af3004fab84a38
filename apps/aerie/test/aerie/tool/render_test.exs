defmodule Aerie.Tool.RenderTest do
  @moduledoc "What `bin/aerie` and its shell print, from values."
  use ExUnit.Case, async: true

  alias Aerie.Shell.Text
  alias Aerie.Tool.{Columns, Run}

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

  @status %{
    "vehicles" => [
      %{
        "vehicle" => "VID-001",
        "status" => "online",
        "type" => "copter",
        "autopilot" => "px4",
        "mode" => "AUTO_LOITER",
        "armed" => true,
        "position" => %{"lat" => 47.5, "lon" => 8.25, "alt_rel" => 12.5},
        "battery" => %{"remaining" => 0.98}
      }
    ],
    "links" => [%{"id" => "radio", "status" => "down", "network" => "main", "text" => "no such file"}],
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
    text = IO.iodata_to_binary(Run.Status.render(@status))

    assert text =~
             "not ready: 1 vehicles, 1 links\nNATS not connected, 7 events wait\nproblem: connection refused\n"

    assert text =~ ~r/VID-001 +online +copter px4 +AUTO_LOITER +ARMED +47.5 +8.25 +12.5 m +98%/
    assert text =~ ~r/radio +down +main +no such file/
    assert text =~ "error: link radio: gone\n  e1\n  to mend it: plug it in\n"

    # What a vehicle has not told is a gap.
    silent = %{"vehicle" => "x", "status" => "stale", "position" => %{}, "battery" => %{}}

    assert IO.iodata_to_binary(Run.Status.render(%{@status | "vehicles" => [silent]})) =~
             ~r/x +stale +- +- +- +- +- +- +- +- +-\n/
  end

  test "parameters of a command are JSON where they can be" do
    assert {:ok, %{"altitude" => 20, "mode" => "RTL", "force" => true, "empty" => "", "x" => "a=b"}} =
             Run.Command.params(~w(altitude=20 mode=RTL force=true empty= x=a=b))

    assert {:error, "'altitude': expected NAME=VALUE"} = Run.Command.params(["altitude"])
    assert {:error, _text} = Run.Command.params(["=5"])
  end

  test "the doctor looks at processes, clock and findings" do
    folder = Path.join(System.tmp_dir!(), "aerie-doctor-#{System.unique_integer([:positive])}")
    File.mkdir_p!(Path.join(folder, "17"))
    on_exit(fn -> File.rm_rf!(folder) end)

    File.write!(Path.join(folder, "17/comm"), "bash\n")
    assert [%{level: :ok}] = Run.Doctor.modem_manager(folder)
    File.write!(Path.join(folder, "17/comm"), "ModemManager\n")
    assert [%{level: :warning, mend: "sudo systemctl mask" <> _}] = Run.Doctor.modem_manager(folder)

    now = System.os_time(:second)
    mark = Path.join(folder, "timesync/synchronized")
    assert [%{level: :ok}] = Run.Doctor.clock(mark, now)
    File.mkdir_p!(Path.dirname(mark))
    assert [%{level: :warning}] = Run.Doctor.clock(mark, now)
    File.write!(mark, "")
    assert [%{level: :ok}] = Run.Doctor.clock(mark, now)
    assert [%{level: :error, text: "1970-01-01" <> _}] = Run.Doctor.clock(mark, 0)

    findings = [
      %{what: "disk", level: :ok, text: "much", mend: nil},
      %{what: "clock", level: :error, text: "wrong", mend: "set it"}
    ]

    assert IO.iodata_to_binary(Run.Doctor.render(findings)) ==
             "error    clock: wrong\n         to mend it: set it\nok       disk: much\n"
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

    text = IO.iodata_to_binary(Run.Probe.render(report))
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

    text = IO.iodata_to_binary(Run.Probe.render(silent))
    assert text =~ "baud rate 57600" and text =~ "no MAVLink was heard" and text =~ "a GPS receiver"
  end

  test "the shell's tree shows restarts" do
    leaf = %{
      path: [:a],
      name: "Link radio",
      pid: self(),
      type: :worker,
      memory: 10,
      queue: 0,
      restarts: %{count: 2, at: 0, reason: "killed"},
      children: []
    }

    root = %{leaf | name: "gateway", pid: nil, restarts: nil, children: [leaf]}
    text = IO.iodata_to_binary(Text.tree(root))
    assert text =~ ~r/  Link radio +#PID<.*> +10 +0 +2, the last: killed/
    assert IO.iodata_to_binary(Text.fleet([], [], 0)) =~ "no vehicle"
  end
end
