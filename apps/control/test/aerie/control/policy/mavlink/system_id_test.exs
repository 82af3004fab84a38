defmodule Aerie.Control.Policy.Mavlink.SystemIdTest do
  @moduledoc "A vehicle gets another system id by a parameter: it is another one then, and both are named."
  use Aerie.TransferCase, async: true

  alias Aerie.Base.PubSub
  alias Aerie.Control.Params
  alias Aerie.Control.Policy.Mavlink.SystemId
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @moduletag :capture_log

  # An ArduPilot: it answers a PARAM_SET with its new id; `deaf` to it, it has the new one without an answer.
  defp vehicle(port, system, name) do
    spawn_link(fn ->
      {:ok, socket} = :gen_udp.open(0, [:binary, active: true])
      :timer.send_interval(100, :beat)
      loop(%{socket: socket, port: port, system: system, name: name})
    end)
  end

  defp loop(v) do
    receive do
      :beat ->
        say(v, %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, system_status: 3, mavlink_version: 3})
        loop(v)

      {:become, system} ->
        loop(%{v | system: system})

      {:udp, _socket, _address, _port, bytes} ->
        {frames, _parser} = MavCodec.Parser.push(MavCodec.Parser.new(), bytes)
        frames |> Enum.reduce(v, &hear/2) |> loop()
    end
  end

  defp hear(frame, %{system: system, name: name} = v) do
    case MavCodec.decode(frame) do
      {:ok, %M.ParamRequestRead{target_system: ^system, param_id: ^name}} ->
        say(v, value(v))
        v

      {:ok, %M.ParamSet{target_system: ^system, param_id: ^name} = set} ->
        v = %{v | system: trunc(set.param_value)}
        say(v, value(v))
        v

      _other ->
        v
    end
  end

  defp value(v),
    do: %M.ParamValue{
      param_id: v.name,
      param_value: v.system * 1.0,
      param_type: 4,
      param_count: 1,
      param_index: 0
    }

  defp say(v, message),
    do:
      :gen_udp.send(
        v.socket,
        {127, 0, 0, 1},
        v.port,
        MavCodec.encode(message, system: v.system, component: 1)
      )

  defp online(gateway, id), do: eventually(fn -> match?(%{status: :online}, Store.vehicle(gateway, id)) end)

  for name <- ~w(SYSID_THISMAV MAV_SYSID) do
    test "#{name}: the set is completed under the new id, and an event at both says which is which", %{
      tmp_dir: dir
    } do
      {gateway, port} = start(dir)
      vehicle(port, 7, unquote(name))
      online(gateway, "VID-007")
      :ok = PubSub.subscribe(gateway, :events)
      assert {:ok, %Result{status: :completed} = result} = Params.set(gateway, "VID-007", unquote(name), 9)
      assert result.details["vehicle_now"] == "VID-009"
      assert result.details["remarks"] == ["the vehicle has the new system id, and is VID-009 now"]

      for id <- ["VID-007", "VID-009"] do
        assert_receive {:fleet, :events, %{type: "system_id.changed", vehicle: ^id, data: data}}
        assert %{"from" => "VID-007", "to" => "VID-009", "system" => 9} = data
      end
    end
  end

  test "what is set beside it is set before it", %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    vehicle(port, 7, "SYSID_THISMAV")
    online(gateway, "VID-007")

    # Sorted, the other one would come last, and be asked of a vehicle that is gone; this one does not have it.
    task = Task.async(fn -> Params.set_all(gateway, "VID-007", %{"SYSID_THISMAV" => 9, "TUNE" => 1}) end)
    assert {:ok, %Result{status: :timeout}} = Task.await(task, Aerie.Patience.ms())
    assert %{status: :online} = Store.vehicle(gateway, "VID-007")
    assert {:ok, %Result{status: :completed}} = Params.set_all(gateway, "VID-007", %{"SYSID_THISMAV" => 9})
  end

  test "a vehicle that is restarted with its new id is named as well; another one's id is nobody's new one",
       %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    first = vehicle(port, 7, "MAV_SYS_ID")
    vehicle(port, 8, "MAV_SYS_ID")
    for id <- ["VID-007", "VID-008"], do: online(gateway, id)
    :ok = PubSub.subscribe(gateway, :events)
    follow = &SystemId.follow(gateway, Store.vehicle(gateway, "VID-007"), &1)

    for params <- [[{"MAV_SYS_ID", 8}], [{"MAV_SYS_ID", 7}], [{"MAV_SYS_ID", 300}], [{"OTHER", 9}]],
        do: follow.(params)

    assert Task.Supervisor.children(Aerie.Base.Names.whereis(gateway, :command_tasks)) == []
    # As a client's message that was let through.
    set = %M.ParamSet{target_system: 7, param_id: "MAV_SYS_ID", param_value: 9.0, param_type: 6}
    :ok = SystemId.sent(gateway, Store.vehicle(gateway, "VID-007"), set)
    send(first, {:become, 9})
    assert_receive {:fleet, :events, %{type: "system_id.changed", vehicle: "VID-009"}}
  end
end
