defmodule Aerie.Fleet.Operations.RequestsTest do
  @moduledoc "Operations by a real nats-server: who may begin one, and what is wrong with a request."
  use Aerie.BridgeCase, async: true

  import Aerie.CommandCase

  alias Aerie.Control.Policy.Roles.Signature
  alias Aerie.Fleet.Operations

  @moduletag :tmp_dir
  @moduletag :capture_log

  setup %{tmp_dir: dir} do
    gateway = start_bridge(config(dir))
    key = Nkey.generate(:user)
    start_commands(dir, gateway: gateway, policy: [sources: [%{name: "ops", nkey: key.public}]])
    start_supervised!({Operations.Supervisor, gateway: gateway})
    conn = client(await_up(gateway))
    c = %{gateway: gateway, conn: conn, key: key}
    # It listens a moment after the connection is there.
    Aerie.Patience.eventually(fn ->
      match?({:ok, _reply}, Gnat.request(conn, subject(c, "list"), "", receive_timeout: 200))
    end)

    c
  end

  defp subject(c, action), do: "fleet.test.#{Bridge.name(c.gateway)}.operation.#{action}"

  defp ask(c, action, body, signed? \\ false) do
    body = if is_binary(body), do: body, else: JSON.encode!(body)
    subject = subject(c, action)

    headers =
      if signed?,
        do: [{"Aerie-Signature", Signature.sign(c.key, subject, body, DateTime.utc_now())}],
        else: []

    {:ok, %{body: reply}} =
      Gnat.request(c.conn, subject, body, headers: headers, receive_timeout: Aerie.Patience.ms())

    JSON.decode!(reply)
  end

  @operation %{"id" => "roll-1", "vehicles" => ["VID-404"], "command" => %{"type" => "rtl"}, "timeout_s" => 5}

  test "a signed one is begun, listed and read; a copy is the same one; it can be stopped", c do
    assert %{"result" => "ok", "id" => "roll-1"} = ask(c, "begin", @operation, true)
    assert %{"result" => "ok", "id" => "roll-1"} = ask(c, "begin", @operation, true)
    assert %{"operations" => [%{"id" => "roll-1"}]} = ask(c, "list", "")

    done =
      Aerie.Patience.eventually(fn ->
        with %{"state" => "running"} <- ask(c, "get", %{"id" => "roll-1"}), do: false
      end)

    assert %{"vehicles" => %{"VID-404" => %{"state" => "failed", "reason" => "there is no vehicle VID-404"}}} =
             done

    assert %{"result" => _ok_or_over} = ask(c, "stop", %{"id" => "roll-1"}, true)
  end

  test "without a signature nobody begins or stops one, but everybody may read", c do
    for action <- ["begin", "pause", "continue", "stop", "abort", "abort_all"] do
      assert %{"result" => "refused", "rule" => "signature"} = ask(c, action, @operation)
    end

    assert %{"result" => "ok", "operations" => []} = ask(c, "list", "")
    assert %{"rule" => rule} = ask(c, "get", %{"id" => "none"})
    assert rule != nil
  end

  test "what is wrong with a request is said", c do
    assert %{"rule" => "malformed", "reason" => "id: an operation over NATS has one" <> _} =
             ask(c, "begin", Map.delete(@operation, "id"), true)

    assert %{"rule" => "malformed", "reason" => "the body is not a JSON object"} = ask(c, "list", "[1]")

    assert %{"rule" => "malformed", "reason" => "id: expected the id of an operation" <> _} =
             ask(c, "get", %{"id" => 7})

    assert %{"rule" => "malformed", "reason" => "the last word" <> _} = ask(c, "destroy", "{}")

    assert %{"rule" => "size"} =
             ask(c, "list", String.duplicate(" ", Aerie.Fleet.Operations.Request.max_bytes() + 1))
  end
end
