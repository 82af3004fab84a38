defmodule Protocols.Mission.LossyTest do
  @moduledoc "Transfers before vehicles that lose, delay, double, refuse, give up and reboot: `Aerie.LossyPlans`."
  use ExUnit.Case, async: true

  alias Aerie.LossyPlans
  alias Protocols.Mission.Item

  @runs 500

  defp items(count, salt), do: for(n <- 1..count//1, do: %Item{command: 16, frame: 3, x: n, y: salt, z: 10.0})

  defp scenario do
    import :proper_types, only: [oneof: 1, integer: 2, tuple: 1]

    tuple([
      oneof([:ardupilot, :px4]),
      oneof([:upload, :upload, :clear, :download]),
      integer(0, 40),
      integer(0, 40),
      oneof([0.0, 0.1, 0.25, 0.4]),
      oneof([0.0, 0.1, 0.3]),
      oneof([{1, 5}, {5, 150}, {50, 400}]),
      oneof([nil, 20_000, 300_000]),
      oneof([nil, {:count, 4}, {:item, 3}]),
      oneof([:nothing, :nothing, {:cancel, integer(0, 3_000)}, {:reboot, integer(0, 3_000)}]),
      oneof([false, false, true]),
      tuple([oneof([1_000, 20_000, 600_000]), integer(1, 1_000_000)])
    ])
  end

  defp run({style, op, old, count, loss, doubled, delay, rtt, refuse, happens, reject, {ms, seed}}) do
    {old, new} = {items(old, 1), items(count, 2)}

    world =
      LossyPlans.new(style, old,
        loss: loss,
        doubled: doubled,
        delay: delay,
        refuse: refuse,
        reject_after: reject and style == :px4,
        seed: seed
      )

    operation = if op == :upload, do: {:upload, new}, else: op
    world = LossyPlans.start(world, operation, 0, ms: ms, rtt: rtt)

    world =
      case happens do
        :nothing -> world
        {what, after_ms} -> LossyPlans.soon(world, after_ms, what)
      end

    world = LossyPlans.finish(world)
    {world, old, if(op == :upload, do: new, else: if(op == :clear, do: [], else: old))}
  end

  # What the result says, compared with what the vehicle has: at the end, and when everything arrived that was on its way.
  defp true?(world, old, new) do
    later = LossyPlans.settle(world, 30_000)

    whole = Enum.all?(later.plans, &(&1 in [old, new]))

    said =
      case {world.result.status, world.result.on_board} do
        {:completed, :new} ->
          same?(later, new) and (new == [] or not later.reject_after)

        {:accepted, :new} ->
          same?(later, new)

        {_other, :new} ->
          same?(later, new)

        {:completed, :read} ->
          world.result.items == old

        {status, :old} when status != :completed ->
          same?(later, old)

        {status, :other} when status != :completed ->
          later.plan == world.result.items and not same?(later, new)

        {status, :unknown} ->
          status in [:timeout, :unknown, :cancelled, :rejected, :expired]

        _wrong ->
          false
      end

    whole and said
  end

  # Item 0 of an ArduPilot's mission is not part of it (W8).
  defp same?(%{style: :ardupilot, plan: plan}, items), do: Enum.drop(plan, 1) == Enum.drop(items, 1)
  defp same?(%{plan: plan}, items), do: plan == items

  test "the result is what the vehicle has, whatever happens" do
    property =
      :proper.forall(scenario(), fn case ->
        {world, old, new} = run(case)
        true?(world, old, new)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: @runs, max_size: 40]) == true,
           "counterexample: #{inspect(:proper.counterexample())}"
  end
end
