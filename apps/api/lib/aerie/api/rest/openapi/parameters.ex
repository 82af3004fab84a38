defmodule Aerie.Api.Rest.OpenAPI.Parameters do
  @moduledoc "The parameters that paths and queries of `/api` may have, for `docs/openapi.json`."

  import Aerie.Base.Json.Schema

  alias Aerie.Fleet

  @doc "The names of those in queries; `format` with the forms that a resource has."
  @spec all() :: [atom()]
  def all,
    do: ~w(format version tag)a

  @doc "Name, schema and meaning of one in a query."
  @spec in_query(atom() | {:format, [String.t()]} | {atom() | String.t(), map(), String.t()}) ::
          {atom() | String.t(), map(), String.t()}
  def in_query({:format, values}), do: {:format, %{enum: values}, "The form of the text."}

  def in_query({_name, _schema, _meaning} = parameter), do: parameter

  def in_query(name) do
    {schema, meaning} = query(name)
    {name, schema, meaning}
  end

  defp query(:version), do: {%{type: :integer, minimum: 0}, "The version that this is meant for."}
  defp query(:tag), do: {%{type: :string}, "Only vehicles with this tag."}

  @doc "The schema of one in a path."
  @spec in_path(path :: String.t(), name :: String.t()) :: map()
  def in_path("/api/vehicles/" <> _rest, "id"), do: token()
  def in_path("/api/vehicles/:id/params/:name", "name"), do: param_name()
  # Behind a slash.
  def in_path(_path, "path"), do: bytes(238)
  def in_path(_path, "log"), do: integer(0, 0xFFFF)
  def in_path(_path, _name), do: %{type: :string, minLength: 1}

  defp param_name do
    [schema] =
      for %{name: "params.get", fields: fields} <- Fleet.operations(),
          %{key: :name, schema: schema} <- fields,
          do: schema

    schema
  end
end
