defmodule Aerie.Console.Pages.Plan.Draft do
  @undo 100
  @max_items 2_000
  @limits Protocols.Mission.Plan.limits()

  @moduledoc """
  A plan that is being drawn: the plan, the part that is edited, the selection, and the undo history. A pure value.

  An invalid change is refused with the reason; one without an effect adds no undo step. The last #{@undo} steps can
  be undone.
  """

  alias Protocols.Mission.{Item, Plan}
  alias Aerie.Console.Pages.Plan.Kinds
  alias MavCodec.Enums.MavCmd

  @relative 3
  @jump MavCmd.value(:MAV_CMD_DO_JUMP)
  # A click creates a circle of so many metres.
  @radius 100.0
  @most_corners 200

  defstruct plan: %Plan{}, part: :mission, picked: nil, undo: [], redo: [], changed?: false, corners: []

  @type part :: :mission | :fence | :rally

  @typedoc "`corner`: of a polygon, from 0; of a circle, 0 is the centre and 1 the border; nil for the whole."
  @type target :: {part() | :home, index :: non_neg_integer(), corner :: non_neg_integer() | nil}

  @typedoc "Degrees."
  @type place :: {lat :: float(), lon :: float()}

  @type t :: %__MODULE__{
          plan: Plan.t(),
          part: part(),
          picked: {non_neg_integer(), non_neg_integer() | nil} | nil,
          undo: [Plan.t()],
          redo: [Plan.t()],
          changed?: boolean(),
          # The polygon that is being drawn, in the order of the clicks.
          corners: [Plan.position()]
        }

  @type result :: {:ok, t()} | {:error, String.t()}

  @doc "A draft of a plan from a file or a vehicle. Undo restores the previous drawing."
  @spec replace(t(), Plan.t()) :: t()
  def replace(draft, plan), do: %{step(draft, plan) | picked: nil, changed?: false, corners: []}

  @doc "Chooses the part that is edited."
  @spec part(t(), part()) :: t()
  def part(draft, part) when part in [:mission, :fence, :rally], do: %{draft | part: part, picked: nil}

  @doc "Selects something in the part that is edited; nil for nothing."
  @spec pick(t(), {non_neg_integer(), non_neg_integer() | nil} | nil) :: t()
  def pick(draft, {index, _corner} = picked) do
    if index < count(draft), do: %{draft | picked: picked}, else: draft
  end

  def pick(draft, nil), do: %{draft | picked: nil}

  @doc """
  Adds what a click on the map stands for: an item of a kind (MAV_CMD) after the selected one or at the end, a zone
  around the position
  (`{:inclusion | :exclusion, :circle}`), a corner of the polygon that is being drawn, or a rally point. `altitude`:
  metres above home.
  """
  @spec add(t(), place(), what :: term(), altitude :: float()) :: result()
  def add(draft, place, what, altitude)

  def add(%{part: :mission, plan: plan} = draft, place, command, altitude) when is_integer(command) do
    at = if match?({_, _}, draft.picked), do: elem(draft.picked, 0) + 1, else: length(plan.items)
    insert_item(draft, at, item(command, place, altitude))
  end

  def add(%{part: :fence} = draft, place, {kind, shape}, _altitude) when kind in [:inclusion, :exclusion] do
    with {:ok, position} <- position(place) do
      if shape == :circle,
        do: zone(draft, {kind, {:circle, position, @radius}}),
        else: corner(draft, position)
    end
  end

  def add(%{part: :rally, plan: plan} = draft, place, _what, altitude) do
    with :ok <- room(plan.rally, @limits.rally, "rally points"), {:ok, position} <- position(place) do
      done(draft, %{plan | rally: plan.rally ++ [{position, altitude / 1}]}, {length(plan.rally), nil})
    end
  end

  # A double click is one corner.
  defp corner(draft, position) do
    with :ok <- room(draft.corners, @most_corners, "corners in a zone") do
      corners = if position in draft.corners, do: draft.corners, else: draft.corners ++ [position]
      {:ok, %{draft | corners: corners, picked: nil, changed?: true}}
    end
  end

  defp zone(%{plan: plan} = draft, zone) do
    with :ok <- room(plan.fence, @limits.zones, "zones"),
         do: done(draft, %{plan | fence: plan.fence ++ [zone]}, {length(plan.fence), nil})
  end

  @doc "Goes on with the polygon that was being drawn on an earlier page; what is not one is left out."
  @spec resume(t(), term()) :: t()
  def resume(draft, [_ | _] = corners) do
    Enum.reduce(Enum.take(corners, @most_corners), %{draft | part: :fence}, fn
      [lat, lon], draft ->
        with {:ok, position} <- position({lat, lon}),
             {:ok, draft} <- corner(draft, position),
             do: draft,
             else: (_bad -> draft)

      _bad, draft ->
        draft
    end)
  end

  def resume(draft, _none), do: draft

  @doc "Makes a zone of the polygon that is being drawn."
  @spec close(t(), :inclusion | :exclusion) :: result()
  def close(%{corners: [_, _, _ | _] = corners} = draft, kind),
    do: zone(%{draft | corners: []}, {kind, {:polygon, corners}})

  def close(_draft, _kind), do: {:error, "a zone has at least three corners"}

  @doc "Removes the last corner of the polygon that is being drawn, or all of them."
  @spec drop(t(), :last | :all) :: t()
  def drop(draft, :last), do: %{draft | corners: Enum.drop(draft.corners, -1)}
  def drop(draft, :all), do: %{draft | corners: []}

  @doc "Adds an item without a position, such as a change of speed, after the selected one or at the end."
  @spec add_action(t(), command :: integer()) :: result()
  def add_action(draft, command) do
    at =
      if draft.part == :mission and draft.picked,
        do: elem(draft.picked, 0) + 1,
        else: length(draft.plan.items)

    insert_item(part(draft, :mission), at, %{Kinds.item(command) | frame: 2})
  end

  @doc "Moves a target."
  @spec move(t(), target(), place()) :: result()
  def move(%{plan: plan} = draft, target, place) do
    with {:ok, position} <- position(place), {:ok, plan} <- moved(plan, target, position, place) do
      done(draft, plan, picked(draft, target))
    end
  end

  @doc "Inserts an item before the target's index, or a corner before the target's corner."
  @spec insert(t(), target(), place()) :: result()
  def insert(%{plan: plan} = draft, {:mission, index, _corner}, place) do
    altitude = plan.items |> Enum.take(index) |> Enum.reverse() |> Enum.find_value(30.0, &(&1.x && &1.z))
    insert_item(draft, index, item(Kinds.waypoint(), place, altitude))
  end

  def insert(%{plan: plan} = draft, {:fence, index, corner}, place) when is_integer(corner) do
    with {:ok, position} <- position(place),
         {:ok, {kind, {:polygon, corners}}} <- fetch(plan.fence, index, "zone") do
      zone = {kind, {:polygon, List.insert_at(corners, corner, position)}}
      done(draft, %{plan | fence: List.replace_at(plan.fence, index, zone)}, {index, corner})
    else
      {:ok, _circle} -> {:error, "a circle has no corners"}
      error -> error
    end
  end

  @doc "Removes a target: an item, a zone or one of its corners, a rally point, home."
  @spec remove(t(), target()) :: result()
  def remove(%{plan: plan} = draft, {:home, _index, _corner}), do: done(draft, %{plan | home: nil}, nil)

  def remove(%{plan: plan} = draft, {:mission, index, _corner}) do
    with {:ok, _item} <- fetch(plan.items, index, "item") do
      items = plan.items |> List.delete_at(index) |> jumps(&if(&1 > index + 1, do: &1 - 1, else: &1))
      done(draft, %{plan | items: items}, nil)
    end
  end

  def remove(%{plan: plan} = draft, {:rally, index, _corner}) do
    with {:ok, _point} <- fetch(plan.rally, index, "rally point"),
         do: done(draft, %{plan | rally: List.delete_at(plan.rally, index)}, nil)
  end

  def remove(%{plan: plan} = draft, {:fence, index, corner}) do
    case fetch(plan.fence, index, "zone") do
      {:ok, {kind, {:polygon, corners}}} when is_integer(corner) and length(corners) > 3 ->
        zone = {kind, {:polygon, List.delete_at(corners, corner)}}
        done(draft, %{plan | fence: List.replace_at(plan.fence, index, zone)}, {index, nil})

      {:ok, {_kind, {:polygon, _corners}}} when is_integer(corner) ->
        {:error, "a polygon has at least three corners; remove the zone instead"}

      {:ok, _zone} ->
        done(draft, %{plan | fence: List.delete_at(plan.fence, index)}, nil)

      error ->
        error
    end
  end

  @doc "Moves an item up (-1) or down (1) in the list. Jumps keep their target items."
  @spec shift(t(), index :: non_neg_integer(), -1 | 1) :: result()
  def shift(%{plan: plan} = draft, index, by) do
    other = index + by

    with true <- other >= 0,
         {:ok, one} <- fetch(plan.items, index, "item"),
         {:ok, two} <- fetch(plan.items, other, "item") do
      items = plan.items |> List.replace_at(other, one) |> List.replace_at(index, two)
      done(draft, %{plan | items: jumps(items, &swapped(&1, index + 1, other + 1))}, {other, nil})
    else
      _at_the_end -> {:ok, draft}
    end
  end

  defp swapped(one, one, two), do: two
  defp swapped(two, one, two), do: one
  defp swapped(n, _one, _two), do: n

  @doc "Changes an item's command, frame, parameters, position or height. A number beyond a 32-bit float is refused."
  @spec set_item(t(), index :: non_neg_integer(), map()) :: result()
  def set_item(%{plan: plan} = draft, index, changes) do
    with {:ok, item} <- fetch(plan.items, index, "item"),
         item = struct!(item, Map.take(changes, [:command, :frame, :params, :x, :y, :z, :autocontinue])),
         :ok <- numbers(item) do
      done(draft, %{plan | items: List.replace_at(plan.items, index, item)}, {index, nil})
    end
  end

  @doc "Changes a zone: `:kind`, or the `:radius` of a circle in metres."
  @spec set_zone(t(), index :: non_neg_integer(), map()) :: result()
  def set_zone(%{plan: plan} = draft, index, changes) do
    with {:ok, {kind, shape}} <- fetch(plan.fence, index, "zone"),
         {:ok, shape} <- radius(shape, changes[:radius]) do
      zone = {Map.get(changes, :kind, kind), shape}
      done(draft, %{plan | fence: List.replace_at(plan.fence, index, zone)}, {index, nil})
    end
  end

  @doc "Changes the height of a rally point, in metres above what it is measured from."
  @spec set_rally(t(), index :: non_neg_integer(), altitude :: float()) :: result()
  def set_rally(%{plan: plan} = draft, index, altitude) do
    with {:ok, {position, old}} <- fetch(plan.rally, index, "rally point") do
      height = if is_tuple(old), do: put_elem(old, 0, altitude / 1), else: altitude / 1
      done(draft, %{plan | rally: List.replace_at(plan.rally, index, {position, height})}, {index, nil})
    end
  end

  @doc "Sets the planned start, with its height above mean sea level."
  @spec set_home(t(), place(), float()) :: result()
  def set_home(%{plan: plan} = draft, place, altitude) do
    with {:ok, position} <- position(place),
         do: done(draft, %{plan | home: {position, altitude / 1}}, draft.picked)
  end

  @doc "Removes everything in the part that is edited."
  @spec clear(t()) :: result()
  def clear(%{plan: plan, part: part} = draft) do
    draft = if part == :fence, do: drop(draft, :all), else: draft
    done(draft, %{Plan.put_part(plan, part, %Plan{}) | home: plan.home}, nil)
  end

  @doc """
  Without the last corner while a polygon is being drawn, else the plan before the last change; the draft itself if
  there
  was none.
  """
  @spec undo(t()) :: t()
  def undo(%{corners: [_ | _]} = draft), do: drop(draft, :last)
  def undo(%{undo: []} = draft), do: draft

  def undo(%{undo: [plan | undo]} = draft),
    do: %{draft | plan: plan, undo: undo, redo: [draft.plan | draft.redo], picked: nil, changed?: true}

  @doc "Redoes the change that was last undone."
  @spec redo(t()) :: t()
  def redo(%{redo: []} = draft), do: draft

  def redo(%{redo: [plan | redo]} = draft),
    do: %{draft | plan: plan, redo: redo, undo: [draft.plan | draft.undo], picked: nil, changed?: true}

  @doc "The number of entries in the part that is edited."
  @spec count(t()) :: non_neg_integer()
  def count(%{part: :mission, plan: plan}), do: length(plan.items)
  def count(%{part: :fence, plan: plan}), do: length(plan.fence)
  def count(%{part: :rally, plan: plan}), do: length(plan.rally)

  @doc "A position in degrees times 1e7, or an error."
  @spec position(place()) :: {:ok, Plan.position()} | {:error, String.t()}
  def position({lat, lon}) when is_number(lat) and is_number(lon) and abs(lat) <= 90 and abs(lon) <= 180,
    do: {:ok, {round(lat * 1.0e7), round(lon * 1.0e7)}}

  def position(_other), do: {:error, "expected a latitude from -90 to 90 and a longitude from -180 to 180"}

  defp insert_item(%{plan: plan} = draft, at, %Item{} = item) do
    at = at |> max(0) |> min(length(plan.items))

    with :ok <- room(plan.items, @max_items, "items") do
      items = plan.items |> jumps(&if(&1 > at, do: &1 + 1, else: &1)) |> List.insert_at(at, item)
      done(draft, %{plan | items: items}, {at, nil})
    end
  end

  defp insert_item(_draft, _at, error), do: error

  defp item(command, place, altitude) do
    with {:ok, {x, y}} <- position(place),
         do: %{Kinds.item(command) | frame: @relative, x: x, y: y, z: Item.float32(altitude)}
  end

  # DO_JUMP refers to items by their number from 1.
  defp jumps(items, renumber) do
    for item <- items do
      case item do
        %{command: @jump, params: {target, p2, p3, p4}} when is_number(target) ->
          %{item | params: {renumber.(trunc(target)) / 1, p2, p3, p4}}

        other ->
          other
      end
    end
  end

  defp moved(%{home: {_position, altitude}} = plan, {:home, _index, _corner}, position, _place),
    do: {:ok, %{plan | home: {position, altitude}}}

  defp moved(_plan, {:home, _index, _corner}, _position, _place), do: {:error, "the plan has no home"}

  defp moved(plan, {:mission, index, _corner}, {x, y}, _place) do
    with {:ok, item} <- fetch(plan.items, index, "item"),
         do: {:ok, %{plan | items: List.replace_at(plan.items, index, %{item | x: x, y: y})}}
  end

  defp moved(plan, {:rally, index, _corner}, position, _place) do
    with {:ok, {_old, altitude}} <- fetch(plan.rally, index, "rally point"),
         do: {:ok, %{plan | rally: List.replace_at(plan.rally, index, {position, altitude})}}
  end

  defp moved(plan, {:fence, index, corner}, position, place) do
    with {:ok, {kind, shape}} <- fetch(plan.fence, index, "zone"),
         {:ok, shape} <- reshaped(shape, corner, position, place),
         do: {:ok, %{plan | fence: List.replace_at(plan.fence, index, {kind, shape})}}
  end

  defp reshaped({:polygon, corners}, corner, position, _place) when is_integer(corner) do
    with {:ok, _old} <- fetch(corners, corner, "corner"),
         do: {:ok, {:polygon, List.replace_at(corners, corner, position)}}
  end

  defp reshaped({:circle, {x, y} = centre, _radius}, 1, _position, place) do
    metres = Aerie.Base.Geo.Earth.distance(point({x / 1.0e7, y / 1.0e7}), point(place))
    radius({:circle, centre, 1.0}, max(metres, 1.0))
  end

  defp reshaped({:circle, _old, radius}, _centre, position, _place), do: {:ok, {:circle, position, radius}}
  defp reshaped(_polygon, nil, _position, _place), do: {:error, "which corner?"}

  defp point({lat, lon}), do: Aerie.Base.Geo.Earth.point(lat, lon)

  defp radius(shape, nil), do: {:ok, shape}

  defp radius({:circle, centre, _old}, metres) when is_number(metres) and metres > 0 and metres <= 1_000_000,
    do: {:ok, {:circle, centre, Item.float32(metres)}}

  defp radius({:circle, _centre, _old}, _metres),
    do: {:error, "radius: expected more than 0 and at most 1000000 m"}

  defp radius(_polygon, _metres), do: {:error, "a polygon has no radius"}

  defp numbers(%{params: params, z: z}) do
    if Enum.all?([z | Tuple.to_list(params)], &(&1 == nil or (is_number(&1) and Item.fits?(&1)))),
      do: :ok,
      else: {:error, "expected numbers that fit into a 32-bit float"}
  end

  defp fetch(list, index, what) do
    case index >= 0 && Enum.fetch(list, index) do
      {:ok, value} -> {:ok, value}
      _none -> {:error, "there is no such #{what}"}
    end
  end

  defp room(list, most, what),
    do: if(length(list) < most, do: :ok, else: {:error, "a plan has at most #{most} #{what}"})

  defp picked(%{part: part}, {part, index, corner}), do: {index, corner}
  defp picked(draft, _target), do: draft.picked

  defp done(%{plan: plan} = draft, plan, picked), do: {:ok, %{draft | picked: picked}}
  defp done(draft, plan, picked), do: {:ok, %{step(draft, plan) | picked: picked, changed?: true}}

  defp step(draft, plan),
    do: %{draft | plan: plan, undo: Enum.take([draft.plan | draft.undo], @undo), redo: []}
end
