defmodule Aerie.Config.Keys.Outbox do
  @moduledoc "Events that wait on disk."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @doc "The section `outbox`."
  @spec section() :: Field.t()
  def section do
    section(:outbox, "Events wait here on disk while NATS is away.", [
      field(:dir, :path, "Folder.", default: "var/outbox"),
      field(:max_mb, {:integer, 1, 65_536}, "Size; the oldest events go first, and are counted.",
        default: 64
      ),
      field(:segment_kb, {:integer, 4, 65_536}, "Size of one file in it.", default: 1024),
      field(
        :fsync,
        {:enum, [:always, :interval, :never]},
        """
        When data is forced to the disk: always (after each write), interval, never (left to the system).
        """,
        default: :interval
      ),
      field(:fsync_interval_ms, {:integer, 10, 60_000}, "For interval.", default: 1000)
    ])
  end
end
