defmodule FleetWeb.API.OpenAPITest do
  use FleetWeb.APICase, async: true

  alias FleetWeb.API.{OpenAPI, Operations, Resources}

  @file_ Path.expand("../../../../../docs/openapi.json", __DIR__)

  test "docs/openapi.json is what the routes say; mix aerie.openapi writes it" do
    text = File.read!(@file_)
    assert text == OpenAPI.text()
    assert JSON.decode!(text) == OpenAPI.document() |> JSON.encode!() |> JSON.decode!()
  end

  test "each action is described, and nothing else" do
    actions = for {_path, _method, action} <- Resources.actions(), uniq: true, do: action
    assert Enum.sort(actions) == Enum.sort(Map.keys(Operations.all()))
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
