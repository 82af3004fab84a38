defmodule Aerie.Config.Keys.Vehicles do
  @moduledoc "Public names of vehicles."

  import Aerie.Config.Field, only: [field: 3, field: 4]

  alias Aerie.Config.{Field, Types}

  @doc "The key `vehicles`."
  @spec field() :: Field.t()
  def field do
    field(
      :vehicles,
      {:list, {:section, fields()}},
      """
      Public names of vehicles. One that is not listed is named after its network and system id.
      """,
      default: [],
      example: "[{id: VID-007, network: main, system_id: 7}]"
    )
  end

  defp fields do
    [
      field(:id, Types.token(), "Public name.", required: true),
      field(:network, Types.token(), "Its network."),
      field(:system_id, {:integer, 1, 4_294_967_295}, "Its MAVLink system id.", required: true)
    ]
  end
end
