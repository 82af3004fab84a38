defmodule Aerie.Fleet.Shadow.OperationsTest do
  @moduledoc "The shadow by requests to a real nats-server."
  use Aerie.ShadowCase, async: true

  alias Aerie.Control.Policy.Roles.Signature

  @moduletag :tmp_dir
  @moduletag :capture_log

  setup %{tmp_dir: dir} = context do
    gateway = start_bridge(config(dir))
    key = Nkey.generate(:user)
    policy = [sources: [%{name: "ops", nkey: key.public}]] ++ (context[:policy] || [])
    start_commands(dir, gateway: gateway, policy: policy)
    conn = Aerie.HubServer.local_client(await_up(gateway))
    start_shadow(gateway, dir, [{"nats.mode", "embedded"}, {"shadow.lease_s", 1}])
    start_loop(gateway)
    eventually(fn -> Documents.authority(gateway, "VID-007") == :mine end)
    %{gateway: gateway, conn: conn, key: key}
  end

  defp subject(action, vehicle \\ "VID-007"), do: "fleet.test.#{vehicle}.shadow.#{action}"

  # Requests that overtake the gateway's subscription are asked again.
  defp ask(context, action, body \\ "", options \\ []) do
    body = if is_binary(body), do: body, else: JSON.encode!(body)
    subject = subject(action, options[:vehicle] || "VID-007")

    eventually(fn ->
      case Gnat.request(context.conn, subject, body,
             headers: options[:headers] || signature(options, subject, body),
             receive_timeout: Aerie.Patience.ms()
           ) do
        {:ok, %{body: reply}} -> JSON.decode!(reply)
        {:error, _not_yet} -> false
      end
    end)
  end

  defp signature(options, subject, body),
    do:
      if(options[:key],
        do: [{"Aerie-Signature", Signature.sign(options[:key], subject, body, DateTime.utc_now())}],
        else: []
      )

  test "get, update with a version and a signature, delta, delete", context do
    assert %{"result" => "ok", "version" => 0} = ask(context, "get")

    update = %{
      "desired" => %{"tags" => ["a"], "armed" => false},
      "version" => 0,
      "token" => "t",
      "reason" => "survey"
    }

    assert %{"result" => "refused", "rule" => "signature"} = ask(context, "update", update)

    assert %{"result" => "ok", "version" => 1, "token" => "t"} =
             ask(context, "update", update, key: context.key)

    standing(context.gateway, "armed", :refused)

    assert %{
             "result" => "ok",
             "delta" => %{"armed" => false},
             "fields" => %{"armed" => %{"state" => "refused"}}
           } =
             eventually(fn ->
               with %{"fields" => fields} when fields == %{} <- ask(context, "delta"), do: false
             end)

    assert %{
             "desired" => %{"tags" => ["a"]},
             "set" => %{"tags" => %{"actor" => "ops", "via" => "nats", "reason" => "survey"}}
           } =
             ask(context, "get")

    assert %{"rule" => "conflict"} = ask(context, "update", update, key: context.key)

    assert %{"result" => "ok", "version" => 2, "desired" => desired} =
             ask(context, "delete", %{"version" => 1}, key: context.key)

    assert desired == %{}
  end

  test "a signed change that is sent again changes nothing", context do
    body = JSON.encode!(%{"desired" => %{"tags" => ["a"]}, "version" => 0})
    header = Signature.sign(context.key, subject("update"), body, DateTime.utc_now())
    signed = [headers: [{"Aerie-Signature", header}]]
    assert %{"version" => 1} = ask(context, "update", body, signed)
    assert %{"rule" => "conflict"} = ask(context, "update", body, signed)
    # Nor for another vehicle.
    assert %{"rule" => "signature"} = ask(context, "update", body, [vehicle: "VID-008"] ++ signed)

    assert %{"rule" => "malformed", "reason" => "version: a signed change" <> _} =
             ask(context, "update", %{"desired" => %{"tags" => ["b"]}}, key: context.key)
  end

  test "bad requests, and a flood of them", context do
    assert %{"rule" => "malformed"} = ask(context, "dance")
    assert %{"rule" => "malformed"} = ask(context, "get", "[")
    assert %{"rule" => "size"} = ask(context, "get", String.duplicate(" ", 70_000))

    assert %{"rule" => "malformed", "reason" => reason} =
             ask(context, "update", %{"desired" => %{"speed" => 1}, "version" => 0}, key: context.key)

    assert reason =~ "desired.speed"

    assert %{"rule" => "role"} =
             ask(context, "update", %{"desired" => %{"params" => %{"A" => 1}}, "version" => 0},
               key: context.key
             )

    for n <- 1..3_000, do: Gnat.pub(context.conn, subject("update"), "junk #{n}")

    assert %{"result" => "ok", "version" => 0} =
             eventually(fn -> with %{"rule" => "busy"} <- ask(context, "get"), do: false end)

    assert Process.alive?(documents(context.gateway))
  end

  @tag policy: [unsigned: :operator]
  test "policy.unsigned: every publisher has that role", context do
    assert %{"result" => "ok", "version" => 1} = ask(context, "update", %{"desired" => %{"tags" => ["a"]}})
    assert %{"rule" => "role"} = ask(context, "update", %{"desired" => %{"signing" => true}})
    # A vehicle that is not heard here: a companion will read it.
    assert %{"result" => "ok", "version" => 1} =
             ask(context, "update", %{"desired" => %{"mode" => "RTL"}}, vehicle: "VID-099")

    assert %{"desired" => %{"mode" => "RTL"}, "reported" => nil} = ask(context, "get", "", vehicle: "VID-099")
  end
end
