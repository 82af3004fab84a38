defmodule Aerie.Vehicle.Enrolment.SecureLinkTest do
  use ExUnit.Case, async: true

  import Aerie.LinkCase

  alias Aerie.Base.{Error, Store}
  alias Aerie.Vehicle.Enrolment.SecureLink

  @key {"main", 1}

  setup do
    gateway = start_parts()
    {"usb", _port} = add_link(gateway, "udpin:127.0.0.1:0", id: "usb", options: [secure: true])
    {"radio", port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    {:ok, gateway: gateway, port: port}
  end

  test "a vehicle is named by its name or its key; the error lists the known ones", %{gateway: gateway} do
    assert SecureLink.key(gateway, @key) == {:ok, @key}

    assert {:error, %Error{reason: {:unknown, :vehicle, "VID-001"}} = error} =
             SecureLink.key(gateway, "VID-001")

    assert Exception.message(error) =~ "no vehicle VID-001 is known; none has been heard yet; name it by"

    :ok = Store.put_vehicle(gateway, @key, %{id: "VID-001", key: @key, groups: %{}})
    assert SecureLink.key(gateway, "VID-001") == {:ok, @key}
    assert {:error, error} = SecureLink.key(gateway, "VID-002")
    assert Exception.message(error) =~ "known are VID-001"
    assert {:error, %{reason: {:invalid, text}}} = SecureLink.key(gateway, :vid)
    assert text =~ "is not a vehicle"
  end

  test "S8: a key goes only over a secure link of the vehicle's network", %{gateway: gateway} do
    # The named link is enough, although the vehicle was not heard there: its frames may be refused.
    assert SecureLink.secure(gateway, @key, "usb") == {:ok, "usb", :all}

    assert {:error, %{reason: {:invalid, "link radio is not marked secure" <> _}}} =
             SecureLink.secure(gateway, @key, "radio")

    assert {:error, %{reason: {:invalid, "link usb belongs to network main, not to field"}}} =
             SecureLink.secure(gateway, {"field", 1}, "usb")

    assert {:error, %{reason: {:unknown, :link, "cable"}}} = SecureLink.secure(gateway, @key, "cable")
  end

  test "S8: without a named link the vehicle must be heard on a secure one", %{gateway: gateway, port: port} do
    assert {:error, error} = SecureLink.secure(gateway, @key, nil)
    assert Exception.message(error) =~ "(it is not heard at all)"
    assert Exception.message(error) =~ "secure are usb"

    {:ok, socket} = :gen_udp.open(0, [:binary])
    :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, heartbeat(1))
    eventually(fn -> MavRouter.Router.route(gateway, @key) end)
    assert {:error, error} = SecureLink.secure(gateway, @key, nil)
    assert Exception.message(error) =~ "(only on radio)"

    :ok = :gen_udp.send(socket, {127, 0, 0, 1}, snapshot(gateway, "usb").port, heartbeat(1))
    assert {:ok, "usb", {:peer, _peer}} = eventually(fn -> heard(SecureLink.secure(gateway, @key, nil)) end)
  end

  defp heard({:ok, _link, _peer} = found), do: found
  defp heard(_error), do: nil
end
