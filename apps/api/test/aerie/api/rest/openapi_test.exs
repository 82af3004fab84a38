defmodule Aerie.Api.Rest.OpenAPITest do
  use Aerie.APICase, async: true

  alias Aerie.Api.Rest.{OpenAPI, Routes}
  alias Aerie.Api.Rest.OpenAPI.Parameters
  alias Aerie.Base.Json.Object
  alias Aerie.JsonSchemaCheck
  alias Aerie.Vehicle.Snapshot
  alias Aerie.Vehicle.State.Fields

  @file_ Path.expand("../../../../../../docs/openapi.json", __DIR__)

  test "docs/openapi.json is what the routes say; mix aerie.openapi writes it" do
    text = File.read!(@file_)
    assert text == OpenAPI.text()
    assert JSON.decode!(text) == OpenAPI.document() |> JSON.encode!() |> JSON.decode!()
  end

  test "each route is described, by parameters that have a meaning, and has one row" do
    for route <- Routes.all() do
      assert route.summary =~ ~r/\A[A-Z].*\.\z/
    end

    rows = for route <- Routes.all(), do: {route.method, route.path}
    assert rows == Enum.uniq(rows)

    used =
      for route <- Routes.all(),
          query <- route.query,
          not match?({_name, _schema, _meaning}, query),
          do: with({:format, _forms} <- query, do: :format)

    assert Enum.sort(Enum.uniq(used)) == Enum.sort(Parameters.all())
  end

  test "ids of operations differ, references lead somewhere" do
    document = JSON.decode!(File.read!(@file_))
    operations = for {_path, methods} <- document["paths"], {_method, operation} <- methods, do: operation
    ids = Enum.map(operations, & &1["operationId"])
    assert length(ids) > 50 and ids == Enum.uniq(ids)

    used =
      for [_all, kind, name] <- Regex.scan(~r/"#\/components\/([a-z]+)\/([^"]+)"/, OpenAPI.text()),
          uniq: true,
          do: {kind, name}

    for {kind, name} <- used, do: assert(document["components"][kind][name], "#{kind}/#{name}")

    for kind <- ["schemas", "responses"],
        name <- Map.keys(document["components"][kind]),
        do: assert({kind, name} in used)
  end

  # What a gateway without NATS, policy, tracks, keys and commands has nothing to say of.
  @nothing ~w(/api/tracks /api/policy /api/vehicles/:id/signing /api/vehicles/:id/commands/:command
              /api/recordings/:name)

  @tag :tmp_dir
  test "what is read is described to the last field, and nothing is described that is not there", c do
    %{gateway: gateway, port: port} = start_server(links: true, recorder: %{dir: c.tmp_dir})
    put_vehicle(gateway, "VID-001", 1)
    {:ok, "radio"} = MavRouter.Link.start(gateway, "udpin:127.0.0.1:0", id: "radio")
    document = JSON.decode!(File.read!(@file_))

    for %{method: "GET", action: action, path: path} <- Routes.all(),
        is_atom(action) or not String.contains?(path, ":id"),
        path not in @nothing do
      {200, _headers, answer} = request(port, "GET", String.replace(path, ":id", "VID-001"))

      %{"responses" => %{"200" => %{"content" => %{"application/json" => %{"schema" => schema}}}}} =
        document["paths"][String.replace(path, ":id", "{id}")]["get"]

      assert {path, JsonSchemaCheck.errors(schema, answer, document, closed: true)} == {path, []}
    end
  end

  test "each answer has a schema, and no object in it is one without fields" do
    document = JSON.decode!(File.read!(@file_))

    for {path, methods} <- document["paths"],
        {method, %{"responses" => responses}} <- methods,
        {<<?2, _rest::binary>> = status, %{} = response} <- responses do
      assert {method, path, is_map_key(response, "content")} == {method, path, status != "204"}

      for {"application/json", %{"schema" => schema}} <- response["content"] || %{},
          do: assert({method, path, bare(schema, document, [])} == {method, path, []})
    end
  end

  # The places of objects of which nothing is said.
  defp bare(%{"$ref" => reference}, document, at) do
    if reference in at,
      do: [],
      else: reference |> JsonSchemaCheck.resolve(document) |> bare(document, [reference | at])
  end

  defp bare(%{} = schema, document, at) do
    said =
      Map.take(schema, ["additionalProperties", "propertyNames"]) != %{} or
        schema["properties"] not in [nil, %{}]

    here = if "object" in List.wrap(schema["type"]) and not said, do: [Enum.reverse(at)], else: []

    here ++
      Enum.flat_map(schema, fn
        {"properties", below} -> Enum.flat_map(below, fn {name, one} -> bare(one, document, [name | at]) end)
        {key, below} when key in ["items", "additionalProperties"] -> bare(below, document, [key | at])
        {key, below} when key in ["anyOf", "oneOf", "allOf"] -> Enum.flat_map(below, &bare(&1, document, at))
        _other -> []
      end)
  end

  defp bare(_any, _document, _at), do: []

  test "a field that is declared is in the schemas of REST and NATS, and in docs/telemetry.md" do
    page = File.read!(Path.expand("../telemetry.md", @file_))
    rest = Object.schema(Snapshot.Fields.of(:whole)).properties
    nats = Aerie.Fleet.AsyncAPI.Schemas.all()

    for {group, _title, fields} <- Fields.all(), %{path: [key], meaning: meaning} <- fields do
      assert is_map_key(rest.groups.properties[group].properties.data.properties, key)
      assert is_map_key(nats["state.#{group}"].properties.data.properties, key)
      assert page =~ "| `#{key}` |" and page =~ "| #{meaning} |"
    end

    for {name, _unit, _meaning} <- Object.rows(Snapshot.Fields.of(:whole) ++ MavRouter.Link.fields()),
        do: assert(page =~ "| `#{name}` |")
  end

  test "the gateway serves it" do
    %{port: port} = start_server()
    assert {200, _headers, document} = request(port, "GET", "/api/openapi")
    assert document == JSON.decode!(File.read!(@file_))
  end
end
