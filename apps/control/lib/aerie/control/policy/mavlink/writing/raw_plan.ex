defmodule Aerie.Control.Policy.Mavlink.Writing.RawPlan do
  @moduledoc """
  A plan that clients write to a vehicle item by item: which items the vehicle may have of it. Pure.

  An item that comes again has to be the same, because a vehicle may keep the first one or the last one. That holds
  for uploads that were not finished as well, as long as the vehicle may wait for the rest of one: PX4 takes no
  notice of a MISSION_COUNT in the middle of an
  upload. A partial write replaces items of a plan that is known.
  """

  alias Protocols.Mission.{Item, Transfer}
  alias Aerie.Vehicle.Command.Refusal
  alias MavCodec.Messages, as: M

  @fence 1
  # ArduPilot gives up after 8 s, PX4 after 5 s.
  @given_up_us 10_000_000
  @given_up_s div(@given_up_us, 1_000_000)
  @most_begun 8

  defstruct [
    :count,
    :at,
    :before,
    :flown,
    items: %{},
    sent: %{},
    earlier: %{},
    counts: [],
    part: nil,
    next: 0,
    done?: false
  ]

  @typedoc """
  `:items` - by their numbers; `:sent` - those that came; `:earlier` - those of uploads that were not finished, and
  `:counts` how many these were to have; `:before` - the fence before it; `:flown` - the mission that
  the vehicle flies meanwhile; `:part` - the items of a partial write, which have to come in order; `:next` - the
  item that is due, in their order; `:done?` - all came, and were judged.
  """
  @type t :: %__MODULE__{
          count: non_neg_integer() | nil,
          at: integer() | nil,
          before: [Item.t()] | nil,
          flown: [Item.t()] | nil,
          items: %{non_neg_integer() => Item.t()},
          sent: %{non_neg_integer() => Item.t()},
          earlier: %{non_neg_integer() => Item.t()},
          counts: [non_neg_integer()],
          part: Range.t() | nil,
          next: non_neg_integer(),
          done?: boolean()
        }
  @type aboard :: (-> {:ok, [Item.t()]} | :unknown)

  @doc "The plan after a message; `aboard` is the vehicle's, for a partial write and for a fence."
  @spec take(t() | nil, struct(), aboard(), now :: integer()) :: {:ok, t()} | {:deny, String.t()}
  def take(plan, %M.MissionCount{count: count} = message, aboard, now) do
    cond do
      count > Transfer.limit() ->
        {:deny, Refusal.text(:plan_long, n: count, most: Transfer.limit())}

      length(begun(plan, now).counts) > @most_begun ->
        {:deny, Refusal.text(:uploads_begun, seconds: @given_up_s)}

      true ->
        counted(%{begun(plan, now) | count: count}, plan, message, aboard)
    end
  end

  def take(plan, %M.MissionWritePartialList{start_index: first, end_index: last} = m, aboard, now) do
    with {:ok, items} <- aboard.(),
         true <- first >= 0 and first <= last and last < length(items) do
      numbered = items |> Enum.with_index() |> Map.new(fn {item, seq} -> {seq, item} end)
      before = if m.mission_type == @fence, do: items
      plan = %{begun(plan, now) | count: length(items), items: numbered, before: before}
      {:ok, %{plan | next: first, part: first..last}}
    else
      :unknown ->
        {:deny, Refusal.text(:items_beside_unknown)}

      false ->
        {:deny, Refusal.text(:not_a_part)}
    end
  end

  def take(plan, %M.MissionClearAll{}, _aboard, now), do: {:ok, begun(plan, now)}

  def take(plan, %module{seq: seq} = message, _aboard, now)
      when module in [M.MissionItem, M.MissionItemInt] do
    item = item(message)
    plan = plan || %__MODULE__{}

    cond do
      seq >= (plan.count || Transfer.limit()) ->
        {:deny, Refusal.text(:item_beyond, seq: seq)}

      plan.part != nil and (seq not in plan.part or seq > plan.next) ->
        {:deny, Refusal.text(:item_not_due, seq: seq, next: plan.next)}

      Map.get(plan.sent, seq, item) != item ->
        {:deny, Refusal.text(:item_differs, seq: seq)}

      Map.get(plan.earlier, seq, item) != item ->
        {:deny, Refusal.text(:item_awaited, seq: seq, seconds: @given_up_s)}

      true ->
        next = if seq == plan.next, do: seq + 1, else: plan.next
        items = Map.put(plan.items, seq, item)
        {:ok, %{plan | at: now, next: next, items: items, sent: Map.put(plan.sent, seq, item)}}
    end
  end

  # A vehicle waits for nothing more of an upload that is done.
  defp begun(%{at: at, done?: false} = plan, now) when at != nil and now - at < @given_up_us do
    earlier = Map.merge(plan.earlier, plan.sent)
    counts = if earlier == %{}, do: [], else: Enum.uniq([plan.count | plan.counts]) -- [nil]
    %__MODULE__{at: now, earlier: earlier, counts: counts}
  end

  defp begun(_none_or_over, now), do: %__MODULE__{at: now}

  # A vehicle has its fence until the new one is whole.
  defp counted(new, plan, %{mission_type: @fence}, aboard) do
    case aboard.() do
      {:ok, before} ->
        {:ok, %{new | before: before}}

      :unknown when plan != nil and plan.before != nil and not plan.done? ->
        {:ok, %{new | before: plan.before}}

      :unknown ->
        {:deny, Refusal.text(:fence_unknown)}
    end
  end

  defp counted(new, _plan, _message, _aboard), do: {:ok, new}

  @doc "The plan for a vehicle that flies the one aboard: ArduPilot replaces it item by item, and flies what it has."
  @spec flown(t(), t() | nil, aboard()) :: {:ok, t()} | {:deny, String.t()}
  def flown(new, plan, aboard) do
    case aboard.() do
      {:ok, items} ->
        {:ok, %{new | flown: items}}

      :unknown when plan != nil and plan.flown != nil and not plan.done? ->
        {:ok, %{new | flown: plan.flown}}

      :unknown ->
        {:deny, Refusal.text(:flown_unknown)}
    end
  end

  @doc "What a vehicle flies that has taken some items of the plan: these, and the others of the mission that it has."
  @spec mixed(t()) :: [Item.t()]
  def mixed(%{flown: flown, count: count, items: items}) do
    old = for {item, seq} <- Enum.with_index(Enum.take(flown, count)), into: %{}, do: {seq, item}
    all = Map.merge(old, items)
    0..(count - 1)//1 |> Enum.take_while(&is_map_key(all, &1)) |> Enum.map(&all[&1])
  end

  @doc "The plan after all of it was judged. If its items came in another order, the vehicle may still wait for one."
  @spec done(t()) :: t()
  def done(plan),
    do: %{plan | done?: plan.next in [plan.count, plan.part && plan.part.last + 1] and plan.counts == []}

  @doc "All plans of which the vehicle may have each item now, and that of this upload, nil if it is not whole."
  @spec wholes(t()) :: {[[Item.t()]], [Item.t()] | nil}
  def wholes(%{sent: sent}) when sent == %{}, do: {[], nil}

  def wholes(plan) do
    own = list(plan.items, plan.count)
    others = for count <- plan.counts, list = list(Map.merge(plan.items, plan.earlier), count), do: list
    {Enum.uniq(List.wrap(own && [own]) ++ others), own}
  end

  defp list(_items, count) when count in [nil, 0], do: nil

  defp list(items, count) do
    list = for seq <- 0..(count - 1), is_map_key(items, seq), do: items[seq]
    if length(list) == count, do: list
  end

  defp item(%M.MissionItemInt{} = message), do: message |> Item.read() |> Item.rounded()

  defp item(%M.MissionItem{} = m) do
    scale = if Item.place?(m.command, m.frame), do: 1.0e7, else: 1
    fields = m |> Map.from_struct() |> Map.merge(%{x: scaled(m.x, scale), y: scaled(m.y, scale)})
    item(struct(M.MissionItemInt, fields))
  end

  defp scaled(value, by) when is_number(value) and abs(value) * by < 0x7FFFFFFF, do: round(value * by)
  defp scaled(_not_a_place, _by), do: 0x7FFFFFFF
end
