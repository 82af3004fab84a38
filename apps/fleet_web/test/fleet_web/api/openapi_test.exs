defmodule FleetWeb.API.OpenAPITest do
  use FleetWeb.APICase, async: true

  alias FleetWeb.API.{OpenAPI, Parameters, Routes}

  @file_ Path.expand("../../../../../docs/openapi.json", __DIR__)

  test "docs/openapi.json is what the routes say; mix aerie.openapi writes it" do
    text = File.read!(@file_)
    assert text == OpenAPI.text()
    assert JSON.decode!(text) == OpenAPI.document() |> JSON.encode!() |> JSON.decode!()
  end

  test "each route is described, by parameters that have a meaning, and has one row" do
    for route <- Routes.all() do
      assert route.summary =~ ~r/\A[A-Z].*\.\z/
      assert route.query -- Map.keys(Parameters.all()) == []
    end

    rows = for route <- Routes.all(), do: {route.method, route.path}
    assert rows == Enum.uniq(rows)

    assert Routes.all() |> Enum.flat_map(& &1.query) |> Enum.uniq() |> Enum.sort() ==
             Parameters.all() |> Map.keys() |> Enum.sort()
  end

  test "ids of operations differ, references lead somewhere" do
    document = JSON.decode!(File.read!(@file_))
    operations = for {_path, methods} <- document["paths"], {_method, operation} <- methods, do: operation
    ids = Enum.map(operations, & &1["operationId"])
    assert length(ids) > 50 and ids == Enum.uniq(ids)

    for [_all, kind, name] <- Regex.scan(~r/"#\/components\/([a-z]+)\/([a-z0-9]+)"/, OpenAPI.text()),
        do: assert(document["components"][kind][name], "#{kind}/#{name}")
  end

  test "the gateway serves it" do
    %{port: port} = start_server()
    assert {200, _headers, document} = request(port, "GET", "/api/openapi")
    assert document == JSON.decode!(File.read!(@file_))
  end
end
