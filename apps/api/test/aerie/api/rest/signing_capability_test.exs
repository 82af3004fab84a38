defmodule Aerie.Api.Rest.SigningCapabilityTest do
  @moduledoc "`GET /api/signing/capability`: who can sign, who does, and by which links a key can be given."
  use Aerie.APICase, async: true

  alias Aerie.Base.Store
  alias Aerie.LinkCase

  @moduletag :tmp_dir
  @path "/api/signing/capability"

  defp ask(port) do
    assert {200, _headers, body} = request(port, "GET", @path)
    body
  end

  test "without a key and without a secure link: what vehicles could do, and that nothing is signed" do
    %{gateway: gateway, port: port} = start_server(links: true)

    assert ask(port) == %{
             "gateway" => %{
               "mavlink_version" => 2,
               "can_sign" => true,
               "signs" => false,
               "keys" => 0,
               "not_stored" => nil,
               "secure_links" => []
             },
             "vehicles" => []
           }

    for {system, more, can_sign} <- [
          {1, %{mavlink_version: 2}, true},
          {2, %{mavlink_version: 1}, false},
          # ArduPilot and PX4 may begin with version 1: they say that they can do version 2.
          {3, %{mavlink_version: 1, capabilities: 8192 + 15}, true},
          {4, %{mavlink_version: 1, capabilities: 15}, false},
          {5, %{}, nil}
        ] do
      put_vehicle(gateway, "VID-00#{system}", system)
      change(gateway, system, more)
      shown = Enum.find(ask(port)["vehicles"], &(&1["system_id"] == system))

      assert shown == %{
               "id" => "VID-00#{system}",
               "network" => "main",
               "system_id" => system,
               "via" => nil,
               "mavlink_version" => more[:mavlink_version],
               "can_sign" => can_sign,
               "signing" => nil,
               "pending" => false,
               "secure_links" => []
             }
    end
  end

  test "with a key and a secure link: the state, the links, and nothing of the key", %{tmp_dir: dir} do
    passphrase = "nobody-may-see-this-passphrase"
    file = Path.join(dir, "main.key")
    File.write!(file, passphrase)
    File.chmod!(file, 0o600)

    config = %{
      signing: %{keys: [%{network: "main", system_id: 1, key_file: file}], dir: Path.join(dir, "signing")}
    }

    %{gateway: gateway, port: port} = start_server(links: true, config: config)
    LinkCase.add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    {"usb", usb} = LinkCase.add_link(gateway, "udpin:127.0.0.1:0", id: "usb", options: [secure: true])
    put_vehicle(gateway, "VID-001", 1)
    put_vehicle(gateway, "VID-002", 2)

    assert %{"gateway" => own, "vehicles" => [one, two]} = ask(port)
    assert %{"signs" => true, "keys" => 1} = own
    assert [%{"id" => "usb", "network" => "main", "status" => status}] = own["secure_links"]
    assert is_binary(status)
    assert %{"policy" => "required", "key" => "main/1", "state" => "unknown"} = one["signing"]
    assert %{"signing" => nil} = two
    assert [%{"id" => "usb", "heard" => false}] = one["secure_links"]

    # Heard there: `enrol` finds the link by itself.
    {:ok, socket} = :gen_udp.open(0, [:binary])
    :ok = :gen_udp.send(socket, {127, 0, 0, 1}, usb, LinkCase.heartbeat(1))

    eventually(fn ->
      match?([%{"id" => "usb", "heard" => true}], hd(ask(port)["vehicles"])["secure_links"])
    end)

    body = answer(port, ["GET ", @path, " HTTP/1.1\r\nhost: 127.0.0.1\r\nconnection: close\r\n\r\n"])
    key = MavCodec.Signing.key(passphrase)

    for secret <- [passphrase, key, Base.encode16(key), Base.encode16(key, case: :lower), Base.encode64(key)],
        do: refute(String.contains?(body, secret))

    refute body =~ file
  end

  test "a vehicle that another gateway hears is that one's to sign" do
    %{gateway: gateway, port: port} = start_server(links: true)
    LinkCase.add_link(gateway, "udpin:127.0.0.1:0", id: "usb", options: [secure: true])
    put_vehicle(gateway, "VID-001", 1)
    change(gateway, 1, %{via: "aboard"})
    assert [%{"via" => "aboard", "signing" => nil, "secure_links" => []}] = ask(port)["vehicles"]
  end

  test "nothing is changed here" do
    %{port: port} = start_server(links: true)

    for method <- ~w(POST PUT DELETE),
        do: assert({405, %{"allow" => "GET"}, _error} = request(port, method, @path))
  end

  defp change(gateway, system, more) do
    key = {"main", system}
    Store.put_vehicle(gateway, key, Map.merge(Store.vehicle(gateway, key), more))
  end
end
