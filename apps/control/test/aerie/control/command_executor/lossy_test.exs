defmodule Aerie.Control.CommandExecutor.LossyTest do
  @moduledoc "The executor before vehicles that lose, delay, double, refuse, lie and reboot: `Aerie.LossyVehicle`."
  use ExUnit.Case, async: true

  alias Aerie.{CommandSamples, LossyVehicle}
  alias Aerie.Vehicle.Command
  alias Aerie.Control.CommandExecutor.Core

  # Commands of all types that this vehicle can do something about, drawn by a seed.
  defp commands(count, seed) do
    :rand.seed(:exsss, seed)

    for n <- 1..count do
      {type, params} = Enum.random(types())
      CommandSamples.command(type, params, id: "c#{n}")
    end
  end

  defp types do
    [
      {"arm", %{}},
      {"disarm", %{}},
      {"force_disarm", %{}},
      {"terminate", %{}},
      {"takeoff", %{altitude: 20}},
      {"land", %{}},
      {"rtl", %{}},
      {"hold", %{}},
      {"resume", %{}},
      {"mission_start", %{}},
      {"mission_pause", %{}},
      {"set_mode", %{standard_mode: "position_hold"}},
      {"set_mode", %{standard_mode: "altitude_hold"}},
      {"goto", %{lat: 47.4, lon: 8.5, altitude: 30}},
      {"set_altitude", %{altitude: 25}},
      {"set_yaw", %{yaw: 90}},
      {"set_speed", %{speed: 5}},
      {"set_home", %{here: true}},
      {"set_home", %{lat: 47.4, lon: 8.5, altitude_msl: 480}},
      {"set_origin", %{lat: 47.4, lon: 8.5, altitude_msl: 480}},
      {"mission_set_current", %{seq: Enum.random(1..5)}},
      {"gripper", %{action: "release"}},
      {"parachute", %{action: "release"}},
      {"camera_trigger", %{}},
      {"gimbal", %{pitch: -30, yaw: 0}},
      {"motor_test", %{motor: 1, throttle: 0.1, duration: 1}},
      {"request_message", %{message_id: 148}},
      {"set_message_interval", %{message_id: 30, rate: 5}},
      {"setpoint_velocity", %{vx: 1, vy: 0, vz: 0, hold: 0.5}},
      {"rc_override", %{channels: [1500], hold: 0.5}},
      {"reset_params", %{}},
      {"prearm_check", %{}}
    ]
  end

  # All submitted at random moments, some cancelled, with reboots at given places; then time for the rest.
  defp fly(autopilot, count, seed, reboots) do
    commands(count, seed)
    |> Enum.with_index(1)
    |> Enum.reduce(LossyVehicle.new(autopilot, seed), fn {command, n}, world ->
      world = LossyVehicle.submit(world, command, Enum.random([300, 2_000, 5_000, 10_000]))
      world = if :rand.uniform() < 0.05, do: LossyVehicle.cancel(world, command.id), else: world
      world = if n in reboots, do: LossyVehicle.reboot(world), else: world
      LossyVehicle.advance(world, Enum.random([0, 1, 10, 100, 500, 1_500]) + 1)
    end)
    |> LossyVehicle.advance(120_000)
  end

  defp check(autopilot, count, seed, reboots) do
    world = fly(autopilot, count, seed, reboots)
    assert LossyVehicle.wrong(world) == []
    assert map_size(world.results) == count
    # Nothing is left over, and nothing more is waited for.
    assert Core.size(world.core) == 0
    assert Core.wake_at(world.core) == nil
    world
  end

  test "10,000 commands at 20 % loss and 10 % doubled, with two reboots: each done at most once, every answer right" do
    for {autopilot, seed} <- [ardupilot: 1, px4: 2] do
      world = check(autopilot, 5_000, seed, [1_700, 3_300])
      # That they are right is not because nothing is known.
      known =
        Enum.count(world.results, fn {_id, {result, _at, _heard}} ->
          result.status not in [:unknown, :timeout]
        end)

      assert known > 3_500
    end
  end

  defp command(type, params, id) do
    fields = %{"id" => id, "vehicle" => "V", "type" => type, "params" => params, "source" => "test"}
    {:ok, command} = Command.parse(fields, 1_795_000_000_000_000)
    command
  end

  defp operation do
    :proper_types.frequency([
      {10, {:submit, CommandSamples.any(), :proper_types.range(1, 12_000)}},
      {10, {:advance, :proper_types.range(1, 3_000)}},
      {2, {:cancel, :proper_types.range(1, 50)}},
      {1, :reboot},
      {1,
       {:link, :proper_types.float(0.0, 1.0), :proper_types.float(0.0, 0.5),
        :proper_types.range(6_000, 150_000)}}
    ])
  end

  defp run(operation, {world, n, seed}) do
    world =
      case operation do
        {:submit, command, ms} -> LossyVehicle.submit(world, %{command | id: "s#{seed}n#{n}"}, ms)
        {:advance, ms} -> LossyVehicle.advance(world, ms)
        {:cancel, back} -> LossyVehicle.cancel(world, "s#{seed}n#{max(n - back, 0)}")
        :reboot -> LossyVehicle.reboot(world)
        {:link, loss, doubled, delay} -> %{world | loss: loss, doubled: doubled, delay: {5_000, delay}}
      end

    {world, n + 1, seed}
  end

  defp run_all({autopilot, seed, operations}) do
    {world, _n, _seed} = Enum.reduce(operations, {LossyVehicle.new(autopilot, seed), 0, seed}, &run/2)
    LossyVehicle.advance(world, 700_000)
  end

  # An example of a failed property that can be run again, and what is wrong with it.
  defp counterexample do
    with [example] <- :proper.counterexample(),
         do: inspect({example, LossyVehicle.wrong(run_all(example))}, limit: :infinity)
  end

  defp property do
    :proper.forall(
      {:proper_types.oneof([:ardupilot, :px4]), :proper_types.pos_integer(), :proper_types.list(operation())},
      fn example ->
        world = run_all(example)

        LossyVehicle.wrong(world) == [] and map_size(world.results) == map_size(world.commands) and
          Core.size(world.core) == 0 and Core.wake_at(world.core) == nil
      end
    )
  end

  test "any commands with any parameters, cancelled, over any link, with reboots: one right answer each" do
    assert :proper.quickcheck(property(), [:quiet, numtests: 300, max_size: 60]) == true,
           "#{counterexample()}"
  end

  test "an acknowledgement that was asked for is not taken from another command" do
    for seed <- 1..50 do
      world = LossyVehicle.new(:ardupilot, seed)

      world =
        for {type, params, n} <- [
              {"gimbal", %{"action" => "point", "pitch" => 10, "yaw" => 20}, 1},
              {"motor_test", %{"motor" => 10, "throttle" => 0.5, "duration" => 1}, 2},
              {"request_message", %{"message_id" => 77}, 3}
            ],
            reduce: world do
          world ->
            LossyVehicle.submit(world, command(type, params, "s#{seed}n#{n}"), 5_000)
        end

      assert world |> LossyVehicle.advance(700_000) |> LossyVehicle.wrong() == []
    end
  end

  test "C8: an acknowledgement for the autopilot by its number is not taken for one of the autopilot" do
    for seed <- 1..50, autopilot <- [:ardupilot, :px4] do
      world =
        for {params, n} <- [{%{"stream" => 243, "component" => 1}, 1}, {%{"stream" => 0}, 2}],
            reduce: LossyVehicle.new(autopilot, seed) do
          world ->
            video = command("camera_video", Map.put(params, "action", "stop"), "s#{seed}n#{n}")
            LossyVehicle.submit(world, video, 5_000)
        end

      assert world |> LossyVehicle.advance(700_000) |> LossyVehicle.wrong() == []
    end
  end

  test "an acknowledgement of a calibration is not taken for one of its cancellation" do
    for seed <- 1..300 do
      # PX4 calibrates nothing while it is armed.
      disarmed =
        LossyVehicle.submit(LossyVehicle.new(:px4, seed), command("force_disarm", %{}, "s#{seed}n0"), 7_000)

      world =
        for {type, params, n} <- [{"calibrate", %{"sensor" => "esc"}, 1}, {"calibrate_cancel", %{}, 2}],
            reduce: LossyVehicle.advance(disarmed, 2_500) do
          world -> LossyVehicle.submit(world, command(type, params, "s#{seed}n#{n}"), 5_000)
        end

      assert world |> LossyVehicle.advance(700_000) |> LossyVehicle.wrong() == []
    end
  end

  test "C8: the answer to what cancels a calibration is not taken for one to the same command" do
    for seed <- 1..300, wait <- [100, 4_900] do
      world = LossyVehicle.submit(LossyVehicle.new(:ardupilot, seed), calibrate("s#{seed}n1"), 8_375)
      world = %{LossyVehicle.advance(world, 4_000) | loss: 0.6}
      world = world |> LossyVehicle.cancel("s#{seed}n1") |> LossyVehicle.advance(wait)
      world = LossyVehicle.submit(world, command("calibrate_cancel", %{}, "s#{seed}n2"), 10_097)
      assert world |> LossyVehicle.advance(700_000) |> LossyVehicle.wrong() == []
    end
  end

  defp calibrate(id), do: command("calibrate", %{"sensor" => "magnetometer"}, id)

  @tag :long
  test "the same, three thousand times" do
    assert :proper.quickcheck(property(), [:quiet, numtests: 3_000, max_size: 80]) == true,
           "#{counterexample()}"
  end
end
