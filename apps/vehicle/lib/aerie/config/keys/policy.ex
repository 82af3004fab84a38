defmodule Aerie.Config.Keys.Policy do
  @moduledoc "Limits on commands. Read and checked, but not enforced yet."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @doc "The section `policy`."
  @spec section() :: Field.t()
  def section do
    section(
      :policy,
      "NOT ENFORCED in this version: limits on commands. The section is read and checked, and a start that has one warns; " <>
        "no command is refused because of it. Set the limits on the vehicles themselves.",
      [
        field(
          :max_altitude,
          {:number, 0, 100_000},
          "Highest altitude above home that a command may ask for, m. Left out: no limit.",
          example: "120"
        ),
        field(:geofence_file, :path, "JSON file of the fence that the targets of commands must lie inside.",
          example: ~S("/etc/gateway/geofence.json")
        )
      ]
    )
  end
end
