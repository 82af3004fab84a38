defmodule Aerie.Api.Rest.RulesTest do
  use Aerie.APICase, async: true

  test "rules are changed, listed beside the configured ones, and reset" do
    %{gateway: gateway, port: port} = start_server(key: true)
    client = %{url: "udpin:127.0.0.1:0", id: "gcs", rate_limits: %{"ATTITUDE" => 4}}
    {:ok, "gcs"} = MavRouter.Client.add(gateway, client)
    assert {200, _, %{"changed" => %{}}} = request(port, "GET", "/api/rules", [admin()])

    change = %{
      "rate_limits" => nil,
      "filter_out" => %{"block_messages" => ["RAW_IMU"]},
      "role" => "read_only"
    }

    expected = %{
      "gcs" => %{
        "rate_limits" => %{"now" => nil, "configured" => %{"ATTITUDE" => 4}},
        "filter_out" => %{"now" => %{"block_messages" => ["RAW_IMU"]}, "configured" => nil},
        "role" => %{"now" => "read_only", "configured" => nil}
      }
    }

    assert {200, _, %{"changed" => ^expected}} = patch(port, "/api/rules/gcs", change)
    assert {200, _, %{"changed" => ^expected}} = request(port, "GET", "/api/rules", [admin()])
    assert {204, _, nil} = request(port, "DELETE", "/api/rules/gcs", [admin()])
    assert {200, _, %{"changed" => changed}} = request(port, "GET", "/api/rules", [admin()])
    assert changed == %{}
    assert {404, _, _} = request(port, "DELETE", "/api/rules/nobody", [admin()])

    assert {404, _, %{"error" => %{"message" => "there is no link and no client nobody"}}} =
             patch(port, "/api/rules/nobody", change)

    assert {422, _, %{"error" => %{"message" => words}}} =
             patch(port, "/api/rules/gcs", %{"rate_limits" => %{"ATITUDE" => 1}})

    assert words =~ "ATITUDE"

    for {names, why} <- [
          {["main", "radio"], ~s(unknown network "radio"; known: main)},
          {[%{}], "names of networks"}
        ] do
      assert {422, _, %{"error" => %{"message" => words}}} =
               patch(port, "/api/rules/gcs", %{"networks" => names})

      assert words =~ why
    end
  end

  defp patch(port, path, object),
    do: request(port, "PATCH", path, [{"content-type", "application/json"}, admin()], JSON.encode!(object))

  defp admin, do: {"x-aerie-key", key()}
end
