defmodule Aerie.Fleet.OperationsTest do
  @moduledoc "Operations on many vehicles through the real pipeline; the test is the executor of the vehicles."
  use Aerie.CommandCase, async: true

  alias Aerie.Base.Names
  alias Aerie.Fleet.Operations
  alias Aerie.Vehicle.Command.Result

  @moduletag :tmp_dir
  @moduletag :capture_log
  @viewer %{name: "guest", role: :viewer, permissions: []}

  setup %{tmp_dir: dir} do
    gateway = start_commands(dir)
    start_supervised!({Operations.Supervisor, gateway: gateway})
    executors = for n <- 11..16, do: executor(gateway, n)
    %{gateway: gateway, executors: executors}
  end

  # A vehicle whose executor does what its id says: odd ones obey, even ones refuse.
  defp executor(gateway, n) do
    key = {"main", n}
    snapshot = Store.vehicle(gateway, "VID-007")
    :ok = Store.put_vehicle(gateway, key, %{snapshot | id: "VID-0#{n}", key: key, system_id: n})
    test = self()

    start_supervised!(
      {Task,
       fn ->
         Names.register(gateway, :commands, key)
         serve(test, rem(n, 2) == 1)
       end},
      id: {:executor, n}
    )
  end

  defp serve(test, obeys?) do
    receive do
      {:"$gen_call", from, {:submit, command, _progress, _still?}} ->
        send(test, {:commanded, command.vehicle, command.type})
        GenServer.reply(from, Result.new(command.id, if(obeys?, do: :completed, else: :rejected), "as it is"))
        serve(test, obeys?)
    end
  end

  defp over(gateway, id) do
    eventually(fn ->
      with {:ok, %{"done_at" => nil}} <- Operations.get(gateway, id), do: false
    end)
    |> elem(1)
  end

  # A command has time to be sent on a busy machine.
  defp begin(gateway, object, source \\ %{name: "ops", role: :operator, permissions: []}) do
    object = Map.merge(%{"command" => %{"type" => "rtl"}, "timeout_s" => 300}, object)
    Operations.begin(gateway, object, source)
  end

  test "a command for several vehicles, with what became of each", %{gateway: gateway} do
    ids = ["VID-011", "VID-012", "VID-013", "VID-404"]
    assert {:ok, %{"id" => id, "state" => "running"}} = begin(gateway, %{"vehicles" => ids})
    done = over(gateway, id)
    assert done["counts"] == %{"waiting" => 0, "under_way" => 0, "ok" => 2, "failed" => 2}
    assert done["state"] == "done"
    assert %{"state" => "ok", "result" => "completed"} = done["vehicles"]["VID-011"]

    assert %{"state" => "failed", "result" => "rejected", "reason" => "as it is"} =
             done["vehicles"]["VID-012"]

    assert %{"state" => "failed", "reason" => "there is no vehicle VID-404"} = done["vehicles"]["VID-404"]
    assert [%{"id" => ^id} = listed] = Operations.list(gateway)
    refute is_map_key(listed, "vehicles")
  end

  test "the same operation again commands nobody twice; the id of another one is refused", %{gateway: gateway} do
    object = %{"id" => "roll-1", "vehicles" => ["VID-011"]}
    assert {:ok, _begun} = begin(gateway, object)
    assert_receive {:commanded, "VID-011", "rtl"}
    over(gateway, "roll-1")
    assert {:ok, %{"state" => "done"}} = begin(gateway, object)
    assert {:error, {:conflict, _why}} = begin(gateway, %{object | "vehicles" => ["VID-013"]})
    refute_received {:commanded, _vehicle, _type}
  end

  test "it halts when too many failed, and the rest is left alone", %{gateway: gateway} do
    ids = ["VID-012", "VID-011", "VID-013", "VID-015"]
    assert {:ok, %{"id" => id}} = begin(gateway, %{"vehicles" => ids, "step" => 2, "halt_ratio" => 0.4})
    halted = over(gateway, id)
    assert halted["state"] == "halted"
    assert %{"VID-013" => %{"state" => "waiting"}, "VID-015" => %{"state" => "waiting"}} = halted["vehicles"]
    refute_received {:commanded, "VID-013", _type}
  end

  test "a stop ends it in a pause; a viewer begins and stops nothing", %{gateway: gateway} do
    object = %{"id" => "slow", "vehicles" => ["VID-011", "VID-013"], "step" => 1, "pause_s" => 3600}
    assert {:error, {:role, _why}} = begin(gateway, object, @viewer)
    assert {:ok, _begun} = begin(gateway, object)

    eventually(fn ->
      match?({:ok, %{"counts" => %{"ok" => 1, "waiting" => 1}}}, Operations.get(gateway, "slow"))
    end)

    assert {:error, {:role, _why}} = Operations.stop(gateway, "slow", @viewer)
    assert {:ok, %{"state" => "stopped", "done_at" => at}} = Operations.stop(gateway, "slow")
    assert is_binary(at)
    assert {:ok, %{"state" => "stopped"}} = Operations.stop(gateway, "slow")
    assert {:error, {:unknown, _why}} = Operations.stop(gateway, "none")
  end

  test "a tag that no vehicle has begins nothing", %{gateway: gateway} do
    assert {:error, {:malformed, [%{key: "tag"}]}} = begin(gateway, %{"tag" => "nobody"})
    assert Operations.list(gateway) == []
  end

  test "policy and permissions hold for each vehicle", %{gateway: gateway} do
    assert {:ok, %{"id" => id}} =
             begin(gateway, %{"vehicles" => ["VID-011"], "command" => %{"type" => "reboot"}})

    assert %{"vehicles" => %{"VID-011" => %{"result" => "denied", "reason" => why}}} = over(gateway, id)
    assert why =~ "maintain"
  end

  test "killed, it tells what it does not know; not more than eight run at once", %{gateway: gateway} do
    slow = &%{"id" => "slow-#{&1}", "vehicles" => ["VID-011", "VID-013"], "step" => 1, "pause_s" => 3600}
    for n <- 1..8, do: assert({:ok, _begun} = begin(gateway, slow.(n)))
    assert {:error, {:busy, _why}} = begin(gateway, slow.(9))
    old = Names.whereis(gateway, :operations)
    Process.exit(old, :kill)
    eventually(fn -> Names.whereis(gateway, :operations) not in [nil, old] end)
    eventually(fn -> match?({:ok, %{"state" => "interrupted"}}, Operations.get(gateway, "slow-1")) end)
    assert {:ok, _begun} = begin(gateway, slow.(9))
  end
end
