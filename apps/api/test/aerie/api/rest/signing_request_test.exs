defmodule Aerie.Api.Rest.SigningRequestTest do
  use ExUnit.Case, async: true
  use Aerie.APICase

  alias Aerie.Api.Rest.SigningRequest

  defp words(object) do
    assert {:error, %{status: 422, message: words}} = SigningRequest.parse(object)
    words
  end

  test "valid requests" do
    assert SigningRequest.parse(%{"action" => "enrol"}) == {:ok, :enrol, []}

    assert SigningRequest.parse(%{
             "action" => "enrol",
             "key" => "generate",
             "link" => "usb",
             "component" => 2
           }) ==
             {:ok, :enrol, [key: :generate, link: "usb", component: 2]}

    assert SigningRequest.parse(%{"action" => "revoke", "link" => "usb"}) == {:ok, :revoke, [link: "usb"]}
  end

  test "S9: no key and no file is accepted by HTTP; other errors are named" do
    assert words(%{"action" => "enrol", "key" => "a passphrase"}) =~
             "key must be one of configured, generate, previous"

    assert words(%{"action" => "enrol", "key_file" => "/etc/shadow"}) =~ "is an unknown key"
    assert words(%{"action" => "enrol", "key" => %{"file" => "x"}}) =~ "key must be one of"
    assert words(%{}) =~ "action must be one of discard, enrol, revoke"
    assert words(%{"action" => "revoke", "key" => "generate"}) =~ "the action enrol"
    assert words(%{"action" => "enrol", "link" => 5}) =~ "id of a link"
    assert words(%{"action" => "enrol", "component" => 0}) =~ "1 to 255"
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
