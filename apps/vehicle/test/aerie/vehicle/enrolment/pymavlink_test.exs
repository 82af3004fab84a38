defmodule Aerie.Vehicle.Enrolment.PymavlinkTest do
  @moduledoc "The other end of the link is pymavlink, with its own implementation of signing."
  use ExUnit.Case, async: true
  use Aerie.VehicleCase
  import Aerie.SigningCase, except: [start_signing: 1, start_signing: 2]

  import Aerie.PythonPeer, only: [start: 2, await: 2]

  alias Aerie.Base.Store
  alias MavRouter.{Router, Signing}

  @moduletag :python
  @moduletag :tmp_dir
  @moduletag :capture_log

  defp state(gateway), do: Signing.vehicle(gateway, {"main", 7}).state

  # Sessions send heartbeats by themselves, so the line is not the first that comes.
  defp hears(peer, line) do
    unless await(peer, "heard ") == line, do: hears(peer, line)
  end

  test "S1, S2: each verifies what the other signs", c do
    gateway = start_signing(c.tmp_dir)
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    peer = start("signing_peer.py", ["udpout:127.0.0.1:#{port}", "7", "3", passphrase()])
    eventually(fn -> Store.vehicle(gateway, {"main", 7}) end)
    assert state(gateway) == :verified
    :ok = Router.send(gateway, {"main", 7}, heartbeat(237, type: 18, autopilot: 8, component: 191))
    hears(peer, "HEARTBEAT 237 signed")
  end

  test "one that signs with another key is not a vehicle", c do
    gateway = start_signing(c.tmp_dir)
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    start("signing_peer.py", ["udpout:127.0.0.1:#{port}", "7", "3", "another"])
    eventually(fn -> state(gateway) == :rejected end)
    assert Store.vehicle(gateway, {"main", 7}) == nil
    assert Router.route(gateway, {"main", 7}) == nil
  end

  test "it is given its key over a secure link, signs, is heard, and is given another; then none", c do
    gateway = start_signing(c.tmp_dir)
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "usb", options: [secure: true])
    peer = start("signing_peer.py", ["udpout:127.0.0.1:#{port}", "7", "3"])
    eventually(fn -> Store.vehicle(gateway, {"main", 7}) end)
    assert state(gateway) == :unsigned
    patient = [timeout_ms: Aerie.Patience.ms()]

    assert {:ok, %{link: "usb", key: nil}} = Aerie.Vehicle.Enrolment.enrol(gateway, {"main", 7}, patient)
    await(peer, "key taken")
    # A frame that it sent before may come in between.
    eventually(fn -> state(gateway) == :verified end)
    hears(peer, "HEARTBEAT 237 signed")

    # Rotation: the order is signed with the old key, what follows with the new one.
    assert {:ok, %{link: "usb", key: key}} =
             Aerie.Vehicle.Enrolment.enrol(gateway, {"main", 7}, [key: :generate] ++ patient)

    assert %Aerie.Base.Secret{} = key
    await(peer, "key taken")
    hears(peer, "HEARTBEAT 237 signed")
    assert Signing.vehicle(gateway, {"main", 7}).key == "main/7"

    assert {:ok, %{link: "usb"}} = Aerie.Vehicle.Enrolment.revoke(gateway, {"main", 7}, patient)
    await(peer, "key given up")
  end

  test "S8: no key goes over a link that is not marked secure", c do
    gateway = start_signing(c.tmp_dir, policy: :accept_unsigned)
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    peer = start("signing_peer.py", ["udpout:127.0.0.1:#{port}", "7", "3"])
    eventually(fn -> Store.vehicle(gateway, {"main", 7}) end)
    assert {:error, %Aerie.Base.Error{} = error} = Aerie.Vehicle.Enrolment.enrol(gateway, "VID-007")
    assert Exception.message(error) =~ "not heard on a link that is marked secure (only on radio)"

    assert {:error, %{reason: {:invalid, "link radio is not marked secure" <> _}}} =
             Aerie.Vehicle.Enrolment.enrol(gateway, "VID-007", link: "radio")

    assert {:error, %{reason: {:unknown, :link, "usb"}}} =
             Aerie.Vehicle.Enrolment.revoke(gateway, "VID-007", link: "usb")

    assert {:error, %{reason: {:unknown, :vehicle, "VID-009"}}} =
             Aerie.Vehicle.Enrolment.enrol(gateway, "VID-009")

    # Nothing of it went out: what comes next is our heartbeat, or our question for its clock.
    refute await(peer, "heard ") =~ "SETUP_SIGNING"
  end

  test "a vehicle that takes no key: the error says so, and the old key stays in force", c do
    gateway = start_signing(c.tmp_dir)
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "usb", options: [secure: true])
    # It has the right key, and is asked for as another component.
    start("signing_peer.py", ["udpout:127.0.0.1:#{port}", "7", "3", passphrase()])
    eventually(fn -> Store.vehicle(gateway, {"main", 7}) end)
    :ok = Router.forget(gateway, "usb")
    silent = [link: "usb", key: :generate, timeout_ms: 300]
    assert {:error, %Aerie.Base.Error{} = error} = Aerie.Vehicle.Enrolment.enrol(gateway, {"main", 9}, silent)
    assert Exception.message(error) =~ "no frame signed with the new key came on link usb within 300 ms"
    assert Signing.list(gateway).keys |> Enum.map(& &1.key) == ["main/*"]
  end
end
