defmodule Aerie.Api.Rest.SigningTest do
  use ExUnit.Case, async: true
  use Aerie.APICase

  alias Aerie.Api.Rest.Operations.Signing
  alias Aerie.Control.Operations.Operation

  defp parse(object), do: Operation.parse(%{Signing.Change.operation() | module: Signing.Change}, object)

  defp words(object) do
    assert {:error, errors} = parse(object)
    Enum.join(errors, "; ")
  end

  test "valid requests" do
    assert parse(%{"action" => "enrol"}) ==
             {:ok, %{action: :enrol, key: :configured, link: nil, component: nil}}

    object = %{"action" => "enrol", "key" => "generate", "link" => "usb", "component" => 2}
    assert parse(object) == {:ok, %{action: :enrol, key: :generate, link: "usb", component: 2}}
    assert {:ok, %{action: :revoke, link: "usb"}} = parse(%{"action" => "revoke", "link" => "usb"})
  end

  test "S9: no key and no file is accepted by HTTP; other errors are named" do
    assert words(%{"action" => "enrol", "key" => "a passphrase"}) =~
             "key: expected one of configured, generate, previous"

    assert words(%{"action" => "enrol", "key_file" => "/etc/shadow"}) ==
             "key_file: expected only action, key, link, component"

    assert words(%{"action" => "enrol", "key" => %{"file" => "x"}}) =~ "key: expected one of"
    assert words(%{}) =~ "action: expected one of enrol, revoke, discard"
    assert words(%{"action" => "enrol", "link" => 5}) =~ "link: expected a text"
    assert words(%{"action" => "enrol", "component" => 0}) =~ "1 to 255"
    {:ok, input} = parse(%{"action" => "revoke", "key" => "generate"})
    assert {:error, {:invalid, "key: only the action enrol has one"}} = Signing.Change.run(input, %{})
  end

  test "the resources list keys by name, refuse to enrol an unknown vehicle, and say if a vehicle has no key" do
    %{gateway: gateway, port: port} = start_server(key: true, links: true)
    admin = {"x-aerie-key", key()}
    assert {200, _, %{"keys" => [], "pending" => []}} = request(port, "GET", "/api/signing", [admin])
    json = [{"content-type", "application/json"}, admin]
    body = JSON.encode!(%{"action" => "enrol"})
    assert {404, _, _} = request(port, "POST", "/api/vehicles/VID-001/signing", json, body)
    put_vehicle(gateway, "VID-001", 1)

    assert {404, _, %{"error" => %{"message" => text}}} =
             request(port, "GET", "/api/vehicles/VID-001/signing", [admin])

    assert text =~ "no key"

    assert {422, _, %{"error" => %{"message" => text}}} =
             request(port, "POST", "/api/vehicles/VID-001/signing", json, body)

    assert text =~ "no signing key is configured"
    body = JSON.encode!(%{"action" => "enrol", "key" => "generate", "link" => "usb"})

    assert {404, _, %{"error" => %{"message" => "there is no link usb"}}} =
             request(port, "POST", "/api/vehicles/VID-001/signing", json, body)

    vehicle = Aerie.Base.Store.vehicle(gateway, "VID-001")

    :ok =
      Aerie.Base.Store.put_vehicle(gateway, vehicle.key, %{
        vehicle
        | groups: %{mode: %{at: 1, data: %{armed: true}}}
      })

    assert {409, _, %{"error" => %{"message" => text}}} =
             request(port, "POST", "/api/vehicles/VID-001/signing", json, body)

    assert text =~ "is armed"
    assert {405, %{"allow" => "GET"}, _} = request(port, "POST", "/api/signing", json, body)
  end
end
