defmodule FleetWeb.API.Parameters do
  @moduledoc "The parameters that paths and queries of `/api` may have, for `docs/openapi.json`."

  import Aerie.Base.JsonSchema

  alias Aerie.Fleet.Bridge.Commands.Transfers

  @doc "The names of those in queries; `format` with the forms that a resource has."
  @spec all() :: [atom()]
  def all,
    do: ~w(limit since wait timeout format id unknown force component version tag list crc)a

  @doc "Name, schema and meaning of one in a query."
  @spec in_query(atom() | {:format, [String.t()]}) :: {atom(), map(), String.t()}
  def in_query({:format, values}), do: {:format, %{enum: values}, "The form of the text."}

  def in_query(name) do
    {schema, meaning} = query(name)
    {name, schema, meaning}
  end

  defp query(:limit), do: {Map.put(integer(1, 1000), :default, 100), "How many, the latest ones."}

  defp query(:since),
    do:
      {%{anyOf: [time(), number(0, 253_402_300_799)]},
       "Only those after this time: ISO 8601 with its offset, or unix seconds."}

  defp query(:wait),
    do: {integer(0, 20), "How many seconds to wait for the result; then 202, and the command goes on."}

  defp query(:timeout), do: {integer(1, 3600), "How many seconds the transfer may take."}
  defp query(:id), do: {token(), "Id of the command, for asking for it again."}

  defp query(:unknown),
    do: {%{enum: ~w(skip refuse)}, "What to do with parameters that the vehicle does not have."}

  defp query(:force),
    do:
      {%{type: :boolean, default: false}, "Sends a fence even if the vehicle in flight breaches it at once."}

  defp query(:component),
    do:
      {integer(1, 255),
       "The component whose parameters are meant, such as 100, a camera; without it the autopilot. Not with another format than json."}

  defp query(:version), do: {%{type: :integer, minimum: 0}, "The version that this is meant for."}
  defp query(:tag), do: {%{type: :string}, "Only vehicles with this tag."}
  defp query(:list), do: {%{type: :string}, "Lists a folder."}
  defp query(:crc), do: {%{type: :string}, "Gives the checksum."}

  @doc "The schema of one in a path."
  @spec in_path(path :: String.t(), name :: String.t()) :: map()
  def in_path("/api/vehicles/" <> _rest, "id"), do: token()
  def in_path("/api/vehicles/:id/params/:name", "name"), do: Transfers.Schema.name()
  # Behind a slash.
  def in_path(_path, "path"), do: bytes(238)
  def in_path(_path, "log"), do: integer(0, 0xFFFF)
  def in_path(_path, _name), do: %{type: :string, minLength: 1}
end
