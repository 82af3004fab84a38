defmodule Aerie.Control.Commands.Settings do
  @moduledoc "How many commands may be under way, and the ledger that keeps any of them from being done twice."
  use Aerie.Base.Settings

  section "commands",
          "Commands over NATS, REST and Elixir (docs/commands.md). What they may do, and who may give them, stands in policy."

  setting :max_in_flight,
          {:integer, 1, 10_000},
          "Commands under way at once, for all vehicles; further ones are denied. What holds a vehicle or brings it down has 64 more.",
          default: 256

  setting :grace_ms,
          {:number, 0, 300},
          "How long a gateway that is stopped waits for commands under way; it takes no new ones then.",
          key: "grace_s",
          default: 5.0,
          times: 1000

  setting :urgent_ms,
          {:number, 0.05, 60},
          """
          How long a command that holds a vehicle or brings it down waits for the ledger and for the audit log, each time it needs
          them. Then it goes on without them, and one that was carried out before is carried out again.
          """,
          key: "urgent_s",
          default: 0.5,
          times: 1000

  setting :record_ms,
          {:number, 0.5, 600},
          """
          How long any other command waits for them, each time. It is denied if they do not answer in that time, as on a disk that hangs.
          """,
          key: "record_s",
          default: 5.0,
          times: 1000

  setting :ledger, {:section, ledger_fields()}, "The ids of commands and their results, on disk."

  defp ledger_fields do
    [
      field(:dir, :path, "Folder, for its owner only.", default: "var/ledger"),
      field(:max_entries, {:integer, 100, 1_000_000}, "Commands that it knows.", default: 20_000),
      field(:max_age_s, {:number, 1200, 31_536_000}, "How long it knows them.", default: 86_400.0),
      field(
        :required,
        :boolean,
        """
        Whether commands are denied while it cannot be written. What holds a vehicle or brings it down is not denied for that.
        """,
        default: true
      )
    ]
  end
end
