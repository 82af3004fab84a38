defmodule Aerie.Control.Policy.Store.Settings do
  @moduledoc """
  Who may command what, where, when and how high: what `Aerie.Control.Policy.compile/1` takes, and the audit log.
  """
  use Aerie.Base.Settings

  alias Aerie.Vehicle.Command.Type
  alias Aerie.Control.Policy.{Roles, Rules}
  alias Aerie.Base.Settings.Types

  section "policy",
          "Limits on what is commanded through the gateway (docs/policy.md). Vehicles have limits of their own: set those as well."

  setting :max_altitude,
          {:number, 0, 100_000},
          "Highest altitude above home that a command may ask for, m. Left out: no limit.",
          example: "120"

  setting :min_altitude,
          {:number, -1000, 100_000},
          "Lowest altitude above home that a command may ask for, m. Landing and what is stored are not meant.",
          example: "10"

  setting :max_altitude_msl,
          {:number, -1000, 100_000},
          "Highest altitude above mean sea level that a command may ask for, m.",
          example: "900"

  setting :geofence_file,
          :file,
          "GeoJSON file of zones that targets of commands, and the straight ways to them, must stay in or out of.",
          example: ~S("/etc/gateway/geofence.json")

  setting :takeoff_battery,
          {:number, 0, 1},
          "Share of its charge that a battery must have for arming, and for whatever may make the vehicle take off.",
          example: "0.3"

  setting :ready_battery,
          {:number, 0, 1},
          """
          Share of its charge below which a vehicle is shown as not ready (docs/fleet.md). No command is refused for it
          alone.
          """,
          default: 0.4

  setting :modes, {:section, mode_fields()}, "Which modes may be asked for."

  setting :conditions,
          {:list, {:section, condition_fields()}},
          """
          Commands that are allowed only while the vehicle is armed or not, in the air or not. Without an entry of their own,
          #{Enum.join(Rules.Condition.workshop(), ", ")}
          need a vehicle that is disarmed and on the ground.
          """,
          default: [],
          example: ~S([{types: [gripper], in_air: false}])

  setting :windows,
          {:list, {:section, window_fields()}},
          """
          Times (UTC) at which commands are allowed: a command that windows name needs one of them to be open. What holds a
          vehicle or brings it down is always allowed.
          """,
          default: [],
          example: ~S([{days: [mon, tue, wed, thu, fri], from: "06:00", to: "20:00"}])

  setting :rates,
          {:list, {:section, rate_fields()}},
          """
          How often each source may give each type of command to each vehicle. Left out: 50 a second, 100 at once. []: no limit.
          Set-points, sticks and transfers are limited only by an entry that names them.
          """,
          example: ~S([{types: [takeoff], per_minute: 6, burst: 2}])

  setting :unknown,
          {:enum, [:refuse, :maintain]},
          """
          What happens to messages and commands (MAV_CMD) of clients that the gateway has no row for: they are refused, or need the
          permission maintain.
          """,
          default: :refuse

  setting :open,
          {:list, {:section, open_fields()}},
          "Single ones of them that may be sent nevertheless with the permission maintain.",
          default: [],
          example: ~S([{command: 43999}, {message: 60000}])

  setting :clients,
          {:list, {:section, client_fields()}},
          """
          What clients that send raw MAVLink may do. A client that no entry names, by its id or by one without an id, is an
          operator on this machine (it writes no parameters), and a viewer beyond it.
          """,
          default: [],
          example: ~S([{id: field-laptop, role: operator}, {role: viewer}])

  setting :sources,
          {:list, {:section, source_fields()}},
          """
          Who may sign commands over NATS: the public nkey of each (`aerie nats-key` makes one). Other keys can command nothing over
          NATS.
          """,
          default: [],
          example: ~S([{name: ops, nkey: UDXU4RCS…, role: operator}])

  setting :unsigned,
          {:enum, Roles.all()},
          """
          Role of unsigned commands over NATS, that is of everybody who may publish to fleet.*.*.cmd.>. Left out: they are denied.
          """,
          example: "operator"

  setting :lease,
          {:section, lease_fields()},
          "Who is in charge of a vehicle (take_control): the source in charge is the only one that commands it."

  setting :audit, {:section, audit_fields()}, "The log of decisions about commands, and of their results."

  defp mode_fields do
    [
      field(:denied, {:one_or_list, :string}, "Modes that may not be asked for.",
        default: [],
        example: "[ACRO]"
      ),
      field(
        :transitions,
        {:map, {:one_or_list, :string}},
        "From these modes only to those; a mode that is not here may be left for any.",
        default: %{},
        example: "{AUTO: [LOITER, RTL]}"
      )
    ]
  end

  defp condition_fields do
    [
      field(:types, {:one_or_list, :string}, "Names of commands.", required: true, filled: true),
      field(:armed, :boolean, "Whether it must be armed."),
      field(:in_air, :boolean, "Whether it must be in the air.")
    ]
  end

  defp window_fields do
    [
      field(:types, {:one_or_list, :string}, "Names of commands; all that may move a vehicle if left out.",
        filled: true
      ),
      field(:days, {:one_or_list, {:enum, Rules.Window.days()}}, "Days on which it begins; all if left out.",
        filled: true
      ),
      field(:from, :string, "HH:MM, UTC.", required: true),
      field(:to, :string, "HH:MM, UTC; before from: on the next day.", required: true)
    ]
  end

  defp rate_fields do
    [
      field(:types, {:one_or_list, :string}, "Names of commands; all but streams if left out.", filled: true),
      field(:sources, {:one_or_list, :string}, "Sources of commands; each one if left out.", filled: true),
      field(:vehicles, {:one_or_list, :string}, "Vehicles; each one if left out.", filled: true),
      field(:per_minute, {:number, 0.001, 1_000_000}, "How often.", required: true),
      field(:burst, {:integer, 1, 100_000}, "How many at once.", default: 1)
    ]
  end

  defp open_fields do
    [
      field(:command, {:integer, 0, 65_535}, "Id of a command (MAV_CMD)."),
      field(:message, {:integer, 0, 16_777_215}, "Id of a message.")
    ]
  end

  defp client_fields do
    [
      field(:id, Types.token(), "The client's id; all others if left out."),
      field(:role, {:enum, Roles.all()}, "#{String.capitalize(Roles.text())}.", default: :operator),
      field(:permissions, {:one_or_list, {:enum, Type.permissions()}}, "Permissions beyond the role's.",
        default: []
      )
    ]
  end

  defp source_fields do
    [
      field(:name, Types.token(), "For people, rates and the audit log.", required: true),
      field(:nkey, :string, "Its public nkey (U…).", required: true),
      field(:role, {:enum, Roles.all()}, "#{String.capitalize(Roles.text())}.", default: :operator),
      field(:permissions, {:one_or_list, {:enum, Type.permissions()}}, "Permissions beyond the role's.",
        default: []
      ),
      field(:expires, :string, "Its last day (UTC), as 2027-12-31.")
    ]
  end

  defp lease_fields do
    [
      field(
        :required,
        :boolean,
        "Whether only the source that took charge of a vehicle commands it; otherwise anybody may while nobody is in charge.",
        default: false
      ),
      field(
        :take_over,
        {:enum, [:operator, :admin]},
        "The lowest role that may take over from somebody else, with a reason.",
        default: :operator
      )
    ]
  end

  defp audit_fields do
    [
      field(:dir, :path, "Folder, for its owner only.", default: "var/audit"),
      field(:max_mb, {:integer, 1, 8192}, "Megabytes that it may take; the oldest records make room.",
        default: 64
      ),
      field(
        :required,
        :boolean,
        """
        Whether commands are refused while the log cannot be written. What holds a vehicle or brings it down is never refused
        for that.
        """,
        default: true
      )
    ]
  end
end
