defmodule Aerie.Control.CommandExecutor.CoreTest do
  use ExUnit.Case, async: true

  import Aerie.CommandSamples

  alias Aerie.Control.CommandExecutor.{Core, Timing}
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @ms 1_000
  @source {1, 1}

  # A copter that was heard at 0.
  defp core(autopilot \\ :ardupilot, more \\ %{}) do
    seen = %{mode: 0, in_air: 0, home: 0, mission: 0, position: 0}
    Core.new(%{vehicle(autopilot, more) | seen: seen})
  end

  defp submit(core, name, params \\ %{}, at \\ 1, more \\ []) do
    {for_us, more} = Keyword.pop(more, :for, 10 * @second)
    command = command(name, params, Keyword.put_new(more, :id, name))
    Core.handle(core, {:submit, command, at + for_us, at})
  end

  defp sent(actions), do: for({:send, messages, _id} <- actions, message <- messages, do: message)
  defp results(actions), do: for({:result, result} <- actions, do: {result.id, result.status})
  defp result(actions), do: Enum.find_value(actions, &(elem(&1, 0) == :result and elem(&1, 1)))

  defp ack(core, fields, at, source \\ @source),
    do: Core.handle(core, {:message, struct!(M.CommandAck, fields), source, at})

  defp observed(core, changes, at, groups \\ [:mode, :in_air]),
    do: Core.handle(core, {:observed, changes, groups, at})

  # Lets time pass to `at` as the process would, with all actions on the way.
  defp until(core, at, actions \\ []) do
    case Core.wake_at(core) do
      wake when wake != nil and wake <= at ->
        {core, more} = Core.handle(core, {:tick, wake})
        until(core, at, actions ++ more)

      _later ->
        {core, actions}
    end
  end

  # An acknowledgement, and the time in which the vehicle may say more.
  defp refused(core, fields, at) do
    {core, actions} = ack(core, fields, at)
    {core, more} = until(core, at + 500 * @ms)
    {core, actions ++ more}
  end

  describe "one command" do
    test "accepted and seen to be done" do
      {core, actions} = submit(core(:ardupilot, %{armed: false}), "arm")
      assert [%M.CommandLong{command: 400, param1: 1.0, confirmation: 0}] = sent(actions)
      assert Core.listens(core) == [77]
      {core, []} = ack(core, [command: 400], 20 * @ms)
      {core, actions} = observed(core, %{armed: true}, 500 * @ms)

      assert %{status: :completed, reason: nil, details: %{"sent" => 1, "acknowledged" => true, "ms" => 499}} =
               result(actions)

      assert Core.size(core) == 0
    end

    test "what the state does not show is accepted by the vehicle's word" do
      {core, _sent} = submit(core(), "set_speed", %{speed: 5})
      {core, actions} = ack(core, [command: 178], 20 * @ms)
      assert results(actions) == [{"set_speed", :accepted}]
      assert Core.wake_at(core) == nil
    end

    test "what came due while the gateway stood still is waited for once more, and nothing is sent after the deadline" do
      {core, _sent} = submit(core(), "set_speed", %{speed: 5}, 1, for: 3 * @second)
      due = Core.wake_at(core)
      {core, []} = Core.handle(core, {:tick, due + 300 * @ms})
      assert Core.wake_at(core) == due + 600 * @ms
      {answered, actions} = ack(core, [command: 178], due + 301 * @ms)
      assert results(actions) == [{"set_speed", :accepted}]
      assert Core.wake_at(answered) == nil

      # Once: a machine on which every wake is late gives up, too.
      {core, actions} = Core.handle(core, {:tick, due + 900 * @ms})
      assert [%M.CommandLong{command: 178, confirmation: 1}] = sent(actions)
      {core, []} = Core.handle(core, {:tick, 60 * @second})
      assert Core.wake_at(core) == 62 * @second
      {_core, actions} = Core.handle(core, {:tick, 62 * @second})
      assert sent(actions) == []
      assert results(actions) == [{"set_speed", :unknown}]
    end

    test "what the state showed before has to be heard again after the vehicle accepted" do
      {core, _sent} = submit(core(:ardupilot, %{mode: "LOITER"}), "set_mode", %{mode: "LOITER"})
      {core, []} = observed(core, %{mode: "LOITER"}, 10 * @ms)
      {core, []} = ack(core, [command: 176], 20 * @ms)
      {_core, actions} = observed(core, %{mode: "LOITER"}, 30 * @ms)
      assert results(actions) == [{"set_mode", :completed}]
    end

    test "safe ones are sent again with the next confirmation (C1), five times in all" do
      {core, _first} = submit(core(:ardupilot, %{armed: true}), "disarm")
      {core, actions} = until(core, 60 * @second)
      assert Enum.map(sent(actions), & &1.confirmation) == [1, 2, 3, 4]
      assert %{status: :unknown, details: %{"sent" => 5}} = result(actions)
      assert Core.size(core) == 0
    end

    test "dangerous ones are sent once" do
      for {name, params} <- [
            {"arm", %{}},
            {"motor_test", %{motor: 1, throttle: 0.1, duration: 1}},
            {"reboot", %{}}
          ] do
        {core, actions} = submit(core(:ardupilot, %{armed: false}), name, params)
        assert [_once] = sent(actions)
        {_core, actions} = until(core, 120 * @second)
        assert sent(actions) == []
        assert [{^name, :unknown}] = results(actions)
      end
    end

    test "nothing is sent from the deadline on" do
      {core, _first} = submit(core(), "disarm", %{}, 1, for: 1_500 * @ms)
      {_core, actions} = until(core, 60 * @second)
      assert [_one_more] = sent(actions)
      {_core, actions} = submit(core(), "disarm", %{}, 1, for: 0)
      assert [{:result, %{status: :expired}}] = actions
    end

    test "a gap and a command that cannot be are answered at once, without a word to the vehicle" do
      for {autopilot, name, params, more} <- [
            {:px4, "relay", %{relay: 1, on: true}, %{}},
            {:px4, "takeoff", %{altitude: 5}, %{armed: false, in_air: false}},
            {:ardupilot, "set_mode", %{mode: "NONE"}, %{}}
          ] do
        assert {core, [{:result, %{status: :rejected, reason: reason}}]} =
                 submit(core(autopilot, more), name, params)

        assert reason =~ ~r/\w/
        assert Core.size(core) == 0
      end
    end

    test "refusals say what the vehicle answered" do
      for {code, status, word} <- [
            {1, :rejected, "TEMPORARILY_REJECTED"},
            {2, :rejected, "DENIED"},
            {4, :failed, "FAILED"}
          ] do
        {core, _sent} = submit(core(), "arm")
        {core, []} = ack(core, [command: 400, result: code], 20 * @ms)
        # It may say why for a while.
        {core, []} = until(core, 500 * @ms)
        {_core, actions} = until(core, 600 * @ms)
        assert %{status: ^status, reason: "the vehicle answered " <> ^word} = result(actions)
      end
    end

    test "and what the vehicle says of it: before the acknowledgement and after it, texts rather than reports" do
      denied = [command: 400, result: 1]

      for {before, later, words} <- [
            {[{:text, "PreArm: Battery failsafe"}, {:text, "PreArm: Compass"}], [],
             "PreArm: Battery failsafe; PreArm: Compass"},
            {[], [{:text, "Arm: Throttle too high"}, {:text, "Arm: Throttle too high"}],
             "Arm: Throttle too high"},
            {[{:report, "arm denied calibrating"}], [], "arm denied calibrating"},
            {[{:report, "arm denied calibrating"}], [{:text, "Arming denied: calibrating"}],
             "Arming denied: calibrating"}
          ] do
        {core, []} = Core.handle(core(), {:said, {:text, "an older one"}, 0})
        {core, _sent} = submit(core, "arm")

        core =
          for said <- before,
              reduce: core,
              do: (core -> core |> Core.handle({:said, said, 10 * @ms}) |> elem(0))

        {core, []} = ack(core, denied, 20 * @ms)

        core =
          for said <- later,
              reduce: core,
              do: (core -> core |> Core.handle({:said, said, 90 * @ms}) |> elem(0))

        {core, actions} = until(core, 600 * @ms)
        reason = "the vehicle answered TEMPORARILY_REJECTED; it said: " <> words
        assert %{status: :rejected, reason: ^reason} = result(actions)
        assert Core.size(core) == 0
      end
    end

    test "a refusal that waits for its reason is the result, whatever comes" do
      denied = fn ->
        submit(core(), "arm") |> elem(0) |> ack([command: 400, result: 2], 20 * @ms) |> elem(0)
      end

      {core, []} = ack(denied.(), [command: 400, result: 0], 30 * @ms)
      {core, []} = observed(core, %{armed: true}, 40 * @ms)
      {_core, actions} = until(core, 600 * @ms)
      assert results(actions) == [{"arm", :rejected}]
      {core, actions} = Core.handle(denied.(), {:cancel, "arm", 30 * @ms})
      assert {results(actions), sent(actions)} == {[{"arm", :rejected}], []}
      assert Core.size(core) == 0
      {_core, actions} = observed(denied.(), %{boots: 1, booted_at: 25 * @ms}, 30 * @ms)
      assert results(actions) == [{"arm", :rejected}]
    end

    test "PX4's failing checks are in the refusal to arm" do
      {core, _sent} = submit(core(:px4, %{armed: false, arming_checks: ["check_gyro", "check_mag"]}), "arm")
      {core, []} = ack(core, [command: 400, result: 1], 20 * @ms)
      {_core, actions} = until(core, 600 * @ms)

      assert result(actions).reason ==
               "the vehicle answered TEMPORARILY_REJECTED; failing checks: check_gyro, check_mag"
    end

    test "ignores an acknowledgement for another ground station, command or component (C7)" do
      {core, _sent} = submit(core(), "arm")
      {core, []} = ack(core, [command: 400, result: 2, target_system: 255, target_component: 190], 10 * @ms)
      {core, []} = ack(core, [command: 22, result: 2], 10 * @ms)
      {core, []} = ack(core, [command: 400, result: 2], 10 * @ms, {1, 100})
      assert Core.size(core) == 1
    end

    test "an id that is being carried out is not carried out again" do
      {core, _sent} = submit(core(), "arm")
      assert {_core, [{:duplicate, "arm"}]} = submit(core, "arm")
    end
  end

  describe "forms (C2)" do
    test "COMMAND_INT becomes COMMAND_LONG after COMMAND_LONG_ONLY, once what may come late has come" do
      {core, actions} = submit(core(), "goto", %{lat: 1, lon: 2, altitude: 30})
      assert [%M.CommandInt{command: 192, frame: 6}] = sent(actions)
      {core, []} = ack(core, [command: 192, result: 7], 20 * @ms)
      # The same answer again.
      {core, []} = ack(core, [command: 192, result: 7], 30 * @ms)
      {core, actions} = until(core, @second)
      assert [%M.CommandLong{command: 192, param5: 1.0, param7: 30.0, confirmation: 0}] = sent(actions)
      {core, []} = ack(core, [command: 192, result: 0], @second)
      {_core, actions} = observed(core, %{mode: "GUIDED"}, 2 * @second)
      assert results(actions) == [{"goto", :completed}]
    end

    test "a form that is refused twice is the end" do
      {core, _sent} = submit(core(), "arm")
      {core, []} = ack(core, [command: 400, result: 8], 20 * @ms)
      {core, actions} = until(core, @second)
      assert [%M.CommandInt{command: 400}] = sent(actions)
      {_core, actions} = refused(core, [command: 400, result: 7], @second)
      assert [{"arm", :rejected}] = results(actions)
    end
  end

  describe "progress (C4)" do
    test "gives a vehicle time that reports progress" do
      {core, _sent} = submit(core(), "gripper", %{action: "grab"})
      {core, actions} = ack(core, [command: 211, result: 5, progress: 30], 20 * @ms)
      assert actions == [{:progress, "gripper", %{"progress" => 0.3, "text" => nil}}]
      {core, []} = until(core, 20 * @second)
      {_core, actions} = ack(core, [command: 211, result: 0], 20 * @second)
      assert results(actions) == [{"gripper", :accepted}]
    end

    test "and is unknown when it says nothing more" do
      {core, _sent} = submit(core(), "gripper", %{action: "grab"})
      {core, _progress} = ack(core, [command: 211, result: 5], 20 * @ms)
      {_core, actions} = until(core, 60 * @second)
      assert results(actions) == [{"gripper", :unknown}]
    end

    test "prompts of a calibration are passed on, and its texts are its end" do
      {core, _sent} =
        submit(core(:px4, %{armed: false, in_air: false}), "calibrate", %{sensor: "accelerometer"})

      assert Enum.sort(Core.listens(core)) == [77]
      {core, []} = ack(core, [command: 241], 20 * @ms)
      text = fn text, at -> {:message, %M.Statustext{text: text}, @source, at} end
      {core, [progress]} = Core.handle(core, text.("[cal] pending: back front left right up down", @second))
      assert {:progress, "calibrate", %{"text" => "pending: back front" <> _}} = progress
      {core, []} = until(core, 200 * @second)
      {core, [_progress]} = Core.handle(core, text.("[cal] progress <80>", 200 * @second))
      {core, []} = until(core, 400 * @second)
      {_core, actions} = Core.handle(core, text.("[cal] calibration failed: timeout", 400 * @second))
      assert %{status: :failed, reason: "calibration failed: timeout"} = result(actions)
    end
  end

  test "a later step that fails says what the earlier ones have changed" do
    core = core(:ardupilot, %{mode: "RTL", in_air: nil})
    {core, [_mode]} = submit(core, "takeoff", %{altitude: 20})
    {core, []} = ack(core, [command: 176], 20 * @ms)
    {core, [_takeoff]} = observed(core, %{mode: "GUIDED", in_air: true}, 500 * @ms)
    {_core, actions} = refused(core, [command: 22, result: 4], 600 * @ms)
    assert %{status: :failed, reason: reason} = result(actions)
    assert reason =~ "step 2: the vehicle answered FAILED" and reason =~ "its mode is now GUIDED, and was RTL"
  end

  describe "cancelling (C5)" do
    test "what waits is cancelled at once" do
      {core, _sent} = submit(core(), "arm", %{}, 1, id: "a")
      {core, []} = submit(core, "disarm", %{}, 2, id: "b")
      assert {core, [{:result, %{id: "b", status: :cancelled}}]} = Core.handle(core, {:cancel, "b", 3})
      assert {_core, [{:not_cancelled, "b", _reason}]} = Core.handle(core, {:cancel, "b", 4})
    end

    test "what runs is asked to stop, and its last word counts" do
      for {code, status} <- [{6, :cancelled}, {0, :accepted}, {4, :failed}] do
        {core, _sent} = submit(core(), "gripper", %{action: "grab"})
        {core, _progress} = ack(core, [command: 211, result: 5], 20 * @ms)
        {core, actions} = Core.handle(core, {:cancel, "gripper", 30 * @ms})
        assert [%M.CommandCancel{command: 211, target_system: 1}] = sent(actions)
        {_core, actions} = refused(core, [command: 211, result: code], 40 * @ms)
        assert results(actions) == [{"gripper", status}]
      end
    end

    test "PX4 cancels a calibration by the same command: the answer to that is not one to the calibration" do
      {core, _sent} = submit(core(:px4, %{armed: false, in_air: false}), "calibrate", %{sensor: "gyro"})
      {core, []} = ack(core, [command: 241], 20 * @ms)
      {core, actions} = Core.handle(core, {:cancel, "calibrate", @second})
      assert [%M.CommandLong{command: 241, param1: +0.0}] = sent(actions)
      {core, []} = ack(core, [command: 241, result: 2], @second)

      {_core, actions} =
        Core.handle(
          core,
          {:message, %M.Statustext{text: "[cal] calibration cancelled"}, @source, 2 * @second}
        )

      assert results(actions) == [{"calibrate", :cancelled}]
    end

    test "without a word it is unknown" do
      {core, _sent} = submit(core(), "gripper", %{action: "grab"})
      {core, _cancel} = Core.handle(core, {:cancel, "gripper", 30 * @ms})
      {_core, actions} = until(core, 60 * @second)
      assert [{"gripper", :unknown}] = results(actions)
      assert sent(actions) == []
    end
  end

  describe "turns" do
    test "one of a key is in flight, then quiet, then the next (C6, C8)" do
      {core, _sent} = submit(core(), "arm", %{}, 1, id: "a")
      {core, []} = submit(core, "disarm", %{}, 2, id: "b")
      {core, actions} = refused(core, [command: 400, result: 2], 20 * @ms)
      assert results(actions) == [{"a", :rejected}]
      # A late repetition of the answer is not taken for one to the next.
      {core, []} = ack(core, [command: 400, result: 2], 600 * @ms)
      {core, actions} = until(core, 1_100 * @ms)
      assert [%M.CommandLong{command: 400, param1: +0.0}] = sent(actions)
      assert Core.size(core) == 1
    end

    test "after the answer to what was sent once only a copy of it can come, and that soon (C8)" do
      {core, []} = Core.handle(core(), {:rtt, 5 * @ms})
      {core, _sent} = submit(core, "set_speed", %{speed: 3}, 1, id: "a")
      {core, []} = submit(core, "set_speed", %{speed: 4}, 2, id: "b")
      {core, actions} = ack(core, [command: 178], 20 * @ms)
      assert results(actions) == [{"a", :accepted}]
      # The copy is not taken for an answer to the next.
      {core, []} = ack(core, [command: 178], 60 * @ms)
      assert {core, []} = until(core, 69 * @ms)
      assert {core, [{:send, [%M.CommandLong{command: 178, param2: 4.0}], "b"}]} = until(core, 70 * @ms)

      # Of what was sent again, another answer may be under way.
      {core, _sent_again} = until(core, 70 * @ms + 500 * @ms)
      {core, []} = submit(core, "set_speed", %{speed: 5}, 575 * @ms, id: "c")
      {core, actions} = ack(core, [command: 178], 600 * @ms)
      assert results(actions) == [{"b", :accepted}]
      assert {core, []} = until(core, 1_099 * @ms)
      assert {_core, [{:send, _messages, "c"}]} = until(core, 1_100 * @ms)
    end

    test "commands of different keys do not wait for each other" do
      {core, _sent} = submit(core(), "arm")
      {_core, actions} = submit(core, "set_speed", %{speed: 3})
      assert [%M.CommandLong{command: 178}] = sent(actions)
    end

    test "what waits too long expires" do
      {core, _sent} = submit(core(), "arm", %{}, 1, id: "a")
      {core, []} = submit(core, "disarm", %{}, 2, id: "b", for: 300 * @ms)
      {_core, actions} = until(core, 400 * @ms)

      assert [{:result, %{id: "b", status: :expired, reason: "its deadline passed while it waited"}}] =
               actions
    end

    test "no more than 64, and 16 more of those that hold the vehicle or bring it down" do
      core =
        Enum.reduce(1..64, core(), fn n, core ->
          {core, _actions} = submit(core, "arm", %{}, 1, id: "a#{n}")
          core
        end)

      assert {core, [{:result, %{status: :rejected, reason: "64 commands wait" <> _}}]} =
               submit(core, "arm", %{}, 1, id: "more")

      core = for n <- 1..16, reduce: core, do: (core -> core |> submit("rtl", %{}, 1, id: "r#{n}") |> elem(0))
      assert Core.size(core) == 80
      assert {core, [{:result, %{status: :rejected, reason: "80 commands wait" <> _}}]} = submit(core, "rtl")
      assert Core.size(core) == 80
    end

    test "force_disarm waits for nothing, and what it takes the place of is given up" do
      {core, _sent} = submit(core(), "disarm", %{}, 1, id: "a")
      {core, []} = submit(core, "arm", %{}, 2, id: "b")
      {core, actions} = submit(core, "force_disarm", %{}, 3)
      assert [%M.CommandLong{param1: +0.0, param2: 21_196.0}] = sent(actions)
      assert results(actions) == [{"a", :unknown}, {"b", :cancelled}]
      # Perhaps the answers to the other one.
      {core, []} = ack(core, [command: 400, result: 8], 15 * @ms)
      {core, []} = ack(core, [command: 400, result: 2], 20 * @ms)
      {_core, actions} = observed(core, %{armed: false}, @second)
      assert results(actions) == [{"force_disarm", :completed}]
    end
  end

  describe "several steps" do
    test "each after the other" do
      {core, actions} =
        submit(core(:ardupilot, %{mode: "STABILIZE", in_air: false}), "takeoff", %{altitude: 10})

      assert [%M.CommandLong{command: 176}] = sent(actions)
      {core, []} = ack(core, [command: 176], 20 * @ms)
      {core, actions} = observed(core, %{mode: "GUIDED"}, 30 * @ms)
      assert [%M.CommandLong{command: 22, param7: 10.0}] = sent(actions)
      {core, []} = ack(core, [command: 22], 50 * @ms)
      {core, []} = observed(core, %{in_air: false}, 2 * @second)
      {_core, actions} = observed(core, %{in_air: true}, 5 * @second)
      assert %{status: :completed, details: %{"sent" => 2}} = result(actions)
    end

    test "the second is not sent when the first is refused, or after the deadline, or after a reboot" do
      start = fn more ->
        submit(core(:ardupilot, %{mode: "STABILIZE", in_air: false}), "takeoff", %{altitude: 10}, 1, more)
      end

      {core, _sent} = start.([])
      {_core, actions} = refused(core, [command: 176, result: 4], 20 * @ms)
      assert %{status: :failed, reason: "the vehicle answered FAILED"} = result(actions)
      assert sent(actions) == []

      {core, _sent} = start.(for: @second)
      {core, []} = ack(core, [command: 176], 20 * @ms)
      {_core, actions} = observed(core, %{mode: "GUIDED"}, 2 * @second)

      assert [{:result, %{status: :expired, reason: "its deadline passed after 1 of its steps" <> _}}] =
               actions
    end
  end

  describe "commands that our session also asks by (C8)" do
    test "wait until it asks nothing, and let it ask again when no answer can come any more" do
      {core, [{:alone, true}]} = submit(core(), "request_message", %{message_id: 148}, 1, id: "a")
      {core, []} = submit(core, "set_message_interval", %{message_id: 30, rate: 5}, 2, id: "b")
      # An answer to the session is not taken for ours.
      {core, []} = ack(core, [command: 512, result: 3], 10 * @ms)
      {core, actions} = Core.handle(core, {:alone, 20 * @ms})
      assert [%M.CommandLong{command: 512}, %M.CommandLong{command: 511}] = sent(actions)
      {core, actions} = ack(core, [command: 511], 30 * @ms)
      assert results(actions) == [{"b", :accepted}]
      {core, []} = ack(core, [command: 512], 40 * @ms)
      {core, actions} = Core.handle(core, {:message, %M.AutopilotVersion{}, @source, 50 * @ms})
      assert results(actions) == [{"a", :completed}]
      {core, actions} = until(core, 10 * @second)
      assert actions == [{:alone, false}]
      assert Core.wake_at(core) == nil
    end

    test "expire, and are cancelled, while they wait for that" do
      {core, [{:alone, true}]} =
        submit(core(), "request_message", %{message_id: 148}, 1, id: "a", for: @second)

      {core, []} = submit(core, "set_message_interval", %{message_id: 30, rate: 5}, 2, id: "b")
      {core, actions} = Core.handle(core, {:cancel, "b", 3})
      assert results(actions) == [{"b", :cancelled}]
      {core, actions} = until(core, 2 * @second)
      assert results(actions) == [{"a", :expired}]
      {core, []} = Core.handle(core, {:alone, 3 * @second})
      {_core, actions} = until(core, 20 * @second)
      assert actions == [{:alone, false}]
    end

    test "of another component are asked at once" do
      {_core, actions} = submit(core(), "request_message", %{message_id: 259, component: 100})
      assert [%M.CommandLong{command: 512, target_component: 100}] = sent(actions)
    end
  end

  describe "real firmware" do
    test "PX4 1.17 accepts a mode at once and refuses it some milliseconds later" do
      {core, _sent} = submit(core(:px4), "set_mode", %{mode: "OFFBOARD"})
      {core, []} = ack(core, [command: 176, result: 0], 1 * @ms)
      {_core, actions} = refused(core, [command: 176, result: 1], 9 * @ms)
      assert results(actions) == [{"set_mode", :rejected}]
    end

    test "PX4 1.17 accepts a mode that there is not, and stays as it is" do
      {core, _sent} = submit(core(:px4), "set_mode", %{mode: "RATTITUDE"})
      {core, []} = ack(core, [command: 176, result: 0], 1 * @ms)
      {core, []} = observed(core, %{mode: "AUTO_LOITER"}, @second)
      {_core, actions} = until(core, 10 * @second)

      assert %{status: :failed, reason: "the vehicle accepted it, but its mode is AUTO_LOITER, not RATTITUDE"} =
               result(actions)
    end

    test "no acknowledgement: the state says whether it was done" do
      submitted = fn ->
        {core, _sent} = submit(core(:ardupilot, %{armed: false}), "arm")
        core
      end

      {_core, actions} = observed(submitted.(), %{armed: true}, @second)
      assert %{status: :completed, details: %{"acknowledged" => false}} = result(actions)

      {core, []} = observed(submitted.(), %{armed: false}, 4 * @second)
      {_core, actions} = until(core, 20 * @second)
      assert %{status: :timeout, reason: "no acknowledgement came, and it is not armed"} = result(actions)

      {_core, actions} = until(submitted.(), 20 * @second)

      assert %{status: :unknown, reason: "no acknowledgement came, and its state was not heard since"} =
               result(actions)
    end

    test "a message that nothing acknowledges is repeated until the state shows it" do
      {core, actions} = submit(core(:px4, %{mission_seq: 1}), "mission_set_current", %{seq: 4})
      assert [%M.MissionSetCurrent{seq: 4}] = sent(actions)
      {core, actions} = until(core, 1_500 * @ms)
      assert [%M.MissionSetCurrent{seq: 4}] = sent(actions)
      {_core, actions} = observed(core, %{mission_seq: 4}, 2 * @second, [:mission])
      assert results(actions) == [{"mission_set_current", :completed}]
    end

    test "an answer to everybody is one to us" do
      {core, _sent} = submit(core(), "arm")
      {core, []} = ack(core, [command: 400, target_system: 0, target_component: 0], 20 * @ms)
      assert Core.size(core) == 1
      {_core, actions} = until(core, 30 * @second)
      assert [{"arm", :unknown}] = results(actions)
    end

    test "a home where there is none is refused before it is sent, and one that is not taken over is not completed" do
      {core, _sent} = submit(core(:px4), "set_home", %{lat: 47.5, lon: 8.5, altitude_msl: 480})
      {core, []} = ack(core, [command: 179], 20 * @ms)
      home = %{lat: 47.397742, lon: 8.545594, alt_msl: 489.6}
      {core, []} = observed(core, %{home: home}, 3 * @second, [:home])
      {_core, actions} = until(core, 20 * @second)

      assert %{status: :timeout, reason: "the vehicle accepted it, and its home is elsewhere"} =
               result(actions)
    end
  end

  describe "a reboot" do
    test "that was asked for is its completion" do
      {core, _sent} = submit(core(:ardupilot, %{armed: false, in_air: false}), "reboot")
      {core, []} = ack(core, [command: 246], 20 * @ms)
      {_core, actions} = observed(core, %{boots: 1}, 5 * @second)
      assert results(actions) == [{"reboot", :completed}]
    end

    test "leaves what was in flight unknown, drops what waits, and ends a stream" do
      {core, _sent} = submit(core(), "disarm", %{}, 1, id: "a")
      {core, []} = submit(core, "arm", %{}, 2, id: "b")
      {core, _sent} = submit(core, "rc_override", %{channels: [1500], hold: 10}, 3)
      {core, actions} = observed(core, %{boots: 1, armed: false}, 5 * @ms)
      assert [{"a", :completed}, {"b", :cancelled}] = results(actions) |> Enum.sort()
      assert until(core, 60 * @second) == {core, []}

      {core, _sent} = submit(core(), "set_speed", %{speed: 3})
      {_core, actions} = observed(core, %{boots: 1}, 5 * @ms)
      assert %{status: :unknown, reason: "the vehicle rebooted" <> _} = result(actions)
    end
  end

  describe "streams (X7)" do
    test "are repeated at their rate until they are not renewed, and given back" do
      {core, actions} = submit(core(), "rc_override", %{channels: [1600], hold: 1, rate: 10}, 0)

      assert [
               {:send, [%M.RcChannelsOverride{chan1_raw: 1600}], "rc_override"},
               {:result, %{status: :accepted}}
             ] = actions

      {core, actions} = until(core, 999 * @ms)
      assert length(sent(actions)) == 9
      {core, actions} = until(core, 10 * @second)
      assert [%M.RcChannelsOverride{chan1_raw: 0}] = sent(actions)
      assert Core.wake_at(core) == nil
    end

    test "F9: of sticks, MAVLink 1 has eight channels; more are refused before the first is sent" do
      old = core(:ardupilot, %{version: 1})

      assert {_core, [{:send, [_sticks], _id}, {:result, %{status: :accepted}}]} =
               submit(old, "rc_override", %{channels: List.duplicate(1500, 8)})

      {core, [result: result]} = submit(old, "rc_override", %{channels: List.duplicate(1500, 9)})

      assert %{status: :rejected, reason: "this vehicle speaks MAVLink 1, which has no field chan9_raw" <> _} =
               result

      assert Core.wake_at(core) == nil
    end

    test "are renewed without a gap, and one takes the place of another" do
      {core, _sent} = submit(core(), "setpoint_velocity", %{vx: 1, vy: 0, vz: 0, hold: 1}, 0, id: "a")
      {core, _sent} = submit(core, "setpoint_velocity", %{vx: 2, vy: 0, vz: 0, hold: 1}, 500 * @ms, id: "b")
      {core, actions} = until(core, 1_200 * @ms)
      assert Enum.all?(sent(actions), &(&1.vx == 2.0)) and length(sent(actions)) >= 6
      {core, actions} = submit(core, "rc_override", %{channels: [1600]}, 1_300 * @ms, id: "c")
      assert [%M.RcChannelsOverride{}] = sent(actions)
      # An override is given back before set-points begin.
      {_core, actions} = submit(core, "setpoint_velocity", %{vx: 3, vy: 0, vz: 0}, 1_400 * @ms, id: "d")
      assert [%M.RcChannelsOverride{chan1_raw: 0}, %M.SetPositionTargetLocalNed{vx: 3.0}] = sent(actions)
    end

    test "end at the deadline, and when they are cancelled" do
      {core, _sent} = submit(core(), "manual_control", %{pitch: 1, hold: 10}, 0, for: @second)
      {core, actions} = until(core, 20 * @second)
      assert length(sent(actions)) == 9
      assert Core.wake_at(core) == nil

      {core, _sent} = submit(core(), "rc_override", %{channels: [1600], hold: 10}, 0)
      {core, actions} = Core.handle(core, {:cancel, "rc_override", @second})
      assert [%M.RcChannelsOverride{chan1_raw: 0}] = sent(actions)
      assert Core.wake_at(core) == nil
    end
  end

  describe "by links of high latency only" do
    defp slow(more \\ %{}), do: core(:ardupilot, more) |> Core.handle({:rtt, :high_latency}) |> elem(0)

    test "X6: copies are few, and an answer counts minutes later" do
      {core, actions} = submit(slow(), "rtl", %{}, 1, for: 30 * @second)
      {core, more} = until(core, 20 * @second)
      assert length(sent(actions ++ more)) == 1
      {core, []} = ack(core, [command: 20], 20 * @second)
      {_core, actions} = until(core, 60 * @second)
      assert %{status: :accepted, reason: "its state will show it" <> _} = result(actions)
      # Without an end of its time a copy may follow, and a third; then the answer is awaited.
      {core, actions} = submit(slow(), "rtl", %{}, 1, for: 600 * @second)
      {core, more} = until(core, 100 * @second)
      assert length(sent(actions ++ more)) == 3
      {core, []} = until(core, 250 * @second)
      {core, []} = ack(core, [command: 20], 260 * @second)
      assert {_core, [_accepted]} = until(core, 270 * @second)
    end

    test "X6: what is not repeated waits for its only answer, and nothing is sent after the deadline" do
      {core, actions} = submit(slow(), "arm", %{}, 1, for: 10 * @second)
      {core, more} = until(core, 179 * @second)
      assert length(sent(actions ++ more)) == 1 and results(more) == []
      {_core, actions} = until(core, 181 * @second)
      assert %{status: :unknown} = result(actions)
    end

    test "a summary that shows it is enough; one that left before the command came is not" do
      {core, _actions} = submit(slow(), "rtl")
      {core, []} = observed(core, %{mode: "GUIDED"}, 10 * @second)
      {_core, actions} = observed(core, %{mode: "RTL"}, 75 * @second)
      assert %{status: :completed} = result(actions)
    end

    test "steps that need the state of the one before it do not go on blindly" do
      {core, actions} =
        submit(slow(%{mode: "STABILIZE", in_air: false}), "takeoff", %{altitude: 10}, 1, for: 600 * @second)

      {_core, more} = until(core, 600 * @second)
      assert %{status: :unknown} = result(more)
      assert sent(actions ++ more) |> Enum.map(& &1.command) |> Enum.uniq() |> length() == 1
    end
  end

  test "time-outs follow the measured round trip" do
    assert Timing.answer(nil) == @second
    assert Timing.answer(10 * @ms) == 500 * @ms
    assert Timing.answer(2 * @second) == 6_250 * @ms
    assert Timing.answer(60 * @second) == 30 * @second
    assert Timing.answer(10 * @ms, 20 * @second) == 20 * @second
    {slow, []} = Core.handle(core(), {:rtt, 2 * @second})
    {slow, _sent} = submit(slow, "disarm")
    assert Core.wake_at(slow) == 1 + 6_250 * @ms
  end
end
