defmodule Aerie.Control.Policy.Mavlink.Writing do
  @moduledoc """
  Plans that clients write, judged whole: a mission by its ways (`Aerie.Control.Policy.Mavlink.Review`) once the
  vehicle may have all of its items, and a fence by whether it keeps all that the vehicle's fence kept
  (`Aerie.Control.Policy.Fence.Kept`). And a mission
  that is entered: the way there from where the vehicle is, and on from there.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, Roles}
  alias Aerie.Control.Policy.Memory.ClientHistory
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Fence.Kept
  alias Aerie.Control.Policy.FlightPath.Shaping
  alias Aerie.Control.Policy.Mavlink.{Review, Upload}
  alias Aerie.Control.Policy.Mavlink.Writing.{Aboard, RawPlan}
  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Vehicle.Firmware
  alias Protocols.Mission.Item
  alias MavCodec.Messages.{MissionClearAll, MissionCount}

  @mission 0
  @fence 1
  @all_types 255
  # A vehicle gives an upload up long before.
  @upload_us 600_000_000

  @doc """
  The facts of an item with the way from the item before it; from an unknown place when there was no room to remember
  that. A vehicle that was not heard yet takes no items.
  """
  @spec on_the_way(Intent.t(), struct(), Names.gateway(), map(), map() | nil) :: Intent.t()
  def on_the_way(%{type: "mission_upload"} = facts, message, gateway, sender, %{key: key}) do
    now = System.monotonic_time(:microsecond)

    next = fn last ->
      case Upload.next(last, message, facts) do
        {facts, ^last} -> {:keep, facts}
        {facts, nil} -> {:put, facts, nil, now}
        {facts, item} -> {:put, facts, item, now + @upload_us}
      end
    end

    case ClientHistory.update(gateway, {sender.principal.name, :upload, {sender.endpoint, key}}, now, next) do
      :full -> %{facts | path: :anywhere}
      facts -> facts
    end
  end

  def on_the_way(%{type: "mission_upload", path: path} = facts, _message, _gateway, _sender, nil)
      when path != :none,
      do: %{facts | path: :anywhere}

  def on_the_way(facts, _message, _gateway, _sender, _snapshot), do: facts

  @doc "Judges a message that writes a plan, which the rules allow by itself, and remembers it."
  @spec written(Policy.t(), Names.gateway(), map() | nil, struct(), Intent.t(), Context.t()) ::
          Policy.decision()
  def written(_policy, _gateway, nil, _message, _facts, _context), do: :allow

  def written(policy, gateway, %{key: key} = snapshot, message, facts, context) do
    case plan(message, facts, snapshot) do
      nil ->
        :allow

      {type, part} ->
        now = System.monotonic_time(:microsecond)
        aboard = fn -> Aboard.items(gateway, key, type) end

        step = fn plan ->
          {decision, plan, sent} = step(plan, message, aboard, {policy, snapshot, context}, now)
          {:put, {decision, sent}, plan, now + @upload_us}
        end

        case ClientHistory.update(gateway, {{:vehicle, key}, :raw_plan, {type, part}}, now, step) do
          {decision, :same} -> decision
          {decision, sent} -> sent(decision, gateway, {key, type}, sent)
          :full -> Refusal.deny(:plans_many)
        end
    end
  end

  defp sent(decision, gateway, {key, type}, items) do
    if items, do: Aboard.sent(gateway, key, type, items), else: Aboard.unsent(gateway, key, type)
    decision
  end

  @doc "The kind of plan that a message writes, and for which part of the vehicle; nil for none that is judged whole."
  @spec plan(struct(), Intent.t(), map()) :: {0..1, :autopilot | 0..255} | nil
  def plan(%MissionClearAll{mission_type: @all_types} = message, facts, snapshot),
    do: plan(%{message | mission_type: @mission}, facts, snapshot)

  # The autopilot answers to 0 as well; what is for another part is another plan.
  def plan(%{mission_type: type, target_component: component}, %{type: kind}, snapshot)
      when type in [@mission, @fence] and kind in ["mission_upload", "fence_upload"],
      do: {type, if(component in [0, snapshot.component || 1], do: :autopilot, else: component)}

  def plan(_message, _facts, _snapshot), do: nil

  @doc """
  The decision about a message, the plan after it, and what is known to be sent whole since: its items, nil for
  nothing, `:same`.
  """
  @spec step(
          RawPlan.t() | nil,
          struct(),
          (-> {:ok, [Item.t()]} | :unknown),
          {Policy.t(), map(), Context.t()},
          integer()
        ) ::
          {Policy.decision(), RawPlan.t() | nil, [Item.t()] | nil | :same}
  def step(plan, %{mission_type: type} = message, aboard, {policy, _snapshot, context} = about, now) do
    judged? =
      if type == @fence, do: not Roles.allowed?(context.source, :protection), else: Shaping.limited?(policy)

    # Nothing has to be known to let it pass.
    aboard = if judged?, do: aboard, else: fn -> {:ok, []} end

    with {:ok, new} <- RawPlan.take(plan, message, aboard, now),
         flown? = judged? and in_place?(message, context),
         {:ok, new} <- if(flown?, do: RawPlan.flown(new, plan, aboard), else: {:ok, new}) do
      {lists, own} = RawPlan.wholes(new)

      case if(judged?, do: judged(new, lists, message, about), else: :allow) do
        :allow when own != nil -> {:allow, RawPlan.done(new), own}
        :allow -> {:allow, new, if(is_map_key(message, :seq), do: :same)}
        {:deny, rule, _seq, reason} -> {{:deny, rule, reason}, plan, :same}
      end
    else
      {:deny, reason} when judged? ->
        {{:deny, if(type == @fence, do: :role, else: rule(policy)), reason}, plan, :same}

      {:deny, _reason} ->
        {:allow, nil, nil}
    end
  end

  defp in_place?(%MissionCount{mission_type: @mission}, context) do
    not Firmware.reading(context.autopilot).plan_whole? and context.in_air != false and
      Intent.mission_mode?(context.mode)
  end

  defp in_place?(_message, _context), do: false

  defp judged(%{flown: [_ | _]} = plan, lists, %{seq: seq} = message, {policy, snapshot, context} = about) do
    vehicle = Map.take(snapshot, [:autopilot, :vehicle_type])

    with :allow <- Review.onward(policy, RawPlan.mixed(plan), max(seq - 1, 0), vehicle, context),
         do: judged(%{plan | flown: nil}, lists, message, about)
  end

  defp judged(plan, lists, _message, about),
    do: Enum.find_value(lists, :allow, fn items -> with :allow <- judge(plan, items, about), do: nil end)

  defp judge(%{before: nil}, items, {policy, snapshot, context}),
    do: Review.plan(policy, items, @mission, Map.take(snapshot, [:autopilot, :vehicle_type]), context)

  defp judge(%{before: before}, items, _about), do: kept(items, before)

  @doc "Whether a fence may be put in the place of another one without the permission to take it away."
  @spec kept(new :: [Item.t()], old :: [Item.t()]) ::
          :allow | {:deny, :role, nil, String.t()}
  def kept(new, old) do
    if Kept.by?(new, old),
      do: :allow,
      else: {:deny, :role, nil, Refusal.text(:fence_smaller)}
  end

  @doc "Judges a command by which a vehicle begins its mission, or goes on with it at another item."
  @spec entered(Policy.t(), Names.gateway(), map() | nil, Intent.t(), Context.t()) :: Policy.decision()
  def entered(_policy, _gateway, nil, _facts, _context), do: :allow

  def entered(policy, gateway, %{key: key} = snapshot, facts, context),
    do: enters(policy, snapshot, facts, context, fn -> Aboard.items(gateway, key, @mission) end)

  @doc "The same, with a function that gives the mission aboard."
  @spec enters(Policy.t(), map(), Intent.t(), Context.t(), (-> {:ok, [Item.t()]} | :unknown)) ::
          Policy.decision()
  def enters(_policy, _snapshot, %{enters: []}, _context, _aboard), do: :allow
  def enters(_policy, _snapshot, %{ends_flight?: true}, _context, _aboard), do: :allow

  def enters(policy, snapshot, facts, context, aboard) do
    with true <- Shaping.limited?(policy),
         {:ok, items} <- aboard.() do
      enter(policy, items, Enum.map(facts.enters, &present(&1, snapshot)), snapshot, context)
    else
      false ->
        :allow

      :unknown ->
        {:deny, rule(policy), Refusal.text(:mission_aboard_unknown, command: facts.type)}
    end
  end

  defp enter(policy, items, entries, snapshot, context) do
    vehicle = Map.take(snapshot, [:autopilot, :vehicle_type])

    with {:deny, rule, _seq, reason} <- Review.entered(policy, items, entries, vehicle, context),
         do: {:deny, rule, reason}
  end

  defp rule(%{fence: nil}), do: :altitude
  defp rule(_with_fence), do: :geofence

  # Where it is in its mission just now.
  defp present(:current, snapshot), do: {:item, get_in(snapshot.groups, [:mission, :data, :seq]) || 0}
  defp present(entry, _snapshot), do: entry
end
