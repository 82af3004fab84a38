defmodule Aerie.Control.Mission.OwnFence.Ways do
  @moduledoc """
  The straight ways of a mission: from home to its first place, from place to place, by each jump as well, and home.
  Pure.
  """

  alias Aerie.Control.Policy.Mavlink.Review
  alias MavCodec.Enums.MavCmd
  alias Protocols.Mission.Item

  @jump MavCmd.value(:MAV_CMD_DO_JUMP)
  @jump_tag MavCmd.value(:MAV_CMD_DO_JUMP_TAG)
  @tag MavCmd.value(:MAV_CMD_JUMP_TAG)
  @rtl MavCmd.value(:MAV_CMD_NAV_RETURN_TO_LAUNCH)
  # Pairs of an item and the place where the vehicle is before it.
  @most 20_000

  @typedoc """
  In degrees; `index`: of the item that it leads to, or that sends the vehicle home; `name`: which way it is; `items`:
  its ends without home.
  """
  @type t :: %{from: place(), to: place(), items: [place()], index: non_neg_integer(), name: String.t()}
  @type place :: {number(), number()}

  @doc "All of them; `home`: nil if it is not known."
  @spec all([Item.t()], map(), place() | nil) :: [t()]
  def all(items, vehicle, home) do
    numbered = for {item, n} <- Enum.with_index(items), into: %{}, do: {n, item}
    tags = for {n, %{command: @tag, params: {tag, _, _, _}}} <- numbered, do: {tag, n}
    plan = %{items: numbered, tags: tags, vehicle: Map.take(vehicle, [:autopilot, :vehicle_type]), home: home}
    start = {0, if(home, do: {:home, home}), nil}
    [start] |> walk(%{}, plan, []) |> Enum.uniq_by(&{&1.from, &1.to})
  end

  # To do: an item, where the vehicle is before it, and the jump that led to it.
  defp walk([], _seen, _plan, found), do: Enum.reverse(found)

  defp walk([{n, from, _jump} = next | to_do], seen, plan, found) do
    if not is_map_key(plan.items, n) or is_map_key(seen, {n, from}) or map_size(seen) >= @most do
      walk(to_do, seen, plan, found)
    else
      {ways, more} = step(plan.items[n], next, plan)
      walk(more ++ to_do, Map.put(seen, {n, from}, true), plan, ways ++ found)
    end
  end

  # Items have their numbers from 1.
  defp step(%{command: @jump, params: {target, _, _, _}}, {n, from, jump}, _plan) when is_number(target),
    do: {[], [{n + 1, from, jump}, {trunc(target) - 1, from, n}]}

  defp step(%{command: @jump_tag, params: {tag, _, _, _}}, {n, from, jump}, %{tags: tags}),
    do: {[], [{n + 1, from, jump} | for({^tag, target} <- tags, do: {target, from, n})]}

  defp step(%{command: @rtl}, {n, from, jump}, %{home: home}),
    do: {way(from, home && {:home, home}, n, "the way home (item #{n + 1})"), [{n + 1, from, jump}]}

  defp step(item, {n, from, jump}, %{vehicle: vehicle}) do
    case Review.place(item, vehicle) do
      nil -> {[], [{n + 1, from, jump}]}
      place -> {way(from, {:item, place}, n, named(n, from, jump)), [{n + 1, {:item, place}, nil}]}
    end
  end

  defp named(n, {:home, _place}, _jump), do: "the way to item #{n + 1} from home"
  defp named(n, _from, nil), do: "the way to item #{n + 1}"
  defp named(n, _from, jump), do: "the way to item #{n + 1} by the jump of item #{jump + 1}"

  defp way({_, _} = from, {_, _} = to, n, name) do
    items = for {:item, place} <- [from, to], do: place
    [%{from: elem(from, 1), to: elem(to, 1), items: items, index: n, name: name}]
  end

  defp way(_from, _to, _n, _name), do: []
end
