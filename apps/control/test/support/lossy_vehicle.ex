defmodule Aerie.LossyVehicle do
  @moduledoc """
  A vehicle behind a bad link, and the executor in front of it, as one pure value: frames are lost, late, doubled and overtake
  each other; the vehicle reboots, refuses, says nothing, says what is not true. What it did is written down and compared with
  what it was said to have done.

  What a vehicle does with a command depends on the command only (`temper/2`), so that a repetition is treated as the first
  time. It drops a frame that comes a second time with the same number, as a router of doubled links does.
  """

  import Bitwise

  alias Aerie.Vehicle.{Command, Firmware, Protocol}
  alias Aerie.Vehicle.Firmware.Modes
  alias Aerie.Control.CommandExecutor.Core
  alias MavCodec.Messages, as: M

  defstruct core: nil,
            now: 0,
            net: nil,
            seed: nil,
            number: 0,
            loss: 0.2,
            doubled: 0.1,
            delay: {5_000, 150_000},
            true_state: nil,
            awake_at: 0,
            seen_frames: MapSet.new(),
            running: %{},
            commands: %{},
            results: %{},
            last: %{},
            done: %{},
            done_at: %{},
            heard: nil,
            history: [],
            told: [],
            cancelling: false,
            ceasing: %{},
            wrong: []

  @ms 1_000
  @beat 1_000 * @ms

  @doc "A vehicle of a firmware, with the seed of its link."
  @spec new(:ardupilot | :px4, integer()) :: %__MODULE__{}
  def new(autopilot, seed) do
    vehicle = %{Aerie.CommandSamples.vehicle(autopilot) | seen: %{mode: 0, in_air: 0}}
    {core, []} = vehicle |> Core.new() |> Core.handle({:rtt, 200 * @ms})

    %__MODULE__{core: core, net: :gb_sets.new(), seed: :rand.seed_s(:exsss, seed), true_state: vehicle}
    |> remember()
    |> later(@beat, :beat)
  end

  @doc "Submits a command that may be sent for `ms` from now on."
  @spec submit(%__MODULE__{}, Command.t(), pos_integer()) :: %__MODULE__{}
  def submit(world, command, ms) do
    until = world.now + ms * @ms
    world = put_in(world.commands[command.id], {command, until, world.now})
    step(world, {:submit, command, until, world.now})
  end

  @spec cancel(%__MODULE__{}, String.t()) :: %__MODULE__{}
  def cancel(world, id) do
    world = step(%{world | cancelling: true}, {:cancel, id, world.now})
    %{world | cancelling: false}
  end

  @doc "The vehicle reboots: it forgets what it was at, and is silent for two seconds."
  @spec reboot(%__MODULE__{}) :: %__MODULE__{}
  def reboot(world) do
    state = world.true_state
    mode = if state.autopilot == :px4, do: "AUTO_LOITER", else: "STABILIZE"
    fresh = %{state | armed: false, in_air: false, mode: mode, boots: state.boots + 1, booted_at: world.now}
    remember(%{world | true_state: fresh, running: %{}, awake_at: world.now + 2_000 * @ms})
  end

  @doc "Lets so much time pass."
  @spec advance(%__MODULE__{}, pos_integer()) :: %__MODULE__{}
  def advance(world, ms), do: until(world, world.now + ms * @ms)

  defp until(world, time) do
    wake = Core.wake_at(world.core)
    arrival = if :gb_sets.is_empty(world.net), do: nil, else: world.net |> :gb_sets.smallest() |> elem(0)

    case [wake, arrival] |> Enum.reject(&is_nil/1) |> Enum.min(fn -> nil end) do
      next when next == nil or next > time -> %{world | now: max(world.now, time)}
      ^arrival -> world |> arrive() |> until(time)
      # Never in the past, or time would stand still.
      _wake -> %{world | now: max(world.now, wake)} |> tick() |> until(time)
    end
  end

  defp tick(world) do
    before = Core.wake_at(world.core)
    world = step(world, {:tick, world.now})
    if Core.wake_at(world.core) == before, do: raise("a tick at #{world.now} changes nothing"), else: world
  end

  defp arrive(world) do
    {{time, _number, what}, net} = :gb_sets.take_smallest(world.net)
    happen(%{world | now: max(world.now, time), net: net}, what)
  end

  defp step(world, event) do
    {core, actions} = Core.handle(world.core, event)
    Enum.reduce(actions, %{world | core: core}, &act/2)
  end

  # To cease is another order: it may come after the deadline, and is not the command once more.
  defp act({:send, messages, id}, %{cancelling: true} = world) do
    Enum.reduce(messages, put_in(world.ceasing[id], messages), fn
      %M.CommandCancel{} = message, world -> transmit(world, {:to_vehicle, id, message})
      message, world -> transmit(world, {:to_vehicle, "cancel of " <> id, message})
    end)
  end

  # Asked once more.
  defp act({:send, messages, id}, %{ceasing: ceasing} = world) when :erlang.map_get(id, ceasing) == messages,
    do: act({:send, messages, id}, %{world | cancelling: true}) |> Map.put(:cancelling, false)

  defp act({:send, messages, id}, world) do
    {_command, until, _at} = world.commands[id]
    # What was overridden is given back at the end.
    given_back? = is_struct(hd(messages), M.RcChannelsOverride)

    world =
      if world.now >= until and not given_back?, do: wrong(world, id, "sent after its deadline"), else: world

    world = put_in(world.last[id], number(hd(messages)))
    Enum.reduce(messages, world, &transmit(&2, {:to_vehicle, id, &1}))
  end

  defp act({:result, result}, world) do
    world = if world.results[result.id], do: wrong(world, result.id, "two results"), else: world
    put_in(world.results[result.id], {result, world.now, world.heard})
  end

  defp act({:progress, _id, %{"progress" => _share, "text" => _text}}, world), do: world
  defp act({:alone, true}, world), do: step(world, {:alone, world.now})
  defp act({:alone, false}, world), do: world
  defp act({:not_cancelled, _id, _reason}, world), do: world
  defp act({:duplicate, _id}, world), do: world

  defp wrong(world, id, what), do: %{world | wrong: [{id, what} | world.wrong]}

  # --- The link

  defp transmit(world, frame) do
    {lost, world} = chance(world, world.loss)
    {twice, world} = chance(world, world.doubled)
    number = world.number
    world = %{world | number: number + 1}

    cond do
      lost -> world
      twice -> world |> deliver({frame, number}) |> deliver({frame, number})
      true -> deliver(world, {frame, number})
    end
  end

  defp deliver(world, what) do
    {least, most} = world.delay
    {share, seed} = :rand.uniform_s(world.seed)
    later(%{world | seed: seed}, least + round(share * (most - least)), what)
  end

  defp later(world, us, what) do
    entry = {world.now + us, world.number, what}
    %{world | net: :gb_sets.add(entry, world.net), number: world.number + 1}
  end

  defp chance(world, share) do
    {drawn, seed} = :rand.uniform_s(world.seed)
    {drawn < share, %{world | seed: seed}}
  end

  # --- What happens

  defp happen(world, :beat), do: world |> later(@beat, :beat) |> beat()
  defp happen(world, {:effect, id, message, boots}), do: if_same_boot(world, boots, &effect(&1, id, message))

  defp happen(world, {:ack, message, fields, boots}),
    do: if_same_boot(world, boots, &ack(&1, message, fields))

  defp happen(world, {:update, id, message, left, boots}),
    do: if_same_boot(world, boots, &running(&1, id, message, left))

  defp happen(world, {:in_air, boots}),
    do: if_same_boot(world, boots, &(&1 |> change(%{in_air: true}) |> beat()))

  defp happen(world, {{:to_vehicle, id, message}, number}) do
    if world.now < world.awake_at or number in world.seen_frames do
      world
    else
      obey(%{world | seen_frames: MapSet.put(world.seen_frames, number)}, id, message)
    end
  end

  defp happen(world, {{:to_us, component, %module{} = message}, _number}) do
    world = %{world | told: [{world.now, module.id()} | world.told]}
    step(world, {:message, message, {1, component}, world.now})
  end

  defp happen(world, {{:state, left, changes, groups}, _number}) do
    # What was said before a reboot and comes after it is of another life.
    if changes.boots >= world.core.vehicle.boots,
      do: step(%{world | heard: {left, changes}}, {:observed, changes, groups, world.now}),
      else: world
  end

  defp if_same_boot(%{true_state: %{boots: boots}} = world, boots, fun), do: fun.(world)
  defp if_same_boot(world, _boots, _fun), do: world

  defp beat(%{now: now, awake_at: awake} = world) when now < awake, do: world

  defp beat(world) do
    changes =
      Map.take(world.true_state, [:armed, :in_air, :mode, :home, :mission_seq, :boots, :booted_at, :lat, :lon])

    transmit(world, {:state, world.now, changes, [:mode, :in_air, :home, :mission, :position]})
  end

  # --- The vehicle

  @doc "What this vehicle does with this command."
  @spec temper(String.t(), struct()) :: atom()
  def temper(id, message) do
    case :erlang.phash2({id, number(message)}, 100) do
      n when n < 55 -> :obeys
      n when n < 65 -> :refuses
      n when n < 73 -> :takes_long
      n when n < 79 -> :obeys_silently
      n when n < 85 -> :ignores
      n when n < 91 -> :lies
      n when n < 95 -> :accepts_then_refuses
      n when n < 98 -> :wants_int
      _rest -> :broadcasts
    end
  end

  defp number(%{command: number}), do: number
  defp number(%module{}), do: module.id()

  defp obey(world, id, %M.CommandCancel{command: number} = message) do
    case world.running do
      %{{^id, ^number} => true} ->
        world = update_in(world.running, &Map.delete(&1, {id, number}))
        ack(world, message, result: 6)

      _idle ->
        world
    end
  end

  defp obey(world, id, %module{} = message) when module in [M.CommandLong, M.CommandInt] do
    boots = world.true_state.boots
    key = {id, message.command}

    case temper(id, message) do
      _any when is_map_key(world.running, key) ->
        ack(world, message, result: 1)

      :obeys ->
        world |> effect(id, message) |> ack(message, result: 0)

      :broadcasts ->
        world |> effect(id, message) |> ack(message, result: 0, target_system: 0, target_component: 0)

      :refuses ->
        ack(world, message, result: 1 + rem(message.command, 4))

      :obeys_silently ->
        effect(world, id, message)

      :ignores ->
        world

      :lies ->
        if shows?(message), do: ack(world, message, result: 0), else: world

      :accepts_then_refuses ->
        accept_then_refuse(world, id, message, boots)

      :wants_int when module == M.CommandLong ->
        ack(world, message, result: 8)

      :wants_int ->
        world |> effect(id, message) |> ack(message, result: 0)

      :takes_long ->
        %{world | running: Map.put(world.running, key, true)} |> running(id, message, 3)
    end
  end

  # Messages of their own are not answered.
  defp obey(world, id, message),
    do: if(temper(id, message) == :ignores, do: world, else: effect(world, id, message))

  # Only a mode is answered twice.
  defp accept_then_refuse(world, _id, %{command: 176} = message, boots),
    do: world |> ack(message, result: 0) |> later(7 * @ms, {:ack, message, [result: 1], boots})

  defp accept_then_refuse(world, id, message, _boots),
    do: world |> effect(id, message) |> ack(message, result: 0)

  defp running(world, id, message, left) do
    key = {id, message.command}

    cond do
      not is_map_key(world.running, key) ->
        world

      left == 0 ->
        update_in(world.running, &Map.delete(&1, key)) |> effect(id, message) |> ack(message, result: 0)

      true ->
        world
        |> ack(message, result: 5, progress: 100 - left * 25)
        |> later(400 * @ms, {:update, id, message, left - 1, world.true_state.boots})
    end
  end

  defp ack(world, message, fields) do
    ack = %M.CommandAck{command: number(message), target_system: 237, target_component: 191}
    transmit(world, {:to_us, message.target_component, struct!(ack, fields)})
  end

  defp shows?(message), do: number(message) in [400, 176, 224]

  defp effect(world, id, message) do
    world = update_in(world.done[{id, number(message)}], &((&1 || 0) + 1))
    world = put_in(world.done_at[id], world.now)
    state = world.true_state
    px4? = state.autopilot == :px4

    case {number(message), message} do
      {400, m} ->
        world |> change(%{armed: p(m, 1) == 1.0}) |> beat()

      {176, m} ->
        custom = if px4?, do: trunc(p(m, 2)) <<< 16 ||| trunc(p(m, 3)) <<< 24, else: trunc(p(m, 2))
        world |> change(%{mode: Modes.name(state.autopilot, "copter", 1, custom)}) |> beat()

      {20, _m} ->
        mode(world, if(px4?, do: "AUTO_RTL", else: "RTL"))

      {21, _m} ->
        mode(world, if(px4?, do: "AUTO_LAND", else: "LAND"))

      {192, _m} ->
        mode(world, if(px4?, do: "AUTO_LOITER", else: "GUIDED"))

      {34, _m} ->
        mode(world, "POSCTL_ORBIT")

      {300, _m} ->
        mode(world, "AUTO")

      {22, _m} ->
        later(world, 1_500 * @ms, {:in_air, state.boots})

      {179, %M.CommandInt{} = m} ->
        change(world, %{home: %{lat: m.x / 1.0e7, lon: m.y / 1.0e7, alt_msl: m.z}})

      {179, _m} ->
        change(world, %{home: %{lat: state.lat, lon: state.lon, alt_msl: 0.0}})

      {224, m} ->
        change(world, %{mission_seq: trunc(p(m, 1))})

      {41, m} ->
        change(world, %{mission_seq: m.seq})

      {246, _m} ->
        reboot(world)

      {512, m} ->
        told(world, trunc(p(m, 1)))

      {48, _m} ->
        transmit(world, {:to_us, 1, %M.GpsGlobalOrigin{}})

      _nothing_to_see ->
        world
    end
  end

  defp told(world, 148), do: transmit(world, {:to_us, 1, %M.AutopilotVersion{}})
  defp told(world, _other), do: world

  defp p(message, n), do: Map.fetch!(message, :"param#{n}")
  defp mode(world, mode), do: world |> change(%{mode: mode}) |> beat()
  defp change(world, changes), do: remember(%{world | true_state: struct!(world.true_state, changes)})
  defp remember(world), do: %{world | history: [{world.now, world.true_state} | world.history]}

  # --- What was right

  @doc "All that is wrong with what the vehicle was sent and what was said of it, once all commands have results."
  @spec wrong(%__MODULE__{}) :: [{String.t(), String.t()}]
  def wrong(world) do
    world.wrong ++
      for {id, {command, _until, at}} <- world.commands, what <- judge(world, command, at), do: {id, what}
  end

  defp judge(world, command, at) do
    case world.results[command.id] do
      nil ->
        ["no result"]

      {result, answered_at, heard} ->
        times = times(world, command)

        [
          Command.type(command).retry == :never and times > 1 and "done #{times} times",
          false?(result, times, world, command, {at, answered_at, heard}) and
            "#{command.type}: #{result.status} (#{result.reason}), but it was done #{times} times"
        ]
        |> Enum.filter(& &1)
    end
  end

  # Steps before the last only prepare it. What resumes depends on the mode that it had then.
  defp times(world, %{type: "resume"} = command),
    do: Map.get(world.done, {command.id, Map.get(world.last, command.id)}, 0)

  defp times(world, command) do
    {:ok, steps} = plan(command, world.true_state)
    number = steps |> List.last() |> number_of()
    Map.get(world.done, {command.id, number}, 0)
  end

  defp plan(command, vehicle) do
    # As it was when it could be planned.
    able = %{
      vehicle
      | mode: nil,
        armed: command.type != "calibrate_cancel",
        in_air: command.type != "takeoff",
        home: vehicle.home || %{lat: 0.0, lon: 0.0, alt_msl: 0.0}
    }

    case Protocol.plan(Firmware.of(vehicle.autopilot), command, able) do
      {:ok, steps} -> {:ok, steps}
      {_gap_or_error, _reason} -> {:ok, [%Protocol.Step{key: :none, forms: [{:long, 0, []}]}]}
    end
  end

  defp number_of(%{forms: [form | _others]}) do
    case form do
      {:long, number, _params} -> number
      {:int, number, _frame, _params, _place, _z} -> number
      {:message, %module{}} -> module.id()
    end
  end

  defp false?(%{status: :completed}, times, world, command, {from, to, _heard}),
    do: times == 0 and not was_so?(world, command, {from, to})

  defp false?(%{status: :accepted} = result, times, _world, command, _span),
    do: times == 0 and result.details["acknowledged"] and Command.type(command).group != :manual

  # Done, and undone by another command before its state was heard.
  defp false?(%{status: :failed} = result, times, world, command, {_from, _to, heard}),
    do: times > 0 and not (result.details["acknowledged"] and undone?(world, command, heard))

  defp false?(%{status: :cancelled, details: %{"sent" => sent}}, times, _world, _command, _span),
    do: times > 0 and sent == 0

  defp false?(%{status: status}, times, _world, _command, _span) when status in [:rejected, :expired],
    do: times > 0

  defp false?(_unknown_or_timeout, _times, _world, _command, _span), do: false

  # Somebody else's command may have brought it about.
  defp was_so?(world, %{type: "reboot"}, span) do
    boots = world |> states(span) |> Enum.map(& &1.boots)
    Enum.max(boots) > Enum.min(boots)
  end

  defp was_so?(world, %{type: "request_message", params: %{message_id: wanted}}, {from, to}),
    do: Enum.any?(world.told, fn {at, told} -> told == wanted and at in from..to end)

  # ArduPilot's calibration of compass and motors, the only one that is confirmed, is over when it is disarmed.
  defp was_so?(%{true_state: %{autopilot: :ardupilot}} = world, %{type: "calibrate_cancel"}, span),
    do: Enum.any?(states(world, span), &(&1.armed == false))

  defp was_so?(world, command, span), do: Enum.any?(states(world, span), &met?(world, command, &1))

  # What was heard last left the vehicle when it had done it, and does not show it.
  defp undone?(_world, _command, nil), do: false

  defp undone?(world, command, {left, changes}) do
    left >= world.done_at[command.id] and not met?(world, command, struct!(world.true_state, changes))
  end

  defp met?(world, command, state) do
    {:ok, steps} = plan(command, world.true_state)
    %{confirm: condition} = List.last(steps)
    condition not in [nil, :told] and Protocol.Condition.met?(condition, state)
  end

  # The states from one time to another, with the one that it began with.
  defp states(world, {from, to}) do
    {during, before} =
      world.history
      |> Enum.filter(fn {at, _state} -> at <= to end)
      |> Enum.split_while(fn {at, _state} -> at > from end)

    Enum.map(during ++ Enum.take(before, 1), &elem(&1, 1))
  end
end
