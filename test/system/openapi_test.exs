defmodule Aerie.System.OpenAPITest do
  @moduledoc "REST does what `docs/openapi.json` says, asked by schemathesis: every operation, with right and with wrong requests."

  use Aerie.SystemCase, async: true
  use Aerie.PeerCase

  @moduletag :tmp_dir
  @moduletag :capture_log
  @moduletag Aerie.PeerCase.long(:schemathesis)
  @key "a-key-for-schemathesis"

  test "every answer is one that the description has", %{tmp_dir: folder} do
    %{gateway: gateway} =
      start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: %{"api" => %{"key" => @key}})

    port = Aerie.Api.Endpoint.port(gateway)
    file = Path.join(folder, "openapi.json")
    File.write!(file, Aerie.Api.Rest.OpenAPI.text())

    peer =
      start_program("schemathesis", [
        "run",
        file,
        "--url=http://127.0.0.1:#{port}",
        "--header=X-Aerie-Key: #{@key}",
        # Every status that is not described fails: 500 above all. Methods that nobody has are not asked for: Cowboy itself
        # answers TRACE with 501.
        "--checks=status_code_conformance,content_type_conformance,response_schema_conformance",
        "--phases=examples,coverage,fuzzing",
        "--max-examples=15",
        "--seed=1",
        # How fast it makes up requests is the machine's matter.
        "--suppress-health-check=all",
        "--warnings=off",
        "--no-color",
        # A transfer from a vehicle that is not there must not wait for an hour.
        "--request-timeout=60"
      ])

    findings(peer)
    # Whatever was asked, the gateway is as it was.
    eventually(fn -> match?({true, _report}, Aerie.Fleet.Health.ready(gateway)) end, "it is ready")
  end
end
