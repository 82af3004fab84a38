defmodule Aerie.LossyPlans do
  @moduledoc """
  A vehicle with a plan behind a bad link, and a transfer in front of it, as one pure value: frames are lost, late and doubled and
  overtake each other; the vehicle refuses, gives up and reboots. It replaces its plan only when an upload is complete, and
  writes down each plan that it ever had.
  """

  alias Aerie.Vehicle.Firmware
  alias Protocols.Mission.{Item, Reply, Transfer, Upload}
  alias MavCodec.Messages, as: M

  @ms 1_000
  @us {237, 191}
  @vehicle {1, 1}
  # PX4 asks again sooner.
  @rules %{
    ardupilot: %{request: M.MissionRequest, again_us: 900_000, patience_us: 8_000_000, out_of_turn: :refuse},
    px4: %{again_us: 200_000, patience_us: 8_000_000, out_of_turn: :ask_unless_repeated}
  }

  defstruct [:style, :transfer, :seed, :result] ++
              [
                now: 0,
                net: nil,
                number: 0,
                loss: 0.0,
                doubled: 0.0,
                delay: {1, 30},
                plan: [],
                upload: nil,
                asleep_until: 0,
                refuse: nil,
                reject_after: false,
                opaque: 0,
                sent: 0,
                plans: []
              ]

  def new(style, plan, options) do
    world =
      struct!(
        %__MODULE__{style: style, net: :gb_sets.new(), plan: plan, plans: [plan]},
        Keyword.delete(options, :seed)
      )

    %{world | seed: :rand.seed_s(:exsss, options[:seed] || 1)} |> later(1_000 * @ms, :beat)
  end

  @doc "Starts a transfer that has so many ms."
  def start(world, op, type \\ 0, options \\ []) do
    {:ok, transfer} =
      Transfer.new(op, type,
        protocol: Firmware.of(world.style),
        kind: "copter",
        target: @vehicle,
        us: @us,
        until: world.now + (options[:ms] || 600_000) * @ms,
        rtt: options[:rtt],
        item_us: options[:item_us] || 0
      )

    step(%{world | transfer: transfer, result: nil}, {:start, world.now})
  end

  @doc "Something that happens so many ms from now: `:cancel`, `:reboot`, or `{:plan, items}` of another ground station."
  def soon(world, ms, what), do: later(world, ms * @ms, what)

  @doc "Runs to the end of the transfer."
  def finish(%{result: nil} = world) do
    wake = Transfer.wake_at(world.transfer)
    {{at, _n, what}, net} = :gb_sets.take_smallest(world.net)

    if wake != nil and wake <= at do
      world = %{world | now: max(wake, world.now)}
      finish(step(world, {:tick, world.now}))
    else
      finish(happens(%{world | net: net, now: max(at, world.now)}, what))
    end
  end

  def finish(world), do: world

  @doc "Lets everything arrive that is on its way."
  def settle(world, ms), do: settle_until(world, world.now + ms * @ms)

  defp settle_until(world, time) do
    case :gb_sets.is_empty(world.net) || :gb_sets.smallest(world.net) do
      {at, _n, what} when at <= time ->
        {_event, net} = :gb_sets.take_smallest(world.net)
        settle_until(happens(%{world | net: net, now: max(at, world.now)}, what), time)

      _later ->
        %{world | now: time}
    end
  end

  # --- The two ends

  defp step(world, event) do
    {transfer, actions} = Transfer.handle(world.transfer, event)
    Enum.reduce(actions, %{world | transfer: transfer}, &act/2)
  end

  defp act({:send, message}, world), do: post(%{world | sent: world.sent + 1}, {:to_vehicle, message})
  defp act({:result, result}, world), do: %{world | result: result}
  defp act({:progress, _progress}, world), do: world

  defp happens(world, :beat) do
    world |> beat() |> later(250 * @ms, :beat)
  end

  defp happens(world, :cancel), do: step(world, {:cancel, world.now})
  defp happens(world, {:plan, items}), do: store(world, items)

  # Half of the reboots are noticed.
  defp happens(world, :reboot) do
    {number, world} = random(world)
    world = %{world | upload: nil, asleep_until: world.now + 2_000 * @ms}
    if number < 0.5, do: step(world, {:rebooted, world.now}), else: world
  end

  defp happens(world, {:to_us, message}), do: step(world, {:message, message, @vehicle, world.now})
  defp happens(%{now: now, asleep_until: until} = world, {:to_vehicle, _message}) when now < until, do: world
  defp happens(world, {:to_vehicle, message}), do: hear(world, message)

  # --- The vehicle

  defp hear(world, %M.MissionRequestList{mission_type: type}) do
    say(world, Reply.count(type, length(world.plan), @us, world.opaque))
  end

  defp hear(world, %M.MissionRequestInt{seq: seq, mission_type: type}) do
    case Enum.at(world.plan, seq) do
      nil -> if(world.style == :ardupilot, do: ack(world, :INVALID_SEQUENCE, type), else: world)
      item -> say(world, Item.message(item, seq, type, @us))
    end
  end

  defp hear(%{refuse: {:count, result}} = world, %M.MissionCount{mission_type: type}),
    do: ack(world, result, type)

  defp hear(world, %M.MissionCount{} = m), do: upload(world, {:count, m, @us})

  defp hear(world, %M.MissionItemInt{mission_type: type} = m) do
    if world.refuse == {:item, m.seq} and Upload.expects?(world.upload, m, @us),
      do: ack(%{world | upload: nil}, 5, type),
      else: upload(world, {:item, m, @us})
  end

  defp hear(world, %M.MissionClearAll{mission_type: type}) do
    if world.upload, do: ack(world, :DENIED, type), else: world |> store([]) |> ack(:ACCEPTED, type)
  end

  defp hear(world, %M.MissionAck{type: type}) when type != 0, do: upload(world, {:cancelled, @us})
  defp hear(world, _other), do: world

  defp upload(world, event) do
    {upload, actions} = Upload.handle(world.upload, event, @rules[world.style], world.now)
    Enum.reduce(actions, %{world | upload: upload}, &uploaded/2)
  end

  defp uploaded({:send, message}, world), do: say(world, message)
  defp uploaded(:stray, %{style: :ardupilot} = world), do: ack(world, :ERROR, 0)
  defp uploaded(:stray, world), do: world

  defp uploaded({:store, items}, %{upload: %{type: type}} = world) do
    world = %{world | upload: nil} |> store(Enum.map(items, &Item.read/1)) |> ack(:ACCEPTED, type)
    if world.reject_after, do: say(world, %M.Event{id: 22_271_714, log_levels: 0x63}), else: world
  end

  defp store(world, items) do
    opaque = if world.style == :px4 and items != [], do: :erlang.phash2(items) + 1, else: 0
    %{world | plan: items, opaque: opaque, plans: [items | world.plans]}
  end

  defp beat(%{now: now, asleep_until: until} = world) when now < until, do: world

  defp beat(world) do
    state = if world.reject_after or world.plan == [], do: 1, else: 2

    world =
      if world.style == :px4,
        do: say(world, %M.MissionCurrent{mission_id: world.opaque, mission_state: state}),
        else: world

    upload(world, :tick)
  end

  defp ack(world, result, type),
    do: say(world, Reply.ack(type, result, @us, if(result == :ACCEPTED, do: world.opaque, else: 0)))

  defp say(world, message), do: post(world, {:to_us, message})

  # --- The link

  defp post(world, what) do
    {lost, world} = random(world)
    {twice, world} = random(world)

    cond do
      lost < world.loss -> world
      twice < world.doubled -> world |> on_its_way(what) |> on_its_way(what)
      true -> on_its_way(world, what)
    end
  end

  defp on_its_way(world, what) do
    {from, to} = world.delay
    {share, world} = random(world)
    later(world, from * @ms + round(share * (to - from) * @ms), what)
  end

  defp later(world, us, what) do
    number = world.number + 1
    %{world | number: number, net: :gb_sets.add({world.now + us, number, what}, world.net)}
  end

  defp random(world) do
    {share, seed} = :rand.uniform_s(world.seed)
    {share, %{world | seed: seed}}
  end
end
