defmodule Aerie.Api.Rest.OpenAPI do
  @moduledoc """
  `docs/openapi.json` and `GET /api/openapi`: the REST interface as OpenAPI 3.1, made from
  `Aerie.Api.Rest.Routes`. Pure.
  """

  alias Aerie.Base.Json
  alias Aerie.Api.Rest.OpenAPI.{Bodies, Parameters}
  alias Aerie.Api.Rest.Routes
  alias Aerie.Access.HTTP.Error

  # Every answer may be one of these; those of commands only where a vehicle is asked.
  @errors [400, 401, 403, 404, 405, 409, 413, 415, 422, 429, 503]
  @command_errors [410, 421, 502, 504]

  @doc "The description."
  @spec document() :: map()
  def document do
    %{
      openapi: "3.1.0",
      info: %{
        title: "Aerie",
        version: version(),
        description:
          "The REST interface of an Aerie gateway; docs/clients.md, docs/commands.md and docs/transfers.md explain " <>
            "it. The fields of vehicles, events and links are in docs/telemetry.md."
      },
      servers: [%{url: "http://127.0.0.1:4000"}],
      security: [%{key: []}, %{bearer: []}, %{}],
      paths: paths(),
      components: %{
        securitySchemes: %{
          key: %{type: :apiKey, in: :header, name: "X-Aerie-Key"},
          bearer: %{type: :http, scheme: :bearer}
        },
        schemas: Map.merge(Bodies.all(), %{error: error()}),
        responses: Map.new(@errors ++ @command_errors, &{"error#{&1}", response(&1)})
      }
    }
  end

  @doc "The text of `docs/openapi.json`: the same bytes each time, a line for each operation."
  @spec text() :: String.t()
  def text, do: Json.Schema.pretty(document())

  # The version of the release; a checkout has the same.
  defp version, do: :api |> Application.spec(:vsn) |> to_string()

  defp paths do
    Routes.all()
    |> Enum.group_by(& &1.path)
    |> Map.new(fn {path, routes} ->
      {template(path), Map.new(routes, &{String.downcase(&1.method), operation(&1)})}
    end)
  end

  defp template(path), do: path |> String.replace(~r/:([a-z]+)/, "{\\1}") |> String.replace("[...]", "{path}")

  defp operation(%{path: path} = route) do
    %{
      operationId:
        "#{String.downcase(route.method)}#{path |> String.replace(~r/[^a-z]+/, "_") |> String.trim_trailing("_")}",
      summary: route.summary <> for_whom(route.role),
      tags: [path |> String.split("/", trim: true) |> Enum.at(1, "api")],
      parameters: in_path(path) ++ Enum.map(route.query, &in_query/1),
      responses: responses(route)
    }
    |> with_body(route.body)
  end

  defp for_whom(:viewer), do: ""
  defp for_whom(role), do: " For the role #{role}#{if role == :admin, do: "", else: " or a higher one"}."

  defp in_path(path) do
    for [name] <- Regex.scan(~r/\{([a-z]+)\}/, template(path), capture: :all_but_first),
        do: %{name: name, in: :path, required: true, schema: Parameters.in_path(path, name)}
  end

  defp in_query(name) do
    {name, schema, meaning} = Parameters.in_query(name)
    parameter = %{name: name, in: :query, required: false, description: meaning, schema: schema}
    # A list is separated by commas.
    if schema[:type] == :array, do: Map.put(parameter, :explode, false), else: parameter
  end

  defp with_body(operation, nil), do: operation

  defp with_body(operation, {:bytes, types, name}),
    do: Map.put(operation, :requestBody, %{required: true, content: content(types, name)})

  defp with_body(operation, name),
    do:
      Map.put(operation, :requestBody, %{
        required: name != :nothing,
        content: content(["application/json"], name)
      })

  defp content(types, name) do
    Map.new(types, fn
      "application/json" = type -> {type, %{schema: schema(name)}}
      type -> {type, %{schema: %{type: :string}}}
    end)
  end

  defp responses(route) do
    errors =
      if String.starts_with?(route.path, "/api/vehicles/:id/"), do: @errors ++ @command_errors, else: @errors

    done = %{"#{route.status}" => answer(route.answer)}
    later = if route.later, do: %{"202" => answer(:under_way)}, else: %{}

    errors
    |> Map.new(&{"#{&1}", %{"$ref": "#/components/responses/error#{&1}"}})
    |> Map.merge(later)
    |> Map.merge(done)
  end

  defp answer(nil), do: %{description: "Done."}

  defp answer({:bytes, types, name}), do: %{description: "Done.", content: content(types, name)}

  defp answer(schema),
    do: %{description: "Done.", content: %{"application/json" => %{schema: schema(schema)}}}

  defp schema(%{} = schema), do: schema
  defp schema([name]), do: schema(name)
  defp schema(names) when is_list(names), do: %{anyOf: Enum.map(names, &schema/1)}
  defp schema(name), do: %{"$ref": "#/components/schemas/#{name}"}

  defp response(status),
    do: %{description: Error.meaning(status), content: %{"application/json" => %{schema: schema(:error)}}}

  defp error do
    %{
      type: :object,
      required: [:error],
      properties: %{
        error: %{
          type: :object,
          required: [:code, :message],
          properties: %{code: %{type: :string, enum: Error.codes()}, message: %{type: :string}}
        }
      }
    }
  end
end
