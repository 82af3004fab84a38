defmodule Aerie.CLI.Subcommands do
  @moduledoc "The subcommands of `bin/aerie`, in the order of its help."

  alias Aerie.CLI.Help.About
  alias Aerie.CLI.Subcommand
  alias Aerie.CLI.Start.Options

  @vehicle {"VEHICLE", "its name in the fleet, as aerie status shows it"}
  @json {:json, :boolean, nil, "print JSON"}
  @yes {:yes, :boolean, nil, "do not ask for confirmation"}
  @force {:force, :boolean, nil, "send a fence that the vehicle, which flies, breaches at once"}
  @component {:component, :integer, "ID",
              "of the camera, gimbal or companion with this component id, not of the autopilot"}
  @config {:config, :string, "FILE",
           "the configuration file (default: AERIE_CONFIG, else the default values and the environment)"}

  @doc "All of them."
  @spec all() :: [Subcommand.t()]
  def all,
    do: starting() ++ looking() ++ commanding() ++ Subcommand.Operation.rows() ++ keeping() ++ scripting()

  @doc "The one of this name."
  @spec fetch(String.t()) :: {:ok, Subcommand.t()} | :error
  def fetch(name) do
    case Enum.find(all(), &(&1.name == name)) do
      nil -> :error
      row -> {:ok, row}
    end
  end

  defp starting do
    [
      %Subcommand{
        name: "start",
        summary: "start a gateway in the foreground",
        where: :script,
        options: Options.all(),
        more:
          "NATS is embedded unless --nats or the configuration names a server. Without --link, --replay and --config, three simulated vehicles " <>
            "fly (in a checkout; a release has none), and UDP port 14550 is open for real ones. Ctrl-C stops it.",
        terms: Options.terms()
      },
      %Subcommand{
        name: "daemon",
        summary: "start a gateway in the background; its output goes to var/log",
        where: :script,
        arguments: [{"[OPTION ...]", "those of start"}]
      },
      %Subcommand{
        name: "stop",
        summary: "shut the gateway down, and wait until it has ended",
        where: :here,
        module: Subcommand.Running.Stop,
        options: Subcommand.common(%{where: :gateway})
      },
      %Subcommand{
        name: "upgrade",
        summary: "put another version in the place of the installed gateway, while vehicles fly",
        where: :here,
        module: Subcommand.Running.Upgrade,
        arguments: [{"[FILE]", "a release's tarball; left out: the version that a package has installed"}],
        options:
          [
            {:back, :boolean, nil, "back to the version before"},
            {:now, :boolean, nil, "also if something is lost by it, which is named otherwise"},
            {:take_over, :boolean, nil, "the version of this program takes the place (install.sh calls this)"}
          ] ++ Subcommand.common(%{where: :gateway}),
        more:
          "The other version starts beside the gateway and waits until it has loaded everything; then the gateway ends, and it goes on. Exit status: 0 it " <>
            "runs, 4 something would be lost (transfers, operations, commands, somebody who steers or is in charge), and nothing was changed, 2 it " <>
            "cannot, and why. docs/operating.md describes it."
      },
      %Subcommand{name: "version", summary: "print the version", where: :here, module: About}
    ]
  end

  defp looking do
    [
      %Subcommand{
        name: "status",
        summary: "show vehicles, links, NATS and problems",
        where: :gateway,
        module: Subcommand.Running.Status,
        options: [@json],
        more:
          "Exit status: 0 it is ready, every link is up, and aboard a vehicle (vehicle_id) that one is heard; 1 something is wrong, and is said; 3 no gateway is running."
      },
      %Subcommand{
        name: "tail",
        summary: "print a vehicle's events and changes of state as they come, until Ctrl-C",
        where: :gateway,
        module: Subcommand.Running.Tail,
        arguments: [@vehicle],
        options: [
          {:events, :boolean, nil, "events only"},
          {:count, :integer, "N", "stop after N lines"},
          {:json, :boolean, nil, "print JSON lines, as in NATS"}
        ]
      },
      %Subcommand{
        name: "probe",
        summary:
          "find out what is connected to a serial port or an address: protocol, rate, ids, versions, messages",
        where: :here,
        module: Subcommand.Machine.Probe,
        arguments: [
          {"PORT|URL", "a device such as /dev/ttyACM0, or a connection string such as udpin:0.0.0.0:14550"}
        ],
        options: [{:seconds, :float, "N", "how long to listen (default 5)"}, @json],
        more:
          "Exit status: 0 a vehicle was found, 1 something else or nothing, 2 the port or address cannot be opened."
      },
      %Subcommand{
        name: "doctor",
        summary: "check whether this machine has what a gateway needs, and say how to fix what is wrong",
        where: :here,
        module: Subcommand.Machine.Doctor,
        options: [@config, @json],
        more: "Exit status: 0 everything works, perhaps with warnings; 1 something will not work."
      },
      %Subcommand{
        name: "replay",
        summary: "print the events of a recorded flight as JSON lines",
        where: :here,
        module: Subcommand.Recordings.Replay,
        arguments: [{"FILE", "a .tlog file"}],
        options: [{:samples, :boolean, nil, "also print the state samples"}, @config],
        more: "aerie start --replay FILE plays it to clients and the console."
      },
      %Subcommand{
        name: "incident",
        summary: "pack what is known of a vehicle and a time into one archive, with a page that plots it",
        where: :here,
        module: Subcommand.Recordings.Incident,
        arguments: [@vehicle],
        options:
          [
            {:from, :string, "TIME", "where it begins (default: 15 minutes before --to)"},
            {:to, :string, "TIME", "where it ends (default: now)"},
            {:output, :string, "FILE", "the archive (default: incident-VEHICLE-TIME.tar.gz in this folder)"},
            {:max_mb, :integer, "N", "the most that the recordings in it may have (default: 512)"},
            {:config, :string, "FILE",
             "read the folders of the gateway with this configuration, whether it runs or not"}
          ] ++ Subcommand.common(%{where: :gateway}),
        more:
          "TIME is RFC 3339 (2026-11-28T20:15:00Z), HH:MM in UTC, or before now: -10m, -90s, -2h, -1d. The archive has recordings, events, commands with " <>
            "their decisions, audit log, desired state and diagnosis, without keys; index.html in it shows them. docs/recordings.md describes it."
      },
      %Subcommand{
        name: "msp",
        summary: "print what went over a line with MSP, from the recording of its link",
        where: :here,
        module: Subcommand.Recordings.Msp,
        arguments: [{"FILE", "a .tlog file of a link (recorder.links), not of a vehicle"}],
        options: [@json],
        more:
          "> is a request, < its reply, ! a refusal. In the end the gateway's part is done again with what was recorded. Exit status: 0 it does the same, " <>
            "1 it does not, which is an error in Aerie, or another version's recording."
      }
    ]
  end

  defp commanding do
    [
      %Subcommand{
        name: "cmd",
        summary: "send a command to a vehicle, and print its result",
        where: :gateway,
        module: Subcommand.Command,
        arguments: [
          @vehicle,
          {"TYPE", "such as arm, takeoff, goto (docs/commands.md)"},
          {"[NAME=VALUE ...]", "parameters"}
        ],
        options: [@yes, @json],
        more:
          "Commands that move a vehicle ask for confirmation. Exit status: 0 completed or accepted, 1 any other result, 2 not a valid command."
      },
      %Subcommand{
        name: "params list",
        summary: "print a vehicle's parameters",
        where: :gateway,
        module: Subcommand.Params,
        arguments: [@vehicle, {"[PATTERN]", "only names that contain this text"}],
        options: [{:refresh, :boolean, nil, "read them from the vehicle again"}, @component, @json]
      },
      %Subcommand{
        name: "params get",
        summary: "read one parameter from the vehicle",
        where: :gateway,
        module: Subcommand.Params,
        arguments: [@vehicle, {"NAME", "the parameter"}],
        options: [@component]
      },
      %Subcommand{
        name: "params set",
        summary: "set one parameter, and wait until the vehicle confirms it",
        where: :gateway,
        module: Subcommand.Params,
        arguments: [@vehicle, {"NAME", "the parameter"}, {"VALUE", "a number; with --component also text"}],
        options: [@component, @yes]
      },
      %Subcommand{
        name: "params save",
        summary:
          "write all parameters to a file for Mission Planner and MAVProxy, for QGroundControl (.params), or for the configurators of Betaflight and iNav (.txt)",
        where: :here,
        module: Subcommand.ParamsFile,
        arguments: [@vehicle, {"FILE", "the file to write; an existing one is replaced"}],
        options: Subcommand.common(%{where: :gateway})
      },
      %Subcommand{
        name: "mission show",
        summary: "print a vehicle's mission, fence or rally points",
        where: :gateway,
        module: Subcommand.Mission,
        arguments: [@vehicle, {"[KIND]", "mission (the default), fence or rally"}],
        options: [@json]
      },
      %Subcommand{
        name: "mission clear",
        summary: "remove a plan from a vehicle",
        where: :gateway,
        module: Subcommand.Mission,
        arguments: [@vehicle, {"[KIND]", "mission (the default), fence or rally"}],
        options: [@yes]
      },
      %Subcommand{
        name: "mission load",
        summary: "send the mission of a .plan, .waypoints or .mission file to a vehicle, and read it back",
        where: :here,
        module: Subcommand.MissionFile,
        arguments: [
          @vehicle,
          {"FILE", "a plan of QGroundControl or Mission Planner"},
          {"[KIND]", "mission, fence or rally"}
        ],
        options: [@yes, @force | Subcommand.common(%{where: :gateway})]
      },
      %Subcommand{
        name: "record",
        summary: "start, stop, save or list recordings",
        where: :gateway,
        module: Subcommand.Record,
        arguments: [
          {"ACTION", "start, stop, save (the last minutes) or list"},
          {"[VEHICLE]", "the vehicle; list takes none"}
        ],
        options: [@json]
      }
    ]
  end

  defp keeping do
    [
      %Subcommand{
        name: "config check",
        summary: "check a configuration completely, without starting anything",
        where: :here,
        module: Subcommand.Machine.Config,
        arguments: [{"[FILE]", "default: AERIE_CONFIG, else the default values and the environment"}],
        more:
          "Exit status: 0 a gateway can start with it, 1 it cannot. Every error names its file, its key and what was expected."
      },
      %Subcommand{
        name: "config show",
        summary: "print the keys that are set, their values, and where they were set",
        where: :here,
        module: Subcommand.Machine.Config,
        arguments: [{"[FILE]", "as for config check"}],
        options: [{:all, :boolean, nil, "also print the keys with default values"}]
      },
      %Subcommand{
        name: "policy try",
        summary: "replay recorded flights against a policy, and say which commands it would have refused",
        where: :here,
        module: Subcommand.Policy,
        arguments: [{"FILE", "the configuration file with the section policy"}],
        options: [
          {:recordings, :string, "DIR",
           "the folder of the recordings, or one of them (default: recorder.dir of FILE)"},
          {:network, :string, "NAME",
           "the network of the recordings (default: the one that their names begin with, otherwise that of FILE)"},
          {:ledger, :string, "DIR", "the folder of a ledger: its commands with the names of their senders"},
          {:as, :string, "WHO",
           "judge senders that are known by their ids only as viewer, operator, pilot or admin, or as an id of policy.clients, " <>
             "a name of policy.sources or of a key"},
          {:command, :string, "JSON",
           "judge this command, or that of a file, in place of recorded ones: allow, or deny with rule and reason"},
          {:vehicle, :string, "JSON",
           ~s(with --command: what is known about the vehicle, e.g. {"mode": {"armed": false}}, or a file with it)},
          @json
        ],
        more:
          "Exit status: 0 nothing would be refused, 1 something would be, 2 FILE, a recording or the ledger cannot be read. docs/policy.md explains the table."
      },
      %Subcommand{
        name: "audit check",
        summary: "check that no record of an audit log was changed or is missing",
        where: :here,
        module: Subcommand.Audit,
        arguments: [{"[FOLDER]", "the folder of the log (default: policy.audit.dir of the configuration)"}],
        options: [@config],
        more: "Exit status: 0 it is intact, 1 it is damaged or was changed, 2 it cannot be read."
      },
      %Subcommand{
        name: "nats-setup",
        summary:
          "write what a hub's nats-server and the leaf nodes of its vehicles need: accounts, keys, certificates, configuration",
        where: :here,
        module: Subcommand.Nats.Setup,
        arguments: [{"FOLDER", "where the files are; run it again to add or remove vehicles and hubs"}],
        options: [
          {:host, :keep, "NAME",
           "a server of the hub, by the name or address at which vehicles reach it; three make a cluster. Later: all of them, if they change"},
          {:vehicle, :keep, "ID", "a vehicle to add"},
          {:hub, :keep, "NAME",
           "another hub to add: a gateway on the same servers that shows and commands the same vehicles"},
          {:revoke, :keep, "NAME", "a vehicle or hub to remove: its key stops working"},
          {:new_key, :keep, "NAME",
           "give a vehicle or hub another key (hub: the first hub), because the one that it has was lost: that one stops working"},
          {:environment, :string, "NAME", "second word of every subject (default: prod)"}
        ],
        more:
          "--host is required the first time. It prints what to copy where, and whether the hub's servers need a restart. Run again with the same words, " <>
            "it changes nothing. docs/fleet.md explains the files."
      },
      %Subcommand{
        name: "nats-key",
        summary:
          "make a key by which a program signs commands over NATS, and print the section of the configuration that lists it",
        where: :here,
        module: Subcommand.Nats.Key,
        arguments: [{"FILE", "the file for the seed; a key that is there is kept, and its section printed"}],
        options: [
          {:name, :string, "NAME",
           "the source's name in the policy and the audit log (default: that of FILE)"},
          {:role, :string, "ROLE", "viewer, operator (the default), pilot or admin"}
        ],
        more: "docs/commands.md describes the signature; docs/clients has programs that sign."
      },
      %Subcommand{
        name: "user add",
        summary: "add a user of the console; the password is the first line of standard input",
        where: :gateway,
        module: Subcommand.User,
        arguments: [{"NAME", "a-z, 0-9, dot, underscore, hyphen"}],
        options: [{:role, :string, "ROLE", "viewer, operator (the default), pilot or admin"}]
      },
      %Subcommand{
        name: "user list",
        summary: "list the users of the console",
        where: :gateway,
        module: Subcommand.User
      },
      %Subcommand{
        name: "user remove",
        summary: "remove a user of the console",
        where: :gateway,
        module: Subcommand.User,
        arguments: [{"NAME", "the user's name"}]
      }
    ]
  end

  defp scripting do
    [
      %Subcommand{
        name: "remote",
        summary: "open an Elixir shell in the gateway (Aerie.Shell)",
        where: :here,
        module: Subcommand.Running.Remote,
        options: Subcommand.common(%{where: :gateway})
      },
      %Subcommand{
        name: "rpc",
        summary: "evaluate Elixir in the gateway, and print the value",
        where: :gateway,
        module: Subcommand.Running.Evaluate,
        arguments: [{"EXPRESSION", "Aerie.Shell's functions are imported"}]
      },
      %Subcommand{
        name: "eval",
        summary: "evaluate Elixir without a gateway",
        where: :here,
        module: Subcommand.Running.Evaluate,
        arguments: [{"EXPRESSION", "such as 'Application.spec(:aerie, :vsn)'"}]
      },
      %Subcommand{
        name: "completion",
        summary: "print the completion for bash: . <(aerie completion)",
        where: :here,
        module: About
      },
      %Subcommand{
        name: "man",
        summary: "print the man page: aerie man | man -l -",
        where: :here,
        module: About
      }
    ]
  end
end
