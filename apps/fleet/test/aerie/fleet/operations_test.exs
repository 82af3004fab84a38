defmodule Aerie.Fleet.OperationsTest do
  @moduledoc "Operations on many vehicles through the real pipeline; the test is the executor of the vehicles."
  use Aerie.CommandCase, async: true

  alias Aerie.Base.Names
  alias Aerie.Base.Names.Book
  alias Aerie.Control.Commands
  alias Aerie.Control.Policy.{Audit, Intent}
  alias Aerie.Control.Policy.Memory.RecentCommands
  alias Aerie.Fleet.Operations
  alias Aerie.Fleet.Operations.Readiness
  alias Aerie.Fleet.Operations.Sequence.GivingWay
  alias Aerie.Vehicle.Command.Result

  @moduletag :tmp_dir
  @moduletag :capture_log
  @viewer %{name: "guest", role: :viewer, permissions: []}
  @operator %{name: "ops", role: :operator, permissions: []}
  @other %{name: "other", role: :operator, permissions: []}

  setup %{tmp_dir: dir} do
    gateway = start_commands(dir)
    start_supervised!({Operations.Supervisor, gateway: gateway, dir: Path.join(dir, "operations")})
    executors = for n <- 11..16, do: executor(gateway, n)
    %{gateway: gateway, executors: executors, kept: Path.join(dir, "operations")}
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
  defp begin(gateway, object, source \\ @operator) do
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

    assert {:error, {:role, _why}} = Operations.change(gateway, "slow", :stop, @viewer)
    assert {:ok, %{"state" => "stopped", "done_at" => at}} = Operations.change(gateway, "slow", :stop)
    assert is_binary(at)
    assert {:ok, %{"state" => "stopped"}} = Operations.change(gateway, "slow", :stop)
    assert {:error, {:unknown, _why}} = Operations.change(gateway, "none", :stop)
  end

  test "a wait that the heights of its own steps make impossible begins nothing", %{gateway: gateway} do
    up = %{"type" => "takeoff", "params" => %{"altitude" => 10}}
    sequence = [%{"vehicle" => "V-1", "steps" => [up, %{"wait" => "above", "m" => 20}]}]

    assert {:error, {:malformed, [%{key: "sequence[0].steps[1].m"}]}} =
             Operations.begin(gateway, %{"sequence" => sequence})
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
    slow =
      &%{
        "id" => "slow-#{&1}",
        "vehicles" => ["VID-011", "VID-013"],
        "step" => 1,
        "pause_s" => 3600,
        "command" => %{"type" => "disarm"}
      }

    for n <- 1..8, do: assert({:ok, _begun} = begin(gateway, slow.(n)))
    assert {:error, {:busy, _why}} = begin(gateway, slow.(9))
    # What ends a flight does not wait for them.
    assert {:ok, _begun} = begin(gateway, %{"vehicles" => ["VID-011"]})
    old = Names.whereis(gateway, :operations)
    Process.exit(old, :kill)
    eventually(fn -> Names.whereis(gateway, :operations) not in [nil, old] end)
    eventually(fn -> match?({:ok, %{"state" => "interrupted"}}, Operations.get(gateway, "slow-1")) end)
    assert {:ok, _begun} = begin(gateway, slow.(9))
  end

  # --- Sequences, pauses, aborts, restarts

  # What the vehicles say from now on.
  defp vehicle(gateway, n, mode, position \\ %{}) do
    snapshot = Store.vehicle(gateway, {"main", n})
    now = System.os_time(:microsecond)
    mode = %{data: Map.merge(snapshot.groups[:mode].data, mode), at: now}
    position = %{data: Map.merge((snapshot.groups[:position] || %{data: %{}}).data, position), at: now}
    groups = Map.merge(snapshot.groups, %{mode: mode, position: position})
    :ok = Store.put_vehicle(gateway, {"main", n}, %{snapshot | status: :online, groups: groups})
  end

  defp one(n, steps), do: %{"vehicle" => "VID-0#{n}", "steps" => steps, "anyway" => true}

  defp up(n),
    do: one(n, [%{"type" => "arm"}, %{"type" => "takeoff", "params" => %{"altitude" => 10 + n}}, above()])

  defp above, do: %{"wait" => "above", "m" => 5, "timeout_s" => 300}

  defp sequence(gateway, vehicles, more \\ %{}, source \\ @operator) do
    object =
      Map.merge(%{"id" => "up", "name" => "Take off", "sequence" => vehicles, "timeout_s" => 300}, more)

    Operations.begin(gateway, object, source)
  end

  # Each of them at a home of its own.
  defp grounded(gateway, ns) do
    for n <- ns do
      place = %{lat: 47.0 + n / 1000, lon: 8.0, alt_msl: 400.0}
      vehicle(gateway, n, %{armed: false, in_air: false}, Map.put(place, :alt_rel, 0.0))
      home(gateway, n, place)
    end
  end

  defp home(gateway, n, place) do
    snapshot = Store.vehicle(gateway, {"main", n})
    home = %{data: place, at: System.os_time(:microsecond)}
    :ok = Store.put_vehicle(gateway, {"main", n}, put_in(snapshot.groups[:home], home))
  end

  defp state(gateway, id \\ "up"), do: gateway |> Operations.get(id) |> elem(1)
  defp await(gateway, id \\ "up", fun), do: eventually(fn -> fun.(state(gateway, id)) end)

  test "each vehicle has its own steps, and begins when the one before is up", %{gateway: gateway} do
    grounded(gateway, [11, 13])
    assert {:ok, %{"order" => ["VID-013", "VID-011"]}} = sequence(gateway, [up(13), up(11)])
    assert_receive {:commanded, "VID-013", "arm"}, Aerie.Patience.ms()
    assert_receive {:commanded, "VID-013", "takeoff"}, Aerie.Patience.ms()
    await(gateway, &(&1["vehicles"]["VID-013"]["step"] == "wait_above"))
    assert %{"state" => "waiting"} = state(gateway)["vehicles"]["VID-011"]
    refute_received {:commanded, "VID-011", _type}
    # It is told when the vehicle changes, and no more once it is up.
    eventually(fn -> match?([_wait], told(gateway, 13)) end)
    vehicle(gateway, 13, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    eventually(fn -> told(gateway, 13) == [] end)
    assert_receive {:commanded, "VID-011", "arm"}, Aerie.Patience.ms()
    vehicle(gateway, 11, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    assert %{"state" => "done", "counts" => %{"ok" => 2}} = over(gateway, "up")
  end

  test "one that fails leaves the rest on the ground; continued, the next is not armed beside one that stands armed",
       c do
    grounded(c.gateway, [11, 12, 13])
    assert {:ok, _begun} = sequence(c.gateway, [up(12), up(11), up(13)])
    halted = over(c.gateway, "up")
    assert %{"state" => "halted", "counts" => %{"waiting" => 2, "failed" => 1}} = halted
    assert halted["vehicles"]["VID-012"]["reason"] == "arm: as it is"
    # It armed after all, and stands there.
    vehicle(c.gateway, 12, %{armed: true})
    assert {:ok, %{"state" => "running"}} = Operations.change(c.gateway, "up", :continue, @operator)
    await(c.gateway, &(&1["vehicles"]["VID-011"]["step"] == "wait_alone"))
    refute_received {:commanded, "VID-011", "arm"}
    vehicle(c.gateway, 12, %{armed: false})
    assert_receive {:commanded, "VID-011", "arm"}, Aerie.Patience.ms()
  end

  test "a take-off is refused as a whole when one flies, another stands near, or somebody else is in charge",
       c do
    grounded(c.gateway, [11, 13, 15])
    vehicle(c.gateway, 13, %{in_air: true})
    assert {:error, {:conflict, why}} = sequence(c.gateway, [up(11), up(15), up(11)])
    assert why =~ "VID-011 is in the sequence twice"
    assert {:error, {:conflict, why}} = sequence(c.gateway, [up(11), up(15)], %{"step" => 2})
    assert why =~ "step is 2, but of vehicles that arm or take off one begins at a time"
    assert {:error, {:conflict, why}} = sequence(c.gateway, [up(11), up(13), one(99, [%{"type" => "arm"}])])
    assert why == "nothing was begun: VID-013 is in the air; VID-099 is not known"
    # As after a start of the gateway beside vehicles that fly.
    vehicle(c.gateway, 13, %{in_air: nil, armed: true})
    assert {:error, {:conflict, why}} = sequence(c.gateway, [up(11), up(13)])
    assert why == "nothing was begun: VID-013 is not known to be on the ground"
    vehicle(c.gateway, 13, %{in_air: false, armed: false}, %{lat: 47.011 + 2.0 / 111_000})
    assert {:error, {:conflict, why}} = sequence(c.gateway, [up(11), up(13)])
    assert why =~ ~r/VID-011 and VID-013 stand 2\.\d m apart, nearer than 3\.0 m/

    assert {:ok, _in_charge} =
             Commands.submit(c.gateway, vehicle: "VID-015", type: "take_control", as: @other)

    assert {:error, {:conflict, why}} = sequence(c.gateway, [up(11), up(15)])
    assert why =~ "VID-015 is in the charge of other"
    # Two may stand as near as the request says, and a vehicle is part of one sequence.
    assert {:ok, _begun} = sequence(c.gateway, [up(11), up(13)], %{"radius_m" => 0.5})
    assert {:error, {:conflict, why}} = sequence(c.gateway, [up(13)], %{"id" => "other"})
    assert why =~ "VID-013 is part of the operation up, which runs"
    refute_received {:commanded, "VID-013", _type}
  end

  test "a take-off is refused when one is not ready, unless that is said of it, or when one changed since it was shown",
       c do
    grounded(c.gateway, [11, 13])
    ready = &Atom.to_string(Readiness.of(c.gateway, &1, "ops").state)
    refute ready.("VID-011") in ["ready", "check"]
    assert {:error, {:conflict, why}} = sequence(c.gateway, [Map.delete(up(11), "anyway"), up(13)])
    assert why =~ ~r/begun: VID-011 is not (ready|known to be ready): /
    refute why =~ "VID-013"
    shown = %{"VID-011" => "ready", "VID-013" => ready.("VID-013"), "VID-404" => "ready"}
    assert {:error, {:conflict, why}} = sequence(c.gateway, [up(11), up(13)], %{"shown" => shown})
    assert why == "nothing was begun: VID-011 is #{ready.("VID-011")} now, not ready"
    hold = %{"vehicles" => ["VID-011"], "shown" => %{"VID-011" => "ready"}}
    assert {:error, {:conflict, ^why}} = begin(c.gateway, hold)
    refute_received {:commanded, _vehicle, _type}

    assert {:ok, _begun} =
             sequence(c.gateway, [up(11), up(13)], %{"shown" => %{shown | "VID-011" => ready.("VID-011")}})
  end

  test "paused by one operator, another may stop but not continue it; what is under way comes to its end",
       c do
    grounded(c.gateway, [11, 13])
    assert {:ok, _begun} = sequence(c.gateway, [up(11), up(13)])
    assert {:ok, %{"state" => "paused"}} = Operations.change(c.gateway, "up", :pause, @operator)
    vehicle(c.gateway, 11, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    await(c.gateway, &(&1["counts"]["ok"] == 1))

    assert {:error, {:role, "ops has paused it" <> _more}} =
             Operations.change(c.gateway, "up", :continue, @other)

    assert {:error, {:role, _viewer}} = Operations.change(c.gateway, "up", :continue, @viewer)
    assert {:ok, %{"state" => "running"}} = Operations.change(c.gateway, "up", :continue, @operator)
    assert_receive {:commanded, "VID-013", "arm"}, Aerie.Patience.ms()
    assert {:ok, %{"state" => "stopped"}} = Operations.change(c.gateway, "up", :stop, @other)

    assert {:error, {:conflict, "the operation up is stopped: it cannot continue"}} =
             Operations.change(c.gateway, "up", :continue, @operator)
  end

  test "aborted by another operator, its next steps do not come, and those that had begun return", c do
    grounded(c.gateway, [11, 13, 15])
    assert {:ok, _begun} = sequence(c.gateway, [up(11), up(13), up(15)])
    assert_receive {:commanded, "VID-011", "takeoff"}, Aerie.Patience.ms()
    vehicle(c.gateway, 11, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    assert_receive {:commanded, "VID-013", "takeoff"}, Aerie.Patience.ms()
    # It climbs already, and the page does not see it yet.
    vehicle(c.gateway, 13, %{armed: true})

    assert {:ok, %{"state" => "stopped", "then" => back}} =
             Operations.change(c.gateway, "up", {:abort, "rtl"}, @other)

    assert_receive {:commanded, "VID-011", "rtl"}, Aerie.Patience.ms()
    assert_receive {:commanded, "VID-013", "disarm"}, Aerie.Patience.ms()
    refute_received {:commanded, "VID-015", _type}
    assert %{"state" => "done", "source" => "other", "counts" => %{"ok" => 2}} = over(c.gateway, back)
    assert {:ok, %{"then" => ^back}} = Operations.change(c.gateway, "up", {:abort, "rtl"}, @operator)
  end

  test "with on_halt, those that have begun return by themselves, and be it the last that fails", c do
    grounded(c.gateway, [11, 12])
    assert {:ok, _begun} = sequence(c.gateway, [up(11), up(12)], %{"on_halt" => "return"})
    assert_receive {:commanded, "VID-011", "takeoff"}, Aerie.Patience.ms()
    vehicle(c.gateway, 11, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    await(c.gateway, &(&1["state"] == "done" and &1["then"] != nil))
    assert_receive {:commanded, "VID-011", "rtl"}, Aerie.Patience.ms()
  end

  # A command by hand; odd vehicles obey.
  defp by_hand(gateway, n, type, source \\ @other) do
    assert {:ok, %{status: :completed}} =
             Commands.submit(gateway, vehicle: "VID-0#{n}", type: type, params: %{}, as: source)

    assert_receive {:commanded, _vehicle, ^type}, Aerie.Patience.ms()
  end

  defp home_after(n, other),
    do: one(n, [%{"wait" => "landed", "of" => "VID-0#{other}", "timeout_s" => 300}, %{"type" => "rtl"}])

  test "one that somebody commands while it waits is left alone, and the others return by the halt ratio",
       c do
    for n <- [11, 13, 15], do: vehicle(c.gateway, n, %{armed: true, in_air: true})
    turns = [home_after(13, 11), one(11, [%{"type" => "rtl"}]), home_after(15, 11)]
    # The same person by hand, and before: that was so when it began.
    by_hand(c.gateway, 15, "hold", @operator)
    assert {:ok, _begun} = sequence(c.gateway, turns, %{"step" => 3, "halt_ratio" => 1})
    assert_receive {:commanded, "VID-011", "rtl"}, Aerie.Patience.ms()
    await(c.gateway, &(&1["vehicles"]["VID-013"]["step"] == "wait_turn"))
    by_hand(c.gateway, 13, "hold")
    # What moves nothing is no reason.
    assert {:ok, _in_charge} =
             Commands.submit(c.gateway, vehicle: "VID-015", type: "take_control", as: @operator)

    vehicle(c.gateway, 11, %{armed: false, in_air: false})
    assert_receive {:commanded, "VID-015", "rtl"}, Aerie.Patience.ms()
    vehicle(c.gateway, 13, %{armed: true})
    done = over(c.gateway, "up")
    assert %{"state" => "done", "counts" => %{"ok" => 2, "failed" => 1}} = done
    assert %{"result" => "rejected", "reason" => why} = done["vehicles"]["VID-013"]
    assert why =~ ~r/^it was given hold by other at \d\d:\d\d:\d\d UTC; this operation left it alone$/
    refute_received {:commanded, "VID-013", "rtl"}
  end

  test "one on its way to land at a place lands there; not after a hold, a pilot's mode, or when it is heard no more",
       c do
    there = {47.0005, 8.1}
    goto = %{"type" => "goto", "params" => %{"lat" => 47.0005, "lon" => 8.1, "altitude" => 20}}
    near = %{"wait" => "near", "lat" => 47.0005, "lon" => 8.1, "m" => 3}
    landing = &one(&1, [goto, Map.put(near, "timeout_s", &2), %{"type" => "land"}])
    away = %{lat: 47.0, lon: 8.1, alt_rel: 20.0}
    for n <- [11, 13, 15], do: vehicle(c.gateway, n, %{armed: true, in_air: true, mode: "GUIDED"}, away)

    assert {:ok, _begun} =
             sequence(c.gateway, [landing.(11, 300), landing.(13, 300), landing.(15, 300)], %{
               "step" => 3,
               "halt_ratio" => 1
             })

    for n <- [11, 13, 15], do: await(c.gateway, &(&1["vehicles"]["VID-0#{n}"]["step"] == "wait_near"))
    by_hand(c.gateway, 13, "hold")
    vehicle(c.gateway, 13, %{}, place(there))
    vehicle(c.gateway, 15, %{mode: "STABILIZE"}, place(there))
    still(c.gateway, 11)
    vehicle(c.gateway, 11, %{}, place(there))
    assert_receive {:commanded, "VID-011", "land"}, Aerie.Patience.ms()
    assert %{"counts" => %{"ok" => 1, "failed" => 2}, "vehicles" => vehicles} = over(c.gateway, "up")
    assert vehicles["VID-013"]["reason"] =~ "given hold by other"

    assert %{"result" => "rejected", "reason" => "its mode was changed to STABILIZE on the way"} =
             vehicles["VID-015"]

    gone = landing.(11, 1) |> Map.put("steps", [Map.put(near, "timeout_s", 1), %{"type" => "land"}])
    Store.delete_vehicle(c.gateway, {"main", 11})
    assert {:ok, _begun} = sequence(c.gateway, [gone], %{"id" => "gone"})

    assert %{"VID-011" => %{"result" => "timeout", "reason" => "nobody hears it after 1 s"}} =
             over(c.gateway, "gone")["vehicles"]

    refute_received {:commanded, _vehicle, "land"}
  end

  defp place({lat, lon}), do: %{lat: lat, lon: lon}

  defp still(gateway, n) do
    snapshot = Store.vehicle(gateway, {"main", n})

    groups =
      Map.put(snapshot.groups, :velocity, %{data: %{groundspeed: 0.1}, at: System.os_time(:microsecond)})

    :ok = Store.put_vehicle(gateway, {"main", n}, %{snapshot | groups: groups})
  end

  test "one that has not begun is left alone, with its `else`; on_halt returns the others only", c do
    grounded(c.gateway, [11, 13, 15])
    spare = Map.put(up(15), "else", [%{"type" => "arm"}])
    assert {:ok, _begun} = sequence(c.gateway, [up(11), up(13), spare], %{"on_halt" => "return"})
    assert_receive {:commanded, "VID-011", "takeoff"}, Aerie.Patience.ms()
    vehicle(c.gateway, 11, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    assert_receive {:commanded, "VID-013", "takeoff"}, Aerie.Patience.ms()
    # By its own author.
    by_hand(c.gateway, 15, "disarm", @operator)
    by_hand(c.gateway, 11, "land")
    vehicle(c.gateway, 13, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    await(c.gateway, &(&1["state"] == "done" and &1["then"] != nil))
    assert_receive {:commanded, "VID-013", "rtl"}, Aerie.Patience.ms()
    last = state(c.gateway)
    assert last["vehicles"]["VID-015"]["reason"] =~ "it was given disarm by ops"
    assert %{"order" => ["VID-013"]} = over(c.gateway, last["then"])
    refute_received {:commanded, "VID-015", _type}
    refute_received {:commanded, "VID-011", "rtl"}
  end

  test "a command for many leaves alone what was commanded before its turn; a hold for many does not mind a goto",
       c do
    for n <- [11, 13], do: vehicle(c.gateway, n, %{armed: true, in_air: true})
    slow = %{"id" => "slow", "vehicles" => ["VID-011", "VID-013"], "step" => 1, "pause_s" => 3600}

    for {id, command, by_hand, result} <- [
          {"high", %{"type" => "set_altitude", "params" => %{"altitude" => 20}}, "mission_start", "failed"},
          {"hold", %{"type" => "hold"}, "mission_start", "ok"},
          {"home", %{"type" => "rtl"}, "hold", "failed"}
        ] do
      assert {:ok, _begun} = begin(c.gateway, %{slow | "id" => id} |> Map.put("command", command))
      await(c.gateway, id, &(&1["counts"]["ok"] == 1))
      by_hand(c.gateway, 13, by_hand)
      assert {:ok, _paused} = Operations.change(c.gateway, id, :pause, @operator)
      # As after the pause between its steps.
      %{core: %{steps: n}} = Operations.Server.entry(c.gateway, id)
      assert {:ok, _running} = Operations.change(c.gateway, id, :continue, @operator)
      send(Names.whereis(c.gateway, :operations), {:timeout, make_ref(), {:wait, id, n}})
      assert over(c.gateway, id)["vehicles"]["VID-013"]["state"] == result
    end
  end

  test "an abort does not mind what the aborted one had under way, nor a goto; it minds a hold by hand", c do
    for n <- [11, 13, 15] do
      vehicle(c.gateway, n, %{armed: true, in_air: true}, %{lat: 47.0, lon: 8.0, alt_rel: 6.0, alt_msl: 406.0})
    end

    turns = for n <- [11, 13, 15], do: one(n, [%{"wait" => "time", "timeout_s" => 300}])
    assert {:ok, _begun} = sequence(c.gateway, turns, %{"step" => 3})
    assert {:ok, %{"then" => back}} = Operations.change(c.gateway, "up", {:abort, "rtl"}, @other)
    for n <- [11, 13, 15], do: await(c.gateway, back, &(&1["vehicles"]["VID-0#{n}"]["step"] == "wait_at"))
    late = GivingWay.command_id("up", "VID-011", 0)
    RecentCommands.note(c.gateway, "VID-011", "ops", Intent.named("land"), late)
    RecentCommands.note(c.gateway, "VID-015", "ops", Intent.named("goto"), "by-hand")
    by_hand(c.gateway, 13, "hold")
    for {n, i} <- [{11, 0}, {13, 1}, {15, 2}], do: vehicle(c.gateway, n, %{}, %{alt_rel: 30.0 + 3 * i})
    done = over(c.gateway, back)["vehicles"]
    assert %{"VID-011" => %{"state" => "ok"}, "VID-015" => %{"state" => "ok"}} = done
    assert done["VID-013"]["reason"] =~ "it was given hold by other"
    refute_received {:commanded, "VID-013", "rtl"}
  end

  test "abort all: mine and nobody's that fly, whatever runs; several return at heights of their own", c do
    grounded(c.gateway, [11, 12, 13, 15, 16])

    assert {:error, {:conflict, "no vehicle in the air" <> _more}} =
             Operations.abort_all(c.gateway, "hold", @operator)

    assert {:ok, _begun} = sequence(c.gateway, [up(15), up(16)])
    for n <- [11, 12, 13], do: vehicle(c.gateway, n, %{armed: true, in_air: true}, %{alt_rel: 50.0})
    # 55 m from its home.
    vehicle(c.gateway, 12, %{}, %{lat: 47.0125})

    assert {:ok, _in_charge} =
             Commands.submit(c.gateway, vehicle: "VID-013", type: "take_control", as: @other)

    assert {:error, {:role, _why}} = Operations.abort_all(c.gateway, "rtl", @viewer)
    assert {:ok, %{"id" => id, "order" => order}} = Operations.abort_all(c.gateway, "rtl", @operator)
    assert Enum.sort(order) == ["VID-011", "VID-012", "VID-015"]
    assert %{"state" => "stopped"} = state(c.gateway)
    assert_receive {:commanded, "VID-011", "set_altitude"}, Aerie.Patience.ms()
    # The one that refuses to climb is told to return all the same.
    assert_receive {:commanded, "VID-012", "rtl"}, Aerie.Patience.ms()
    await(c.gateway, id, &(&1["vehicles"]["VID-011"]["step"] == "wait_at"))
    refute_received {:commanded, "VID-011", "rtl"}
    vehicle(c.gateway, 11, %{}, %{alt_rel: 30.5})
    assert_receive {:commanded, "VID-011", "rtl"}, Aerie.Patience.ms()

    assert %{"VID-012" => %{"reason" => "set_altitude: as it is; then: rtl: as it is"}} =
             over(c.gateway, id)["vehicles"]
  end

  test "a gateway that starts again knows who had begun, and goes on with the others only", %{
    gateway: gateway,
    kept: kept
  } do
    grounded(gateway, [11, 13, 15])
    assert {:ok, _begun} = sequence(gateway, [up(11), up(13), up(15)])
    vehicle(gateway, 11, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    assert_receive {:commanded, "VID-013", "arm"}, Aerie.Patience.ms()
    assert_receive {:commanded, "VID-013", "takeoff"}, Aerie.Patience.ms()
    restart(gateway, kept)
    interrupted = state(gateway)

    assert %{"state" => "interrupted", "source" => "ops", "counts" => %{"waiting" => 1, "ok" => 1}} =
             interrupted

    assert %{"result" => "unknown"} = interrupted["vehicles"]["VID-013"]
    # The same request is the same operation, which begins nobody.
    assert {:ok, %{"state" => "interrupted"}} = sequence(gateway, [up(11), up(13), up(15)])
    refute_received {:commanded, "VID-015", _type}
    vehicle(gateway, 13, %{armed: true, in_air: true}, %{alt_rel: 6.0})

    assert {:ok, %{"state" => "running", "source" => "other"}} =
             Operations.change(gateway, "up", :continue, @other)

    assert_receive {:commanded, "VID-015", "arm"}, Aerie.Patience.ms()
    vehicle(gateway, 15, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    assert %{"state" => "done", "counts" => %{"ok" => 2, "failed" => 1}} = over(gateway, "up")
    refute_received {:commanded, "VID-013", "arm"}
    restart(gateway, kept)
    assert %{"state" => "done", "counts" => %{"ok" => 2, "failed" => 1}} = state(gateway)
  end

  test "a sequence that an older version left running is interrupted, and can be continued and aborted", c do
    grounded(c.gateway, [11, 13])
    for n <- [11, 13], do: vehicle(c.gateway, n, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    steps = [%{"wait" => "above", "m" => 5, "timeout_s" => 60}, %{"type" => "rtl"}]
    sequence = for id <- ["VID-011", "VID-013"], do: %{"vehicle" => id, "steps" => steps}

    head = %{
      "id" => "old",
      "object" => %{"id" => "old", "sequence" => sequence},
      "vehicles" => ["VID-011", "VID-013"]
    }

    head = Map.merge(head, %{"source" => "ops", "via" => "console", "at" => 1_795_000_000_000_000})
    lines = [head, %{"begun" => ["VID-011"]}]

    restart(c.gateway, c.kept, fn ->
      File.write!(Path.join(c.kept, "old.jsonl"), for(line <- lines, do: [JSON.encode!(line), ?\n]))
    end)

    assert %{"state" => "interrupted", "vehicles" => %{"VID-011" => %{"result" => "unknown"}}} =
             state(c.gateway, "old")

    assert {:ok, _running} = Operations.change(c.gateway, "old", :continue, @operator)
    assert_receive {:commanded, "VID-013", "rtl"}, Aerie.Patience.ms()

    assert {:ok, %{"then" => <<_id::binary>>}} =
             Operations.change(c.gateway, "old", {:abort, "hold"}, @operator)

    assert_receive {:commanded, "VID-011", "hold"}, Aerie.Patience.ms()
  end

  test "a file that is damaged costs its own operation, and half a line what it was about", %{
    gateway: gateway,
    kept: kept
  } do
    for id <- ["a", "b", "c"],
        do: assert({:ok, _begun} = begin(gateway, %{"id" => id, "vehicles" => ["VID-011"]}))

    for id <- ["a", "b", "c"], do: over(gateway, id)
    File.write!(Path.join(kept, "a.jsonl"), "{\"state\": ", [:append])
    File.write!(Path.join(kept, "b.jsonl"), "nonsense\n", [:append])
    File.write!(Path.join(kept, "x.jsonl"), "")
    restart(gateway, kept)
    assert [%{"id" => "c"}, %{"id" => "a"}] = gateway |> Operations.list() |> Enum.sort_by(& &1["id"], :desc)
    assert String.ends_with?(File.read!(Path.join(kept, "a.jsonl")), "\n")
    assert [_b, _x] = Path.wildcard(Path.join(kept, "*.damaged-*"))
  end

  test "a full disk: the operation goes on, and a restart does not take up what was not written to its end",
       c do
    grounded(c.gateway, [11, 13, 15])
    assert {:ok, _begun} = sequence(c.gateway, [up(11), up(13), up(15)])
    assert_receive {:commanded, "VID-011", "takeoff"}, Aerie.Patience.ms()
    # /dev/full says "no space left" to every write, as a full disk does.
    path = Path.join(c.kept, "up.jsonl")
    File.rm!(path)
    File.ln_s!("/dev/full", path)
    vehicle(c.gateway, 11, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    assert_receive {:commanded, "VID-013", "takeoff"}, Aerie.Patience.ms()
    refute File.exists?(path)
    # There is room again, and the rest would be a file without its beginning.
    vehicle(c.gateway, 13, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    assert_receive {:commanded, "VID-015", "takeoff"}, Aerie.Patience.ms()
    restart(c.gateway, c.kept)
    assert {:error, {:unknown, _why}} = Operations.change(c.gateway, "up", :continue, @operator)
    assert Path.wildcard(Path.join(c.kept, "*")) == []
  end

  test "killed while a vehicle climbs, its operations command nobody any more", c do
    grounded(c.gateway, [11, 13])
    assert {:ok, _begun} = sequence(c.gateway, [up(11), up(13)])
    await(c.gateway, &(&1["vehicles"]["VID-011"]["step"] == "wait_above"))
    assert_received {:commanded, "VID-011", "arm"}
    [{wait, _value}] = eventually(fn -> told(c.gateway, 11) != [] && told(c.gateway, 11) end)
    reference = Process.monitor(wait)
    Process.exit(Names.whereis(c.gateway, :operations), :kill)
    # Its tasks end with it, and what they would have done next.
    assert_receive {:DOWN, ^reference, :process, ^wait, _with_it}, Aerie.Patience.ms()
    eventually(fn -> match?({:ok, %{"state" => "interrupted"}}, Operations.get(c.gateway, "up")) end)

    assert %{"VID-011" => %{"result" => "unknown"}, "VID-013" => %{"state" => "waiting"}} =
             state(c.gateway)["vehicles"]

    refute_received {:commanded, "VID-013", _type}
    vehicle(c.gateway, 11, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    assert {:ok, _now} = Operations.change(c.gateway, "up", :continue, @other)
    assert_receive {:commanded, "VID-013", "arm"}, Aerie.Patience.ms()
    refute_received {:commanded, "VID-011", "arm"}
  end

  defp told(gateway, n), do: Book.members({gateway, {:vehicle, "VID-0#{n}"}})

  # As after the end of the gateway: the store is empty.
  defp restart(gateway, kept, meanwhile \\ fn -> :ok end) do
    :ok = stop_supervised!(Operations.Supervisor)
    meanwhile.()
    for %{"id" => id} <- Operations.list(gateway), do: Store.forget(gateway, {:operation, id})
    start_supervised!({Operations.Supervisor, gateway: gateway, dir: kept})
  end

  test "a flood of large requests: eight run, the others are refused, and Abort all is not kept waiting",
       c do
    vehicle(c.gateway, 11, %{armed: true, in_air: true}, %{alt_rel: 6.0})
    ids = for n <- 1..2_000, do: "V-#{n}"

    object =
      &%{
        "id" => "flood-#{&1}",
        "vehicles" => ids,
        "step" => 1,
        "pause_s" => 3600,
        "command" => %{"type" => "disarm"}
      }

    answers =
      1..40
      |> Task.async_stream(&begin(c.gateway, object.(&1)), max_concurrency: 40, timeout: :infinity)
      |> Enum.frequencies_by(fn {:ok, {word, _what}} -> word end)

    assert answers == %{ok: 8, error: 32}
    assert {:ok, %{"order" => ["VID-011"]}} = Operations.abort_all(c.gateway, "land", @operator)
    assert_receive {:commanded, "VID-011", "land"}, Aerie.Patience.ms()

    for %{"id" => "flood-" <> _n, "state" => state} <- Operations.list(c.gateway),
        do: assert(state == "stopped")
  end

  test "each act is one entry of the audit log", %{gateway: gateway, tmp_dir: dir} do
    grounded(gateway, [11, 13])
    assert {:ok, _begun} = sequence(gateway, [up(11), up(13)])

    for change <- [:pause, :continue, :stop],
        do: assert({:ok, _now} = apply(Operations, :change, [gateway, "up", change, @operator, "console"]))

    assert {:ok, _now} = Operations.change(gateway, "up", {:abort, "hold"}, @operator, "console")

    eventually(fn ->
      {:ok, %{records: records}} = Audit.page(Path.join(dir, "audit"), %{type: "operation"})
      changes = for %{"id" => "up", "source" => "ops"} = record <- records, do: record["change"]
      Enum.reverse(changes) == ~w(begin pause continue stop abort)
    end)
  end
end
