defmodule Aerie.Control.CommandsTest do
  @moduledoc "The pipeline of commands; the test is the vehicle's executor."
  use Aerie.CommandCase, async: true

  import Aerie.OtherVM

  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Commands.{Metrics, Recovery}

  @moduletag :tmp_dir
  @moduletag :capture_log

  defp result(task), do: with({:ok, result} <- Task.await(task, Aerie.Patience.ms()), do: result)

  defp rule(task) do
    %Result{status: status, reason: reason, details: details} = result(task)
    assert is_binary(reason)
    {status, details["rule"]}
  end

  defp sample(gateway, name, labels) do
    %{samples: samples} = Enum.find(Metrics.all(gateway), &(&1.name == name))
    Enum.find_value(samples, fn sample -> if elem(sample, 0) == labels, do: elem(sample, 1) end)
  end

  test "a command passes, and is in ledger, audit log and metrics", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    task = command(gateway, "takeoff", id: "t1", params: %{altitude: 20}, source: "tablet 3")
    from = executing(%{id: "t1", source: "ops"})
    assert {:under_way, %{type: "takeoff", source: "ops"}} = Commands.state(gateway, "VID-007", "t1")
    assert nil == Commands.state(gateway, "VID-008", "t1")
    answer(from, "t1", :completed)
    assert %{status: :completed, details: %{"vehicle" => "VID-007", "type" => "takeoff"}} = result(task)
    assert {:ok, %{status: :completed}} = Commands.state(gateway, "VID-007", "t1")

    assert [
             %{
               "decision" => "allow",
               "id" => "t1",
               "source" => "ops",
               "says" => "tablet 3",
               "via" => "elixir"
             },
             %{"type" => "result", "id" => "t1", "result" => "completed"}
           ] = for(%{"id" => "t1"} = record <- audit(dir), do: record)

    assert sample(gateway, "gateway_commands_received_total", type: "takeoff") == 1
    assert sample(gateway, "gateway_commands_executed_total", type: "takeoff", result: :completed) == 1
  end

  test "a command makes five calls from its submission to the executor", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    session = :trace.session_create(:calls, self(), [])
    server = Aerie.Base.Names.whereis(gateway, :command_server)
    1 = :trace.process(session, server, true, [:send, :set_on_spawn])

    fields = [
      vehicle: "VID-007",
      type: "land",
      id: "a",
      as: operator(),
      deadline: System.os_time(:second) + 290
    ]

    task = Task.async(fn -> receive do: (:go -> Commands.submit(gateway, fields)) end)
    1 = :trace.process(session, task.pid, true, [:send])
    send(task.pid, :go)
    from = executing(%{id: "a"})
    delivered = :trace.delivered(session, :all)
    assert_receive {:trace_delivered, :all, ^delivered}

    calls =
      for {:trace, _pid, :send, {:"$gen_call", _from, call}, _to} <- elem(Process.info(self(), :messages), 1),
          do: elem(call, 0)

    # Those of two processes come in any order.
    assert Enum.sort(calls) == [:admit, :append, :sending, :submit, :submit]
    true = :trace.session_destroy(session)
    answer(from, "a", :completed)
    assert %{status: :completed} = result(task)
  end

  test "the same id: a second request waits meanwhile, later it is the stored result, another command is refused",
       %{tmp_dir: dir} do
    gateway = start_commands(dir)
    first = command(gateway, "land", id: "a")
    from = executing(%{id: "a"})
    second = command(gateway, "land", id: "a")
    eventually(fn -> sample(gateway, "gateway_commands_received_total", type: "land") == 2 end)
    assert {:rejected, "id"} = gateway |> command("rtl", id: "a") |> rule()
    answer(from, "a", :accepted)
    assert %{status: :accepted} = result(first)
    assert %{status: :accepted} = result(second)
    assert %{status: :accepted} = gateway |> command("land", id: "a") |> result()
    assert {:rejected, "id"} = gateway |> command("rtl", id: "a") |> rule()
    # Of somebody else it is another command.
    other = %{operator() | name: "other"}
    assert {:rejected, "id"} = gateway |> command("land", id: "a", as: other) |> rule()
    refute_submitted()
  end

  test "role, rate, policy, unknown vehicle, deadline: each refusal has its rule, and nothing is sent", %{
    tmp_dir: dir
  } do
    gateway =
      start_commands(dir,
        policy: [max_altitude: 100, rates: [%{types: ["gripper"], per_minute: 1, burst: 1}]]
      )

    viewer = %{operator() | role: :viewer}
    assert {:denied, "role"} = gateway |> command("arm", as: viewer) |> rule()
    assert {:denied, "role"} = gateway |> command("force_disarm") |> rule()

    assert {:denied, "altitude"} =
             gateway |> command("takeoff", id: "high", params: %{altitude: 120}) |> rule()

    # A refusal is stored, too: the same envelope cannot be obeyed later.
    put_vehicle(gateway)

    assert {:denied, "altitude"} =
             gateway |> command("takeoff", id: "high", params: %{altitude: 120}) |> rule()

    assert {:rejected, "vehicle"} = gateway |> command("arm", vehicle: "VID-009") |> rule()
    assert {:expired, "deadline"} = gateway |> command("arm", deadline: System.os_time(:second) - 1) |> rule()
    refute_submitted()

    gripper = command(gateway, "gripper", id: "g1", params: %{action: "release"})
    answer(executing(%{id: "g1"}), "g1", :accepted)
    assert %{status: :accepted} = result(gripper)
    assert {:denied, "rate"} = gateway |> command("gripper", params: %{action: "release"}) |> rule()
    # A repetition costs no token.
    assert %{status: :accepted} =
             gateway |> command("gripper", id: "g1", params: %{action: "release"}) |> result()

    assert {:error, [%{key: "params.altitude"}]} =
             gateway |> command("takeoff", params: %{altitude: 5000}) |> Task.await(Aerie.Patience.ms())

    assert {:error, [%{key: "type"}]} = gateway |> command("dance") |> Task.await(Aerie.Patience.ms())

    # The log is written by a process of its own.
    eventually(fn ->
      rules = for %{"decision" => "deny", "rule" => rule} <- audit(dir), do: rule
      Enum.uniq(rules) == ~w(role altitude vehicle deadline rate malformed)
    end)

    assert sample(gateway, "gateway_commands_refused_total", type: "arm", rule: :role) == 1
  end

  test "too many at once: denied, but for what holds a vehicle or brings it down", %{tmp_dir: dir} do
    gateway = start_commands(dir, commands: [max_in_flight: 1])
    goto = command(gateway, "goto", id: "g", params: %{lat: 47.0001, lon: 8.0, altitude: 10})
    from = executing(%{id: "g"})
    assert {:denied, "busy"} = gateway |> command("arm") |> rule()
    hold = command(gateway, "hold", id: "h")
    answer(executing(%{id: "h"}), "h", :completed)
    assert %{status: :completed} = result(hold)
    answer(from, "g", :completed)
    assert %{status: :completed} = result(goto)
  end

  test "the same command, once directly and once passed on by another gateway, is one; another sender's is not",
       %{tmp_dir: dir} do
    gateway = start_commands(dir)
    relay = Map.merge(operator(), %{kind: :key, name: "gateways"})
    task = command(gateway, "land", id: "a")
    answer(executing(%{id: "a"}), "a", :completed)
    assert %{status: :completed} = result(task)

    passed_on = fn says, as ->
      gateway |> command("land", id: "a", via: "nats", source: says, as: as) |> result()
    end

    assert %{status: :completed} = passed_on.("ops by rest", relay)
    assert %{status: :rejected, details: %{"rule" => "id"}} = passed_on.("ann by rest", relay)
    # Nobody is believed about a sender without a signature.
    assert %{status: :rejected} = passed_on.("ops by rest", %{relay | kind: :stranger})
    # And the other way round.
    task = command(gateway, "hold", id: "b", via: "nats", source: "ops by console", as: relay)
    answer(executing(%{id: "b"}), "b", :completed)
    assert %{status: :completed} = result(task)
    assert %{status: :completed} = gateway |> command("hold", id: "b") |> result()
  end

  test "what one source has under way leaves room for the others", %{tmp_dir: dir} do
    gateway = start_commands(dir, commands: [max_in_flight: 4])

    go = fn id, source ->
      command(gateway, "goto", id: id, as: source, params: %{lat: 47.0001, lon: 8.0, altitude: 10})
    end

    tasks = for n <- 1..3, do: go.("g#{n}", operator())
    froms = for n <- 1..3, id = "g#{n}", into: %{}, do: {id, executing(%{id: ^id})}

    assert {:ok, %{details: %{"rule" => "busy"}, reason: reason}} =
             Task.await(go.("g4", operator()), Aerie.Patience.ms())

    assert reason =~ "3 commands of ops are under way"
    other = go.("other", %{operator() | name: "olga"})
    answer(executing(%{id: "other"}), "other", :completed)
    assert %{status: :completed} = result(other)
    for {id, from} <- froms, do: answer(from, id, :completed)
    for task <- tasks, do: assert(%{status: :completed} = result(task))
  end

  test "who may nothing fills neither rates nor the ledger", %{tmp_dir: dir} do
    gateway = start_commands(dir, policy: %{rates: [%{types: ["arm"], per_minute: 1, burst: 1}]})
    viewer = %{operator() | role: :viewer}

    for n <- 1..3,
        do: assert({:denied, "role"} = gateway |> command("arm", id: "v#{n}", as: viewer) |> rule())

    assert nil == Commands.state(gateway, "VID-007", "v1")
    task = command(gateway, "arm", id: "v1")
    answer(executing(%{id: "v1"}), "v1", :completed)
    assert %{status: :completed} = result(task)
  end

  test "a caller that does not wait, or no longer: the command goes on", %{tmp_dir: dir} do
    gateway = start_commands(dir)

    assert {:pending, "a"} =
             gateway |> command("land", id: "a", wait_ms: 0) |> Task.await(Aerie.Patience.ms())

    from = executing(%{id: "a"})

    assert {:pending, "a"} =
             gateway |> command("land", id: "a", wait_ms: 1) |> Task.await(Aerie.Patience.ms())

    answer(from, "a", :completed)
    assert %{status: :completed} = gateway |> command("land", id: "a") |> result()
  end

  test "progress and cancelling, for a source that may give the command", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    task = command(gateway, "takeoff", id: "t", params: %{altitude: 9}, progress: {self(), :mine})
    assert_receive {:"$gen_call", from, {:submit, %{id: "t"}, desk, _still?}}
    send(desk, {:command_progress, "t", %{"progress" => 0.5, "text" => nil}})
    assert_receive {:command_progress, :mine, "t", %{"progress" => 0.5}}
    assert {:under_way, %{progress: %{"progress" => 0.5}}} = Commands.state(gateway, "VID-007", "t")

    assert {:error, :role, _text} = Commands.cancel(gateway, "VID-007", "t", %{operator() | role: :viewer})
    assert {:error, :unknown, _text} = Commands.cancel(gateway, "VID-008", "t", operator())
    cancel = Task.async(fn -> Commands.cancel(gateway, "VID-007", "t", operator()) end)
    assert_receive {:"$gen_call", canceller, {:cancel, "t"}}
    GenServer.reply(canceller, :ok)
    assert Task.await(cancel, Aerie.Patience.ms()) == :ok
    answer(from, "t", :cancelled)
    assert %{status: :cancelled} = result(task)
  end

  test "one is in charge: hand-over, take-over with a reason, release; all of it in the audit log", %{
    tmp_dir: dir
  } do
    gateway = start_commands(dir, policy: [lease: %{required: true}])
    other = %{operator() | name: "other"}
    done = fn type, more -> assert %{status: :completed} = gateway |> command(type, more) |> result() end
    assert {:denied, "lease"} = gateway |> command("arm") |> rule()
    done.("take_control", [])
    arm = command(gateway, "arm", id: "a")
    answer(executing(%{id: "a"}), "a", :completed)
    assert %{status: :completed} = result(arm)
    assert {:denied, "lease"} = gateway |> command("arm", as: other) |> rule()
    assert {:denied, "lease"} = gateway |> command("take_control", as: other) |> rule()

    assert {:denied, "lease"} =
             gateway |> command("hand_over_control", as: other, params: %{to: "other"}) |> rule()

    land = command(gateway, "land", id: "l", as: other)
    answer(executing(%{id: "l"}), "l", :completed)
    assert %{status: :completed} = result(land)

    done.("hand_over_control", params: %{to: "other"})
    assert %{holder: "ops", offered_to: "other"} = Policy.ControlLease.Holders.of(gateway, {"main", 7})
    done.("take_control", as: other)
    assert {:denied, "lease"} = gateway |> command("arm") |> rule()
    done.("take_control", params: %{reason: "it drifts"})

    assert %{holder: "ops", before: "other", reason: "it drifts"} =
             Policy.ControlLease.Holders.of(gateway, {"main", 7})

    done.("release_control", [])
    assert Policy.ControlLease.Holders.of(gateway, {"main", 7}) == nil

    assert [_first, _second, %{"reason" => "it drifts"}] =
             for(
               %{"command" => "take_control", "decision" => "allow"} = record <- audit(dir),
               do: record["params"]
             )
  end

  test "a vehicle that has an operator itself (X15) is asked, and what it refuses changes nothing", %{
    tmp_dir: dir
  } do
    gateway = start_commands(dir)
    snapshot = Store.vehicle(gateway, "VID-007")
    operator = %{at: System.os_time(:microsecond), data: %{system: 0, takeover_allowed: true}}
    Store.put_vehicle(gateway, {"main", 7}, put_in(snapshot.groups[:operator], operator))
    task = command(gateway, "take_control", id: "no")
    answer(executing(%{id: "no"}), "no", :failed)
    assert %{status: :failed} = result(task)
    assert Policy.ControlLease.Holders.of(gateway, {"main", 7}) == nil
    task = command(gateway, "take_control", id: "yes")
    answer(executing(%{id: "yes"}), "yes", :accepted)
    assert %{status: :accepted} = result(task)
    assert %{holder: "ops"} = Policy.ControlLease.Holders.of(gateway, {"main", 7})
    # It does not answer, and is let go all the same.
    task = command(gateway, "release_control", id: "off")
    answer(executing(%{id: "off"}), "off", :unknown)
    assert %{status: :unknown} = result(task)
    assert Policy.ControlLease.Holders.of(gateway, {"main", 7}) == nil
  end

  test "what would become of a command, without giving it", %{tmp_dir: dir} do
    gateway =
      start_commands(dir,
        policy: [max_altitude: 100, rates: [%{types: ["gripper"], per_minute: 1, burst: 1}]]
      )

    check = fn type, more ->
      Commands.check(gateway, [vehicle: "VID-007", type: type, as: operator()] ++ more)
    end

    release = [params: %{action: "release"}]
    for _n <- 1..3, do: assert(:allow = check.("gripper", release))

    assert {:deny, :altitude, "the height to climb to is 120 m" <> _} =
             check.("takeoff", params: %{altitude: 120})

    assert {:deny, :role, _} = check.("reboot", [])
    assert {:deny, :firmware, "only ArduPlane circles" <> _} = check.("orbit", params: %{radius: 30})

    assert {:deny, :firmware, "it is on the ground"} =
             check.("goto", params: %{lat: 47.0001, lon: 8, altitude: 9})

    assert {:error, [%{key: "params.altitude"}]} = check.("takeoff", [])
    assert {:deny, :vehicle, _} = Commands.check(gateway, vehicle: "VID-009", type: "arm")
    assert [] = Enum.filter(audit(dir), &(&1["type"] == "decision"))
    assert {:deny, :policy, _} = Commands.check(make_ref(), vehicle: "VID-007", type: "arm")
  end

  test "PX4's OFFBOARD needs set-points for a second before (X7); GUIDED and a vehicle that is not armed do not",
       %{
         tmp_dir: dir
       } do
    gateway = start_commands(dir)
    offboard = [params: %{mode: "offboard"}]
    guided = command(gateway, "set_mode", id: "g", params: %{mode: "GUIDED"})
    answer(executing(%{id: "g"}), "g", :completed)
    assert %{status: :completed} = result(guided)

    px4 = fn ->
      Store.put_vehicle(gateway, {"main", 7}, %{Store.vehicle(gateway, "VID-007") | autopilot: :px4})
    end

    px4.()
    assert {:rejected, "setpoints"} = gateway |> command("set_mode", offboard) |> rule()

    assert {:deny, :firmware, "the mode needs set-points" <> _} =
             Commands.check(gateway, [vehicle: "VID-007", type: "set_mode"] ++ offboard)

    refute_submitted()

    velocity = [id: "v", params: %{vx: 1, vy: 0, vz: 0, hold: 10}, as: Commands.inside()]
    stream = command(gateway, "setpoint_velocity", velocity)
    from = executing(%{id: "v"})
    # They last, however long a busy machine takes.
    {since, _until} = Store.recall(gateway, {:setpoints, "VID-007"})
    Store.remember(gateway, {:setpoints, "VID-007"}, {since, since + 10 * Aerie.Patience.ms()})

    eventually(fn ->
      with ms when is_integer(ms) <- Policy.Memory.RecentCommands.setpoints_ms(gateway, "VID-007"),
           do: ms >= 1_000
    end)

    assert :allow = Commands.check(gateway, [vehicle: "VID-007", type: "set_mode"] ++ offboard)
    mode = command(gateway, "set_mode", [id: "o"] ++ offboard)
    answer(executing(%{id: "o"}), "o", :completed)
    answer(from, "v", :completed)
    assert [%{status: :completed}, %{status: :completed}] = Enum.map([stream, mode], &result/1)

    for {id, state, params} <- [
          {"e", %{}, %{mode: "OFFBOARD", setpoints_elsewhere: true}},
          {"d", %{armed: false}, %{mode: "OFFBOARD"}}
        ] do
      Store.remember(gateway, {:setpoints, "VID-007"}, {0, 0})
      put_vehicle(gateway, state)
      px4.()
      task = command(gateway, "set_mode", id: id, params: params)
      answer(executing(%{id: ^id}), id, :completed)
      assert %{status: :completed} = result(task)
    end
  end

  describe "ledger or audit log cannot be written" do
    # A file where the folder would be.
    defp block(dir, name), do: File.write!(Path.join(dir, name), "")

    test "the ledger: what is dangerous is denied, what holds a vehicle or brings it down goes", %{
      tmp_dir: dir
    } do
      block(dir, "ledger")
      gateway = start_commands(dir)
      assert {:denied, "ledger"} = gateway |> command("arm") |> rule()
      goto = %{lat: 47.0001, lon: 8.0, altitude: 10}
      assert {:denied, "ledger"} = gateway |> command("goto", params: goto) |> rule()

      for type <- ~w(land rtl hold disarm) do
        task = command(gateway, type, id: type)
        answer(executing(%{id: ^type}), type, :completed)
        assert %{status: :completed} = result(task)
      end

      # It must not be done twice, and what was done before only the file knows.
      may = %{operator() | permissions: [:force_disarm]}
      assert {:denied, "ledger"} = gateway |> command("force_disarm", as: may) |> rule()
    end

    test "the ledger, not required: everything goes that may be done twice", %{tmp_dir: dir} do
      block(dir, "ledger")
      ledger = %{dir: Path.join(dir, "ledger"), max_entries: 1000, max_age_s: 3600.0, required: false}
      gateway = start_commands(dir, commands: [ledger: ledger])
      task = command(gateway, "goto", id: "g", params: %{lat: 47.0001, lon: 8.0, altitude: 10})
      answer(executing(%{id: "g"}), "g", :completed)
      assert %{status: :completed} = result(task)
      assert {:denied, "ledger"} = gateway |> command("arm") |> rule()
    end

    test "the audit log: likewise, and `policy.audit.required: false` lets all pass", %{tmp_dir: dir} do
      block(dir, "audit")
      gateway = start_commands(dir)
      assert {:denied, "audit"} = gateway |> command("arm") |> rule()
      task = command(gateway, "land", id: "l")
      answer(executing(%{id: "l"}), "l", :completed)
      assert %{status: :completed} = result(task)
      :ok = Policy.Store.put(gateway, %{audit: %{required: false}})
      task = command(gateway, "arm", id: "a")
      answer(executing(%{id: "a"}), "a", :completed)
      assert %{status: :completed} = result(task)
    end
  end

  test "a task that dies: the result is unknown, and the command is never sent again", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    task = command(gateway, "arm", id: "a")
    {pid, _tag} = executing(%{id: "a"})
    Process.exit(pid, :kill)
    assert %{status: :unknown} = result(task)
    eventually(fn -> match?(%Result{}, Ledger.lookup(gateway, "a")) end)
    assert %{status: :unknown} = gateway |> command("arm", id: "a") |> result()
    refute_submitted()
  end

  test "the supervisor of commands dies with commands under way: they are unknown, observed, and not sent again",
       %{
         tmp_dir: dir
       } do
    gateway = start_commands(dir)
    arm = command(gateway, "arm", id: "a")
    executing(%{id: "a"})
    reset = command(gateway, "set_home", id: "s", params: %{here: true})
    executing(%{id: "s"})
    Process.exit(Aerie.Base.Names.whereis(gateway, :ledger), :kill)
    assert %{status: :unknown} = result(arm)
    assert %{status: :unknown} = result(reset)

    # Heard again, and armed.
    eventually(fn ->
      put_vehicle(gateway)

      match?(
        {:ok, %{status: :completed, details: %{"interrupted" => true}}},
        Commands.state(gateway, "VID-007", "a")
      )
    end)

    assert %{status: :completed, reason: reason} = gateway |> command("arm", id: "a") |> result()
    assert reason =~ "the vehicle's state shows it now"
    refute_submitted()
  end

  test "kill -9 of the gateway with commands under way: stored results stay, the rest is observed, nothing is sent again",
       %{tmp_dir: dir} do
    script = """
    Application.ensure_all_started(:control)
    Application.put_env(:vehicle, :gateway_parts, [Aerie.ControlParts])
    {:ok, _} = Aerie.GatewayCase.start_link(%{}, name: :g, with: [])
    dir = #{inspect(dir)}
    config = %{policy: %{audit: %{dir: Path.join(dir, "audit"), max_mb: 8, required: true}}, commands: Aerie.CommandCase.commands(dir)}
    for part <- [Aerie.Control.Policy.Store.Supervisor, Aerie.Control.Commands.Supervisor], do: {:ok, _} = part.start_link(Aerie.LinkCase.options(part, :g, config))
    Aerie.Base.Names.register(:g, :commands, {"main", 7})
    Aerie.CommandCase.put_vehicle(:g)
    for {id, type} <- [{"done", "land"}, {"arm", "arm"}, {"off", "disarm"}, {"drop", "gripper"}] do
      params = if type == "gripper", do: %{action: "release"}, else: %{}
      Task.start(fn -> Aerie.Control.Commands.submit(:g, vehicle: "VID-007", id: id, type: type, params: params, as: Aerie.CommandCase.operator()) end)
      receive do
        {:"$gen_call", from, {:submit, %{id: ^id}, _progress, _still?}} ->
          if id == "done", do: Aerie.CommandCase.answer(from, id, :completed)
      end
    end
    {:ok, %{status: :completed}} = Aerie.Control.Commands.submit(:g, vehicle: "VID-007", id: "done", type: "land", as: Aerie.CommandCase.operator())
    IO.puts("under way \#{System.pid()}")
    Process.sleep(:infinity)
    """

    {_port, pid} = other_vm(script, "under way ")
    kill9(pid)
    gateway = start_commands(dir)
    assert %{status: :completed} = gateway |> command("land", id: "done") |> result()
    assert %{status: :unknown} = gateway |> command("disarm", id: "off") |> result()

    # The vehicle is heard, and armed.
    eventually(fn ->
      put_vehicle(gateway)
      match?({:ok, %{status: :completed}}, Commands.state(gateway, "VID-007", "arm"))
    end)

    assert %{status: :unknown, reason: reason} =
             gateway |> command("gripper", id: "drop", params: %{action: "release"}) |> result()

    assert reason =~ "it is not sent again"
    assert {:rejected, "id"} = gateway |> command("arm", id: "off") |> rule()
    refute_submitted()
  end

  test "what an interrupted command did, is judged by the state", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    snapshot = Store.vehicle(gateway, "VID-007")

    judge = fn type, params ->
      {:ok, command} = Command.new(vehicle: "VID-007", type: type, params: params)
      Recovery.evaluate(command, snapshot)
    end

    assert judge.("arm", %{}) == :shown
    assert judge.("disarm", %{}) == :not_shown
    assert judge.("reboot", %{}) == :cannot_tell
    assert judge.("gripper", %{action: "release"}) == :cannot_tell
    # A mode whose name is not known yet: the vehicle may tell its modes.
    assert judge.("set_mode", %{mode: "EXTERNAL1"}) == :not_shown
  end

  test "drained: no new command, those under way are waited for, what is left is unknown and stays in the ledger",
       %{
         tmp_dir: dir
       } do
    gateway = start_commands(dir, commands: %{grace_s: 300})
    assert Commands.drain(make_ref()) == []
    first = command(gateway, "takeoff", id: "a", params: %{altitude: 20})
    from = executing(%{id: "a"})
    drain = Task.async(fn -> Commands.drain(gateway) end)
    desk = Aerie.Base.Names.whereis(gateway, :command_server)
    eventually(fn -> :sys.get_state(desk, Aerie.Patience.ms()).draining != nil end)
    assert {:denied, "unavailable"} = gateway |> command("arm") |> rule()
    answer(from, "a", :completed)
    assert result(first).status == :completed
    assert Task.await(drain, Aerie.Patience.ms()) == []
  end

  test "what cannot be drained is unknown, and stays in the ledger as sent", %{tmp_dir: dir} do
    gateway = start_commands(dir, commands: %{grace_s: 0})
    task = command(gateway, "takeoff", id: "b", params: %{altitude: 20})
    _from = executing(%{id: "b"})
    assert Commands.drain(gateway) == ["b"]
    assert %{status: :unknown, reason: "the gateway ended" <> _} = result(task)
    assert {:under_way, %{type: "takeoff"}} = Commands.state(gateway, "VID-007", "b")
    assert File.read!(Path.join([dir, "ledger", "ledger"])) =~ ~s(["sent","b")
  end

  test "no policy: nothing may be commanded", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    :ok = stop_supervised(Policy.Store.Supervisor)
    assert {:denied, "policy"} = gateway |> command("land") |> rule()
  end

  test "without the server of commands nothing is sent", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    :ok = stop_supervised(Commands.Supervisor)
    assert {:denied, "unavailable"} = gateway |> command("land") |> rule()
  end
end
