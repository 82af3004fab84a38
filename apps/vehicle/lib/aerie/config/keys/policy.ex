defmodule Aerie.Config.Keys.Policy do
  @moduledoc "Limits on what commands may ask for."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @doc "The section `policy`."
  @spec section() :: Field.t()
  def section do
    section(
      :policy,
      "Limits on what commands may ask for. Read and checked; nothing in this version applies them yet.",
      [
        field(
          :max_altitude,
          {:number, 0, 100_000},
          "Highest altitude above home that is passed on, m. Left out: no limit.",
          example: "120"
        ),
        field(:geofence_file, :path, "JSON file of the fence that goto targets must be inside.",
          example: ~S("/etc/gateway/geofence.json")
        )
      ]
    )
  end
end
