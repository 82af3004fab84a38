defmodule Aerie.Api.Rest.ShadowTest do
  @moduledoc "The shadow over REST, and its metrics; the test is the vehicle's executor."
  use Aerie.APICase, async: true

  import Aerie.CommandCase, only: [start_commands: 2, answer: 3, executing: 1]
  import Aerie.ShadowCase, only: [start_shadow: 3, start_loop: 1, standing: 3]

  @moduletag :tmp_dir
  @moduletag :capture_log

  @keys """
  ops   key-of-the-operator-1 role=operator
  wall  key-of-the-wall-00001 role=viewer
  """
  @path "/api/vehicles/VID-007/shadow"

  setup %{tmp_dir: dir} do
    file = Path.join(dir, "keys")
    File.write!(file, @keys)
    File.chmod!(file, 0o600)
    server = start_server(keys_file: file, key: true)
    start_commands(dir, gateway: server.gateway)
    Aerie.CommandCase.put_vehicle(server.gateway, %{in_air: true})
    # The vehicle is armed: the shadow would stay away for as long.
    start_shadow(server.gateway, dir, [{"shadow.hold_s", 0.1}])
    start_loop(server.gateway)
    server
  end

  defp ask(context, method, path, body \\ nil, key \\ "key-of-the-operator-1") do
    headers = [{"x-aerie-key", key}] ++ if(body, do: [{"content-type", "application/json"}], else: [])

    {status, _headers, body} =
      request(context.port, method, path, headers, if(body, do: JSON.encode!(body), else: ""))

    {status, body}
  end

  test "desired, delta, converged, deleted", context do
    assert {200, %{"version" => 0, "desired" => desired}} = ask(context, "GET", @path)
    assert desired == %{}
    body = %{"desired" => %{"mode" => "LOITER"}, "version" => 0, "reason" => "storm", "token" => "t"}
    assert {200, %{"version" => 1, "token" => "t"}} = ask(context, "PATCH", @path, body)
    from = executing(%{type: "set_mode", source: "shadow", id: id})

    assert {200, %{"delta" => %{"mode" => "LOITER"}, "fields" => %{"mode" => %{"state" => "pending"}}}} =
             delta(context)

    # The vehicle shows it first: a mode that is late would be asked for again.
    Aerie.CommandCase.put_vehicle(context.gateway, %{in_air: true, mode: "LOITER"})
    answer(from, id, :accepted)
    standing(context.gateway, "mode", :converged)

    assert {200, %{"reported" => %{"mode" => "LOITER", "fields" => %{"mode" => %{"state" => "converged"}}}}} =
             ask(context, "GET", @path)

    assert {409, %{"error" => %{"code" => "conflict"}}} = ask(context, "PATCH", @path, body)
    assert {409, _body} = ask(context, "DELETE", @path <> "?version=0")
    assert {200, %{"version" => 2, "desired" => desired}} = ask(context, "DELETE", @path <> "?version=1")
    assert desired == %{}

    metrics =
      for {name, _type, _help, samples} <- Aerie.Api.Metrics.families(context.gateway),
          into: %{},
          do: {name, samples}

    assert metrics["gateway_shadow_commands_issued_total"] == [{[], 1}]
    assert [{[], compared}] = metrics["gateway_shadow_reconciliations_total"]
    assert compared > 0
    assert {[state: "refused"], 0} in metrics["gateway_shadow_fields"]
  end

  defp delta(context) do
    Aerie.Patience.eventually(fn ->
      with {200, %{"fields" => fields}} when fields == %{} <- ask(context, "GET", @path <> "/delta"),
           do: false
    end)
  end

  test "a plan is stored by its hash", context do
    plan = Protocols.Mission.File.QgcPlan.write(%Protocols.Mission.Plan{})
    hash = :sha256 |> :crypto.hash(plan) |> Base.encode16(case: :lower)

    post =
      &request(
        context.port,
        "POST",
        "/api/plans",
        [{"x-aerie-key", &2}, {"content-type", "application/json"}],
        &1
      )

    assert {201, _headers, %{"plan" => ^hash}} = post.(plan, "key-of-the-operator-1")
    assert {:ok, %Protocols.Mission.Plan{}} = Aerie.Fleet.Shadow.Loop.Plans.fetch(context.gateway, hash)
    assert {422, _headers, _why} = post.("{}", "key-of-the-operator-1")
    assert {403, _headers, _why} = post.(plan, "key-of-the-wall-00001")
    heightless = %Protocols.Mission.Plan{items: [%Protocols.Mission.Item{command: 16, frame: 0, z: nil}]}

    assert {422, _headers, why} =
             post.(Protocols.Mission.File.QgcPlan.write(heightless), "key-of-the-operator-1")

    assert inspect(why) =~ "mission: expected a height in item 1 (NAV_WAYPOINT)"
  end

  test "tags are shown with each vehicle, and vehicles found by them", context do
    put_vehicle(context.gateway, "VID-008", 8)
    assert {200, _body} = ask(context, "PATCH", @path, %{"desired" => %{"tags" => ["north", "spare"]}})

    assert {200, %{"vehicles" => [%{"vehicle" => "VID-007", "tags" => ["north", "spare"]}]}} =
             ask(context, "GET", "/api/vehicles?tag=north")

    assert {200, %{"vehicles" => []}} = ask(context, "GET", "/api/vehicles?tag=nor")
    assert {200, %{"vehicles" => [_one, _other]}} = ask(context, "GET", "/api/vehicles")
    assert {200, %{"tags" => []}} = ask(context, "GET", "/api/vehicles/VID-008")
    assert {200, _body} = ask(context, "DELETE", @path)
    assert {200, %{"vehicles" => []}} = ask(context, "GET", "/api/vehicles?tag=north")
  end

  test "each refusal says why", context do
    assert {422, %{"errors" => [%{"key" => "desired.speed"}]}} =
             ask(context, "PATCH", @path, %{"desired" => %{"speed" => 1}})

    assert {403, %{"error" => %{"message" => message}}} =
             ask(context, "PATCH", @path, %{"desired" => %{"params" => %{"A" => 1}}})

    assert message =~ "maintain"

    assert {403, _body} =
             ask(context, "PATCH", @path, %{"desired" => %{"mode" => "RTL"}}, "key-of-the-wall-00001")

    assert {200, _body} = ask(context, "GET", @path, nil, "key-of-the-wall-00001")
    assert {422, _body} = ask(context, "DELETE", @path <> "?version=x")
    assert {422, _body} = ask(context, "GET", "/api/vehicles/a.b/shadow")
  end
end
