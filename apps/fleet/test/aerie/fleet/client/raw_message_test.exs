defmodule Aerie.Fleet.Client.RawMessageTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias Aerie.Fleet.Client.RawMessage
  alias Aerie.Base.Store
  alias Aerie.Control.Policy
  alias MavRouter.Router
  alias Aerie.Control.Policy.Audit
  alias Aerie.Control.Policy.Clients.MavlinkPolicy
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @moduletag capture_log: true
  @patience Aerie.Patience.ms()

  setup %{tmp_dir: dir} do
    {:ok, policy} = Policy.compile(%{})

    gateway =
      start_parts(%{mavlink: %{system_id: 245, component_id: 191}},
        options: [
          policy: MavlinkPolicy,
          tables: [Policy.ControlLease.Holders.table(), Policy.Memory.ClientHistory.table()]
        ]
      )

    start_supervised!({Policy.Store, gateway: gateway, policy: policy})
    start_supervised!({Audit, gateway: gateway, dir: Path.join(dir, "audit"), max_bytes: 1_048_576})
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}, active: true])
    :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, heartbeat(1))
    eventually(fn -> Router.route(gateway, {"main", 1}) end)

    Store.put_vehicle(gateway, {"main", 1}, %Aerie.Vehicle.Snapshot{
      id: "VID-001",
      key: {"main", 1},
      network: "main",
      system_id: 1,
      component: 1,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      groups: %{
        mode: %{at: System.os_time(:microsecond), data: %{mode: "LOITER", armed: false, in_air: false}}
      }
    })

    {:ok, gateway: gateway, socket: socket, port: port, audit: Path.join(dir, "audit")}
  end

  defp user(role, permissions \\ []), do: %{name: "console:ann", role: role, permissions: permissions}
  defp mode, do: %M.SetMode{target_system: 1, custom_mode: 4, base_mode: 1}
  defp send_raw(c, user, message), do: RawMessage.send(c.gateway, user, message, :all, wait_ms: 50)

  test "an operator's message reaches the vehicle, in the gateway's name, and is in the audit log", c do
    assert {:ok, %{outcome: :sent, bytes: bytes}} = send_raw(c, user(:operator), mode())
    socket = c.socket
    assert_receive {:udp, ^socket, _ip, _port, ^bytes}, @patience
    assert <<0xFD, _::4-binary, 245, 190, _::binary>> = bytes
    assert {:ok, %{n: n}} = Audit.status(c.gateway)
    {:ok, page} = Audit.Reader.page(c.audit, %{before: n + 1})
    assert %{"decision" => "allow", "source" => "console:ann", "message" => "SET_MODE"} = hd(page.records)
    # Nothing is left of it.
    assert Enum.filter(Router.endpoints(c.gateway), &(&1.kind == :message)) == []
  end

  test "the answers that come for it are given", c do
    test = self()
    %{socket: socket, port: port} = c
    :gen_udp.controlling_process(socket, spawn_link(fn -> answer(socket, port, test) end))
    send(test, :ready)
    question = %M.ParamRequestRead{target_system: 1, target_component: 1, param_id: "X", param_index: -1}

    # They are waited for a second and a half, in which a busy machine may not get to the answer.
    eventually(fn ->
      assert {:ok, %{outcome: :sent, answers: answers}} =
               RawMessage.send(c.gateway, user(:operator), question, :all)

      match?([%M.CommandAck{command: 7}], for(frame <- answers, do: elem(MavCodec.decode(frame), 1)))
    end)
  end

  defp answer(socket, port, test) do
    receive do
      {:udp, ^socket, _ip, _port, <<0xFD, _::4-binary, 245, 190, _::binary>>} ->
        ack = %M.CommandAck{command: 7, target_system: 245, target_component: 190}
        :gen_udp.send(socket, {127, 0, 0, 1}, port, MavCodec.encode(ack, system: 1, component: 1))
        answer(socket, port, test)

      _other ->
        answer(socket, port, test)
    end
  end

  test "what the role does not include is refused by the policy, with its reason, and not sent", c do
    reboot = %M.CommandLong{target_system: 1, target_component: 1, command: 246, param1: 1.0}
    assert {:ok, %{outcome: :denied, answers: answers}} = send_raw(c, user(:operator), reboot)
    decoded = for frame <- answers, do: elem(MavCodec.decode(frame), 1)
    assert Enum.any?(decoded, &match?(%M.CommandAck{command: 246, result: 2}, &1))
    refute_received {:udp, _socket, _ip, _port, <<0xFD, _::4-binary, 245, 190, _::binary>>}
    assert {:ok, %{outcome: :sent}} = send_raw(c, user(:admin), reboot)
  end

  test "a viewer sends nothing at all; nobody reaches a system that is not there", c do
    assert {:error, "a viewer may not send messages"} = send_raw(c, user(:viewer), %M.Ping{seq: 1})
    far = %M.ParamRequestRead{target_system: 99, param_index: -1}
    assert {:ok, %{outcome: :no_route}} = send_raw(c, user(:operator), far)

    assert {:error, "the gateway does not know" <> _} =
             RawMessage.send(make_ref(), user(:admin), mode(), :all)

    assert {:error, text} = send_raw(c, user(:admin), %M.SetMode{target_system: 999})
    assert text =~ "target_system"
  end
end
