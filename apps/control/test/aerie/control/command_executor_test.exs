defmodule Aerie.Control.CommandExecutorTest do
  @moduledoc "The process around the executor; the test is the session."
  use ExUnit.Case, async: true

  import Aerie.GatewayCase

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.CommandExecutor
  alias Aerie.Vehicle.Command
  alias Aerie.Control.CommandExecutor.Observed
  alias MavCodec.Messages, as: M

  @key {"main", 7}

  setup do
    gateway = start_gateway()
    Names.register(gateway, :session, @key)
    Store.put_vehicle(gateway, @key, snapshot(%{armed: false}, 1))
    options = %{id: "VID-007", key: @key, own_system: 237, own_component: 191}
    pid = start_supervised!({CommandExecutor, gateway: gateway, options: options})
    %{gateway: gateway, pid: pid}
  end

  # A snapshot at a beat: one heartbeat later.
  defp snapshot(mode, beat) do
    %Aerie.Vehicle.Snapshot{
      id: "VID-007",
      key: @key,
      network: "main",
      system_id: 7,
      component: 1,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      status: :online,
      # A repetition after two seconds: the test that answers may be held up.
      clock: %{rtt_us: 600_000},
      groups: %{mode: %{data: Map.merge(%{mode: "GUIDED", armed: false, in_air: false}, mode)}},
      memory: %{sources: %{0 => beat}, mode_names: %{}}
    }
  end

  defp submit(gateway, fields) do
    {options, fields} = Keyword.split(fields, [:progress, :still?])
    {:ok, command} = Command.new([vehicle: "VID-007"] ++ fields)
    Task.async(fn -> {:ok, CommandExecutor.submit(gateway, @key, command, options)} end)
  end

  defp ack(fields) do
    bytes = MavCodec.encode(struct!(M.CommandAck, fields), system: 7, component: 1)
    {frames, _parser} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, 0)
    {:frames, frames}
  end

  test "listens only while a command is carried out; the acknowledgement and the state are its result",
       context do
    %{gateway: gateway, pid: pid} = context
    task = submit(gateway, type: "arm")
    assert_receive {:listen, ^pid, [:snapshots, 77]}
    assert_receive {:transmit, [%M.CommandLong{command: 400, target_system: 7, target_component: 1}]}
    send(pid, ack(command: 400, result: 0))
    send(pid, {:snapshot, snapshot(%{armed: true}, 2)})

    assert {:ok, %{status: :completed, details: %{"acknowledged" => true}}} =
             Task.await(task, Aerie.Patience.ms())

    assert_receive {:listen, ^pid, nil}
  end

  test "time passes: what is safe is sent again", %{gateway: gateway, pid: pid} do
    task = submit(gateway, type: "set_speed", params: %{speed: 3})
    assert_receive {:transmit, [%M.CommandLong{command: 178, confirmation: 0}]}
    assert_receive {:transmit, [%M.CommandLong{command: 178, confirmation: 1}]}
    send(pid, ack(command: 178, result: 0))
    # A busy machine is heard later, and it is sent once more.
    assert {:ok, %{status: :accepted, details: %{"sent" => sent}}} = Task.await(task, Aerie.Patience.ms())
    assert sent >= 2
  end

  test "sends nothing more once it no longer holds the vehicle: no repetition, no stream", context do
    %{gateway: gateway} = context
    holds = :counters.new(1, [])
    still? = fn -> :counters.get(holds, 1) == 0 end

    task = submit(gateway, id: "l", type: "set_speed", params: %{speed: 3}, still?: still?)
    assert_receive {:transmit, [%M.CommandLong{confirmation: 0}]}
    :counters.put(holds, 1, 1)
    # The answer follows a repetition that was withheld.
    result = Task.await(task, Aerie.Patience.ms())
    assert {:ok, %{status: :unknown, reason: reason}} = result
    assert reason =~ "no more was sent"
    flush()

    :counters.put(holds, 1, 0)
    stream = [type: "rc_override", params: %{channels: [1500], hold: 1}]
    task = submit(gateway, [id: "s", still?: still?] ++ stream)
    assert {:ok, %{status: :accepted}} = Task.await(task, Aerie.Patience.ms())
    assert_receive {:transmit, [%M.RcChannelsOverride{}]}
    assert_receive {:transmit, [%M.RcChannelsOverride{}]}
    :counters.put(holds, 1, 1)
    # What it had asked before.
    _known = :sys.get_state(context.pid)
    flush()
    # Until it ends, and its process waits for nothing more.
    eventually(fn -> CommandExecutor.Core.wake_at(:sys.get_state(context.pid).core) == nil end)
    refute_received {:transmit, _messages}
  end

  # What was sent before.
  defp flush do
    receive do
      {:transmit, _messages} -> flush()
    after
      0 -> :ok
    end
  end

  test "progress goes to the process that asked for it", %{gateway: gateway, pid: pid} do
    task = submit(gateway, id: "g", type: "gripper", params: %{action: "grab"}, progress: self())
    assert_receive {:transmit, [_command]}
    send(pid, ack(command: 211, result: 5, progress: 50))
    assert_receive {:command_progress, "g", %{"progress" => 0.5}}
    assert :ok = CommandExecutor.cancel(gateway, @key, "g")
    assert_receive {:transmit, [%M.CommandCancel{command: 211}]}
    send(pid, ack(command: 211, result: 6))
    assert {:ok, %{status: :cancelled}} = Task.await(task, Aerie.Patience.ms())
    assert {:error, "no command" <> _} = CommandExecutor.cancel(gateway, @key, "g")
  end

  test "an id that is being carried out is refused", %{gateway: gateway, pid: pid} do
    task = submit(gateway, id: "a", type: "arm")
    assert_receive {:transmit, [_command]}

    assert {:ok, %{status: :rejected, reason: "a command with this id" <> _}} =
             Task.await(submit(gateway, id: "a", type: "arm"), Aerie.Patience.ms())

    send(pid, ack(command: 400, result: 2))

    assert {:ok, %{status: :rejected, reason: "the vehicle answered DENIED"}} =
             Task.await(task, Aerie.Patience.ms())
  end

  test "texts and reports of the session are the reason for a refusal", %{gateway: gateway, pid: pid} do
    task = submit(gateway, type: "arm")
    assert_receive {:transmit, [_command]}
    send(pid, {:text, %{severity: 6, text: "no warning"}})
    send(pid, {:reported, %{severity: 2, name: "commander_arm_denied_calibrating"}})
    send(pid, ack(command: 400, result: 1))
    assert {:ok, %{reason: reason}} = Task.await(task, Aerie.Patience.ms())
    assert reason == "the vehicle answered TEMPORARILY_REJECTED; it said: arm denied calibrating"
  end

  test "a reboot, and a crash, leave what was in flight unknown", %{gateway: gateway, pid: pid} do
    task = submit(gateway, type: "set_speed", params: %{speed: 3})
    assert_receive {:transmit, [_command]}
    send(pid, {:rebooted, 100})

    assert {:ok, %{status: :unknown, reason: "the vehicle rebooted" <> _}} =
             Task.await(task, Aerie.Patience.ms())

    task = submit(gateway, type: "arm")
    assert_receive {:transmit, [%M.CommandLong{command: 400}]}
    Process.exit(pid, :kill)

    assert {:ok, %{status: :unknown, reason: "the vehicle's processes" <> _}} =
             Task.await(task, Aerie.Patience.ms())
  end

  test "a vehicle that is lost, or has no process, is sent nothing", %{gateway: gateway} do
    Store.put_vehicle(gateway, @key, %{snapshot(%{}, 1) | status: :lost})

    assert {:ok, %{status: :rejected, reason: "the vehicle is lost"}} =
             gateway |> submit(type: "arm") |> Task.await(Aerie.Patience.ms())

    stop_supervised!(CommandExecutor)
    {:ok, command} = Command.new(vehicle: "VID-007", type: "arm")

    assert %{status: :rejected, reason: "the vehicle is not known"} =
             CommandExecutor.submit(gateway, @key, command)

    refute_received {:transmit, _messages}
  end

  test "the messages say what was heard" do
    assert Observed.changed_groups(%{0 => 1}, %{0 => 2}) |> Enum.sort() == [:in_air, :mode]

    assert Observed.changed_groups(%{0 => 1, 245 => 1}, %{0 => 1, 245 => 2}) |> Enum.sort() == [
             :in_air,
             :vtol
           ]

    assert Observed.changed_groups(%{0 => 1, 245 => 1}, %{0 => 2, 245 => 1}) == [:mode]
    assert Observed.changed_groups(%{0 => 1, 242 => 1}, %{0 => 1, 242 => 1}) == []
    assert %{home: nil, lat: nil, armed: true} = Observed.changes(snapshot(%{armed: true}, 1))
    assert %{system: 7, us: {237, 191}, mode: "GUIDED"} = Observed.vehicle(snapshot(%{}, 1), {237, 191})
  end
end
