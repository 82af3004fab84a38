defmodule Aerie.System.AsyncAPITest do
  @moduledoc """
  Everything that a whole gateway with a simulated vehicle says over NATS is as `docs/asyncapi.json` says, subject and payload: a listener
  hears all of it, state, events, requests, answers, progress and the documents in the buckets.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.Control.Policy.Roles.Signature
  alias Aerie.JsonSchemaCheck

  @moduletag :tmp_dir
  @moduletag :capture_log
  @key {"main", 1}
  @vehicle "VID-001"
  # Only in requests that are to be refused.
  @wrong 77_777
  @document JSON.decode!(File.read!(Path.expand("../../docs/asyncapi.json", __DIR__)))

  test "subjects and payloads of a flight", %{tmp_dir: folder} do
    nkey = Nkey.generate(:user)

    overrides = %{
      "policy" => %{
        "sources" => [%{"name" => "chief", "nkey" => nkey.public, "role" => "admin"}]
      },
      "timeouts" => patient(),
      "remote" => %{"announce_s" => 1},
      "shadow" => %{"dir" => Path.join(folder, "shadow"), "hold_s" => 0.1}
    }

    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: overrides)
    conn = nats_client(gateway)
    listener = nats_client(gateway)
    for subject <- ["fleet.>", "$KV.>"], do: {:ok, _sid} = Gnat.sub(listener, self(), subject)

    options = [files: %{"/notes.txt" => "as found"}, link: "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"]
    start_supervised!({SimVehicle, options ++ fast_vehicle(:ardupilot)})
    await_standing(gateway)
    Aerie.BridgeCase.await_listening(gateway, [@vehicle])

    ask = fn operation, body, schema ->
      subject =
        "fleet.test.#{if operation =~ ~r/^operation/, do: Aerie.Fleet.Bridge.name(gateway), else: @vehicle}.#{operation}"

      body = JSON.encode!(body)
      headers = [{"Aerie-Signature", Signature.sign(nkey, subject, body, DateTime.utc_now())}]

      {:ok, %{body: reply}} =
        Gnat.request(conn, subject, body, headers: headers, receive_timeout: Aerie.Patience.ms())

      reply = JSON.decode!(reply)
      assert {operation, schema, []} == {operation, schema, errors(schema, reply)}
      reply
    end

    plan = %{
      "fileType" => "Plan",
      "version" => 1,
      "mission" => %{
        "version" => 2,
        "items" => [
          %{
            "type" => "SimpleItem",
            "command" => 22,
            "frame" => 3,
            "params" => [0, 0, 0, nil, 0, 0, 20],
            "autoContinue" => true,
            "doJumpId" => 1
          }
        ]
      }
    }

    assert %{"count" => count} = ask.("params.list", %{"id" => "l1"}, "answer.params.list")
    assert count > 100
    assert %{"value" => old} = ask.("params.get", %{"name" => "RTL_ALT"}, "answer.params.get")
    ask.("params.set", %{"id" => "p1", "name" => "RTL_ALT", "value" => old + 1}, "result")
    ask.("params.load", %{"id" => "p2", "values" => %{"RTL_ALT" => old}}, "result")
    ask.("params.metadata", %{}, "result")
    ask.("mission.put", %{"id" => "m1", "plan" => plan}, "result")
    assert %{"items" => _n} = ask.("mission.get", %{"id" => "m2"}, "answer.mission.get")
    ask.("mission.clear", %{"id" => "m3"}, "result")
    assert %{"entries" => [_file | _more]} = ask.("files.list", %{"path" => "/"}, "answer.files.list")
    ask.("files.read", %{"path" => "/notes.txt"}, "answer.files.read")
    ask.("files.crc", %{"path" => "/notes.txt"}, "answer.files.crc")
    ask.("files.write", %{"id" => "f1", "path" => "/new.txt", "data" => Base.encode64("new")}, "result")
    ask.("files.remove", %{"id" => "f2", "path" => "/new.txt"}, "result")
    ask.("logs.list", %{}, "answer.logs.list")

    desired = %{"params" => %{"RTL_ALT" => old}, "tags" => ["north"], "intervals" => %{"ATTITUDE" => 2}}

    ask.(
      "shadow.update",
      %{"desired" => desired, "version" => 0, "reason" => "storm"},
      "answer.shadow.update"
    )

    eventually(
      fn -> match?(%{"tags" => %{state: :converged}}, Aerie.Fleet.Shadow.report(gateway, @vehicle)) end,
      "the shadow has reported"
    )

    assert %{"reported" => %{}} = ask.("shadow.get", %{}, "answer.shadow.get")
    ask.("shadow.delta", %{}, "answer.shadow.delta")
    ask.("shadow.update", %{"desired" => %{"mode" => @wrong}, "version" => 1}, "refused")
    ask.("shadow.delete", %{"version" => 1}, "answer.shadow.delete")

    command = fn type, params ->
      deadline = DateTime.utc_now() |> DateTime.add(120) |> DateTime.to_iso8601()
      ask.("cmd.#{type}", %{"id" => type, "params" => params, "deadline" => deadline}, "result")
    end

    assert %{"result" => "completed"} = command.("set_mode", %{"mode" => "GUIDED"})
    assert %{"result" => "completed"} = command.("arm", %{})
    assert %{"result" => "completed"} = command.("takeoff", %{"altitude" => 10})
    ask.("cmd.goto", %{"id" => "g1", "params" => %{"lat" => @wrong}}, "refusal")
    ask.("cmd.cancel", %{"id" => "nothing"}, "result")

    ask.(
      "operation.begin",
      %{"id" => "op1", "vehicles" => [@vehicle], "command" => %{"type" => "rtl"}},
      "answer.operation"
    )

    eventually(
      fn -> match?({:ok, %{"state" => "done"}}, Aerie.Fleet.Operations.get(gateway, "op1")) end,
      "it is done"
    )

    ask.("operation.get", %{"id" => "op1"}, "answer.operation")
    ask.("operation.list", %{}, "answer.operation.list")
    ask.("operation.readiness", %{"vehicle" => @vehicle}, "answer.operation.readiness")
    ask.("operation.stop", %{"id" => "none"}, "refused")
    eventually(fn -> data(gateway, :mode, @key)[:in_air] == false end, "it has landed")

    # The last that is heard: whatever was published before it is in the mailbox then.
    :ok = Gnat.pub(listener, "fleet.last", "")
    seen = listen([])

    wanted =
      ~w(state.position state.gateway event.armed event.takeoff progress desired reported gateway owner claim command.arm)

    assert wanted -- seen == []
  end

  defp listen(seen) do
    receive do
      {:msg, %{topic: "fleet.last"}} ->
        Enum.uniq(seen)

      {:msg, message} ->
        listen(if(message.body =~ "#{@wrong}", do: seen, else: [described(message) | seen]))
    after
      Aerie.Patience.ms() -> flunk("the listener heard nothing more")
    end
  end

  # The message of the channel that has the subject and its payload.
  defp described(%{topic: topic, body: body} = message) do
    channels =
      for {id, channel} <- @document["channels"],
          address = channel["address"],
          topic =~ matcher(address),
          do: {id, channel}

    assert [{id, channel}] = channels, topic
    headers = Map.new(message[:headers] || [])

    names = Map.keys(channel["messages"])
    # A key that was deleted has no value.
    names = if Map.has_key?(headers, "kv-operation"), do: [], else: names

    fits =
      for name <- names,
          %{"contentType" => type} = @document["components"]["messages"][name],
          value = if(type == "text/plain", do: body, else: JSON.decode!(body)),
          errors(name, value) == [],
          do: name

    assert {id, body, 1} == {id, body, if(names == [], do: 1, else: length(fits))}
    List.first(fits)
  end

  defp errors(name, value),
    do:
      @document
      |> JsonSchemaCheck.component(name)
      |> JsonSchemaCheck.errors(value, @document, closed: name =~ ~r/^(state|event)\./)

  defp matcher(address) do
    pattern =
      Regex.replace(~r/\\\{(\w+)\\\}/, Regex.escape(address), fn _all, name ->
        case @document["components"]["parameters"][name]["enum"] do
          nil -> "[^.]+"
          values -> "(?:#{Enum.map_join(values, "|", &Regex.escape/1)})"
        end
      end)

    Regex.compile!("\\A#{pattern}\\z")
  end
end
