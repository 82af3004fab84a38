defmodule Aerie.Api.Rest.CommandsTest do
  @moduledoc "Commands over REST; the test is the vehicle's executor."
  use Aerie.APICase, async: true

  import Aerie.CommandCase, only: [start_commands: 2, answer: 3, executing: 1, refute_submitted: 0]

  alias Aerie.Control.Policy.Roles.Signature

  @moduletag :tmp_dir
  @moduletag :capture_log

  @keys """
  ops   key-of-the-operator-1 role=operator
  chief key-of-the-chief-0001 role=admin permissions=force_disarm
  wall  key-of-the-wall-00001 role=viewer
  """
  @path "/api/vehicles/VID-007/commands"

  setup %{tmp_dir: dir} = context do
    file = Path.join(dir, "keys")
    File.write!(file, @keys)
    File.chmod!(file, 0o600)
    server = start_server(if(context[:keys] == false, do: [], else: [keys_file: file, key: true]))
    rates = [%{types: ["gripper"], per_minute: 1, burst: 1}]
    nkey = Nkey.generate(:user)
    sources = [%{name: "signer", nkey: nkey.public, role: :operator}]
    start_commands(dir, gateway: server.gateway, policy: [max_altitude: 100, rates: rates, sources: sources])
    :ok = Aerie.Fleet.Bridge.note_environment(server.gateway, "test")
    Map.put(server, :nkey, nkey)
  end

  defp ask(context, method, path, body \\ nil, key \\ "key-of-the-operator-1") do
    headers = [{"x-aerie-key", key}] ++ if(body, do: [{"content-type", "application/json"}], else: [])

    Task.async(fn ->
      request(context.port, method, path, headers, if(body, do: JSON.encode!(body), else: ""))
    end)
  end

  defp reply(task) do
    {status, _headers, body} = Task.await(task, Aerie.Patience.ms())
    {status, body}
  end

  test "a command and its result, again and by its id", context do
    body = %{"type" => "takeoff", "id" => "t1", "params" => %{"altitude" => 20}}
    task = ask(context, "POST", @path, body)
    answer(executing(%{id: "t1", source: "ops"}), "t1", :completed)

    assert {200, headers, %{"id" => "t1", "result" => "completed", "reason" => nil}} =
             Task.await(task, Aerie.Patience.ms())

    assert headers["location"] == @path <> "/t1"
    assert {200, %{"result" => "completed"}} = context |> ask("POST", @path, body) |> reply()

    assert {200, %{"state" => "done", "result" => "completed"}} =
             context |> ask("GET", @path <> "/t1") |> reply()

    assert {404, _body} = context |> ask("GET", "/api/vehicles/VID-008/commands/t1") |> reply()
    assert {404, _body} = context |> ask("GET", @path <> "/t2") |> reply()
  end

  test "not waiting, progress, cancelling", context do
    task = ask(context, "POST", @path <> "?wait=0", %{"type" => "takeoff", "params" => %{"altitude" => 20}})
    assert {202, %{"id" => id, "state" => "under_way"}} = reply(task)
    assert_receive {:"$gen_call", from, {:submit, %{id: ^id}, desk, _still?}}
    send(desk, {:command_progress, id, %{"progress" => 0.5, "text" => nil}})

    assert {200, %{"state" => "under_way", "progress" => %{"progress" => 0.5}, "type" => "takeoff"}} =
             context |> ask("GET", @path <> "/" <> id) |> reply()

    assert {403, _body} =
             context |> ask("DELETE", @path <> "/" <> id, nil, "key-of-the-wall-00001") |> reply()

    cancel = ask(context, "DELETE", @path <> "/" <> id)
    assert_receive {:"$gen_call", canceller, {:cancel, ^id}}
    GenServer.reply(canceller, :ok)
    assert {202, %{"state" => "cancelling"}} = reply(cancel)
    answer(from, id, :cancelled)

    eventually(fn ->
      match?({200, %{"result" => "cancelled"}}, context |> ask("GET", @path <> "/" <> id) |> reply())
    end)

    assert {404, _body} = context |> ask("DELETE", @path <> "/" <> id) |> reply()
  end

  test "each refusal has its status, and its result beside the error", context do
    post = fn body, key -> context |> ask("POST", @path, body, key) |> reply() end
    ops = "key-of-the-operator-1"
    high = %{"type" => "takeoff", "params" => %{"altitude" => 150}}
    past = System.os_time(:second) - 1

    assert {403, %{"result" => "denied", "rule" => "altitude", "error" => %{"code" => "forbidden"}}} =
             post.(high, ops)

    assert {403, %{"rule" => "role"}} = post.(%{"type" => "reboot"}, ops)
    assert {403, %{"rule" => "role"}} = post.(%{"type" => "force_disarm"}, key())

    assert {403, %{"error" => %{"message" => "the key wall may only read" <> _}}} =
             post.(high, "key-of-the-wall-00001")

    assert {401, _body} = post.(high, "no-such-key-here-0000")

    assert {422, %{"rule" => "malformed", "errors" => [%{"key" => "type"}]}} =
             post.(%{"type" => "dance"}, ops)

    assert {422, %{"errors" => [%{"key" => "params.altitude", "got" => "5000"}]}} =
             post.(put_in(high["params"]["altitude"], 5000), ops)

    assert {422, _body} = post.(Map.put(high, "vehicle", "VID-008"), ops)
    assert {410, %{"result" => "expired"}} = post.(%{"type" => "arm", "deadline" => past}, ops)

    assert {404, %{"rule" => "vehicle"}} =
             context |> ask("POST", "/api/vehicles/VID-009/commands", %{"type" => "arm"}) |> reply()

    # Left out, the gateway makes an id; null is an error.
    assert {422, %{"errors" => [%{"key" => "id", "got" => "nothing"}]}} =
             post.(%{"type" => "arm", "id" => nil}, ops)

    assert {422, %{"errors" => [%{"key" => "wait", "expected" => "an integer from 0 to 20"}]}} =
             context |> ask("POST", @path <> "?wait=600", %{"type" => "arm"}) |> reply()

    grip = %{"type" => "gripper", "id" => "g", "params" => %{"action" => "grab"}}
    task = ask(context, "POST", @path, grip)
    answer(executing(%{id: "g"}), "g", :accepted)
    assert {200, %{"result" => "accepted"}} = reply(task)
    assert {429, %{"rule" => "rate"}} = post.(%{grip | "id" => "g2"}, ops)
    assert {409, %{"rule" => "id"}} = post.(%{"type" => "land", "id" => "g"}, ops)

    for {status, code} <- [failed: 502, timeout: 504, unknown: 504, rejected: 422, cancelled: 409] do
      id = "r-#{status}"
      task = ask(context, "POST", @path, %{"type" => "land", "id" => id})
      answer(executing(%{id: ^id}), id, status)
      result = Atom.to_string(status)
      assert {^code, %{"result" => ^result}} = reply(task)
    end
  end

  test "permissions by name, and a key without a role is an admin", context do
    task = ask(context, "POST", @path, %{"type" => "force_disarm", "id" => "f"}, "key-of-the-chief-0001")
    answer(executing(%{id: "f", source: "chief"}), "f", :completed)
    assert {200, %{"result" => "completed"}} = reply(task)
    task = ask(context, "POST", @path, %{"type" => "save_params", "id" => "s"}, key())
    answer(executing(%{id: "s", source: "api.key"}), "s", :accepted)
    assert {200, %{"result" => "accepted"}} = reply(task)
  end

  test "what a key may give to a vehicle, and why not the rest", context do
    path = @path

    lacks = fn key ->
      {200, %{"commands" => commands}} = context |> ask("GET", path, nil, key) |> reply()
      Map.new(commands, &{&1["type"], {&1["lacks"], &1["permission"]}})
    end

    assert %{"takeoff" => {nil, nil}, "force_disarm" => {nil, nil}} = lacks.("key-of-the-chief-0001")
    assert %{"takeoff" => {nil, nil}, "force_disarm" => {"permission", "force_disarm"}} = lacks.(key())

    vehicle = Aerie.Base.Store.vehicle(context.gateway, "VID-007")
    Aerie.Base.Store.put_vehicle(context.gateway, vehicle.key, %{vehicle | autopilot: :betaflight})

    assert %{"goto" => {"firmware", nil}, "arm" => {"permission", "receiver"}, "disarm" => {nil, nil}} =
             lacks.(key())

    assert {404, _unknown} = context |> ask("GET", "/api/vehicles/NOBODY/commands", nil, key()) |> reply()
  end

  test "the table of commands, and the metrics", context do
    assert {200, %{"types" => types}} = context |> ask("GET", "/api/commands/types") |> reply()

    assert %{"permission" => "fly", "params" => [%{"name" => "altitude", "unit" => "m"} | _]} =
             Enum.find(types, &(&1["name"] == "takeoff"))

    task = ask(context, "POST", @path, %{"type" => "land", "id" => "l"})
    answer(executing(%{id: "l"}), "l", :completed)
    assert {200, _result} = reply(task)

    text =
      context.gateway
      |> Aerie.Api.Metrics.families()
      |> Aerie.Api.Metrics.Text.render()
      |> IO.iodata_to_binary()

    assert text =~ ~s(gateway_commands_received_total{type="land"} 1)
    assert text =~ ~s(gateway_commands_executed_total{type="land",result="completed"} 1)
    assert text =~ "# TYPE gateway_command_latency_seconds histogram"
    assert text =~ ~s(gateway_command_latency_seconds_count{type="land"} 1)
    assert text =~ ~s(gateway_command_latency_seconds_bucket{type="land",le="+Inf"} 1)
    refute text =~ ~s(name="commands.)
  end

  describe "signed commands" do
    @describetag :signed

    defp sign(context, body, more \\ []) do
      text = JSON.encode!(body)
      subject = "fleet.test.VID-007.cmd.#{body["type"]}"
      time = Keyword.get(more, :time, DateTime.utc_now())
      header = Signature.sign(context.nkey, Keyword.get(more, :subject, subject), text, time)
      key = Keyword.get(more, :key, "key-of-the-operator-1")
      headers = [{"x-aerie-key", key}, {"content-type", "application/json"}, {"aerie-signature", header}]
      Task.async(fn -> request(context.port, "POST", @path, headers, Keyword.get(more, :body, text)) end)
    end

    test "the signer is the sender, by Ed25519 as over NATS; a copy is not carried out again", context do
      body = %{"type" => "takeoff", "id" => "s1", "params" => %{"altitude" => 20}}
      task = sign(context, body)
      answer(executing(%{id: "s1", source: "signer"}), "s1", :completed)
      assert {200, %{"result" => "completed"}} = reply(task)
      # A copy within the minute: the stored result.
      assert {200, %{"result" => "completed"}} = context |> sign(body) |> reply()
      refute_submitted()
      # The signer is an operator, whoever's key let it in.
      chief = "key-of-the-chief-0001"

      assert {403, %{"rule" => "role"}} =
               context |> sign(%{"type" => "reboot", "id" => "s2"}, key: chief) |> reply()
    end

    test "what is old, changed, of another vehicle, without an id or by another key is refused", context do
      arm = %{"type" => "arm", "id" => "s3"}
      old = DateTime.add(DateTime.utc_now(), -61)

      for more <- [
            [time: old],
            [body: ~s({"type": "arm", "id": "s4"})],
            [subject: "fleet.test.VID-008.cmd.arm"],
            [subject: "fleet.other.VID-007.cmd.arm"]
          ],
          do: assert({403, %{"rule" => "signature"}} = context |> sign(arm, more) |> reply())

      assert {403, %{"rule" => "signature", "error" => %{"message" => "a signed command needs an id"}}} =
               context |> sign(%{"type" => "arm"}) |> reply()

      other = %{context | nkey: Nkey.generate(:user)}
      assert {403, %{"error" => %{"message" => message}}} = other |> sign(arm) |> reply()
      assert message =~ "is not one of policy.sources"
      refute_submitted()
    end
  end

  @tag keys: false
  test "without a key nobody commands, from this machine neither", context do
    headers = [{"content-type", "application/json"}]

    assert {403, _headers, %{"rule" => "role"}} =
             request(context.port, "POST", @path, headers, ~s({"type": "land"}))
  end
end
