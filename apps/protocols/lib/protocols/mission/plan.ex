defmodule Protocols.Mission.Plan do
  @moduledoc """
  A plan as a value: a mission, a fence and rally points. Files are read into it (`Protocols.Mission.File.QgcPlan`,
  `Protocols.Mission.File.Waypoints`), and it is converted to what a vehicle stores (`Protocols.Mission.Onboard`).

  Items are counted from 1, also in DO_JUMP: home is not an item. The adapter of a firmware that counts otherwise converts.
  """

  alias Protocols.Mission.Item
  alias MavCodec.Enums.{MavCmd, MavFrame}

  defstruct home: nil, items: [], fence: [], fence_return: nil, fence_others: [], rally: [], rally_others: []

  @parts %{
    mission: [:home, :items],
    fence: [:fence, :fence_return, :fence_others],
    rally: [:rally, :rally_others]
  }
  @heights %{
    MavFrame.value(:MAV_FRAME_GLOBAL) => "above mean sea level",
    MavFrame.value(:MAV_FRAME_GLOBAL_TERRAIN_ALT) => "above the ground"
  }
  @said 20

  @type kind :: :mission | :fence | :rally

  @typedoc "Degrees times 1e7."
  @type position :: {lat :: integer(), lon :: integer()}

  @typedoc "An area that the vehicle must stay in or keep out of; a circle's radius is in metres."
  @type zone ::
          {:inclusion | :exclusion, {:polygon, [position(), ...]} | {:circle, position(), radius :: float()}}

  @typedoc "Metres above home, or with a MAV_FRAME: above the sea (GLOBAL) or the ground (GLOBAL_TERRAIN_ALT)."
  @type height :: float() | {float(), frame :: 0..255}

  @type rally_point :: {position(), height()}

  @typedoc """
    * `:home` - the planned start, with metres above mean sea level, or nil
    * `:items` - the mission
    * `:fence_return` - where to go after leaving the fence, with metres above home
    * `:fence_others`, `:rally_others` - other items that the vehicle sent
  """
  @type t :: %__MODULE__{
          home: {position(), float()} | nil,
          items: [Item.t()],
          fence: [zone()],
          fence_return: {position(), float()} | nil,
          fence_others: [Item.t()],
          rally: [rally_point()],
          rally_others: [Item.t()]
        }

  @doc "The largest numbers of polygons, of circles, and of rally points that can be stored in a file."
  @spec limits() :: %{zones: pos_integer(), rally: pos_integer()}
  def limits, do: %{zones: 200, rally: 500}

  @doc "What a plan has of a kind."
  @spec part(t(), kind()) :: map()
  def part(plan, kind), do: Map.take(plan, @parts[kind])

  @doc "A plan with what another one has of a kind."
  @spec put_part(t(), kind(), t()) :: t()
  def put_part(plan, kind, other), do: struct!(plan, part(other, kind))

  @doc "Whether a plan has nothing of a kind. A fence without zones counts as empty, even if it has a return point."
  @spec empty?(t(), kind()) :: boolean()
  def empty?(plan, :mission), do: plan.items == []
  def empty?(plan, :fence), do: plan.fence == [] and plan.fence_others == []
  def empty?(plan, :rally), do: plan.rally == [] and plan.rally_others == []

  @doc "Describes a part of a plan: `\"3 items\"`, `\"4 corners and 1 circle\"`, `\"2 rally points\"`; nil for nothing."
  @spec contents(t(), kind()) :: String.t() | nil
  def contents(%{items: items}, :mission), do: counted([{length(items), "item"}])

  def contents(%{rally: points, rally_others: others}, :rally),
    do: counted([{length(points), "rally point"}, {length(others), "other item"}])

  def contents(%{fence: zones, fence_return: back, fence_others: others}, :fence) do
    polygons = for {_kind, {:polygon, corners}} <- zones, do: length(corners)
    circles = Enum.count(zones, &match?({_kind, {:circle, _centre, _radius}}, &1))
    back = {length(List.wrap(back)), "return point"}
    counted([{Enum.sum(polygons), "corner"}, {circles, "circle"}, back, {length(others), "other item"}])
  end

  defp counted(numbers) do
    case for {n, word} <- numbers, n > 0, do: "#{n} #{word}#{if n > 1, do: "s"}" do
      [] -> nil
      texts -> Enum.join(texts, " and ")
    end
  end

  @doc "What a part lacks: the height of its first place that has none (`Protocols.Mission.Item.height?/1`)."
  @spec heightless(t(), kind()) :: String.t() | nil
  def heightless(plan, kind) do
    items = %{mission: plan.items, fence: plan.fence_others, rally: plan.rally_others}[kind]

    case Enum.find_index(items, &(not Item.height?(&1))) do
      nil ->
        nil

      n ->
        "a height in item #{n + 1} (#{label(Enum.at(items, n).command)}); QGroundControl leaves it out until it " <>
          "knows the terrain there: open the plan where it does, and save it again"
    end
  end

  defp label(command), do: MavCmd.label(command) || "command #{command}"

  @doc "What the height of a rally point is measured from."
  @spec above(height()) :: String.t()
  def above({_metres, frame}), do: @heights[frame]
  def above(_metres), do: "above home"

  @doc """
  What QGroundControl's files have no place for, as sentences. `Protocols.Mission.File.QgcPlan` writes it under
  `others`.
  """
  @spec remarks(t(), kind()) :: [String.t()]
  def remarks(_plan, :mission), do: []

  def remarks(plan, kind) do
    points =
      for {{_place, {_, _} = height}, n} <- Enum.with_index(plan.rally, 1),
          kind == :rally,
          do: point(n, height)

    others = if kind == :fence, do: plan.fence_others, else: plan.rally_others
    {said, more} = Enum.split(points ++ Enum.map(others, &other/1), @said)

    said =
      for what <- said,
          do: what <> ": this is under \"others\" in the plan, which QGroundControl does not read"

    if more == [], do: said, else: said ++ ["and #{length(more)} more"]
  end

  defp point(n, {metres, _frame} = height), do: "rally point #{n} is #{metres} m #{above(height)}"

  defp other(%{command: command, frame: frame}),
    do: "an item has the command #{label(command)} and the frame #{MavFrame.label(frame) || frame}"

  @doc """
  A digest of the items' content (64 hexadecimal digits), the same for equal items on every machine: floats as 32 bits, -0.0 as 0.0.
  """
  @spec digest([Item.t()]) :: String.t()
  def digest(items) do
    bytes = for item <- items, do: bytes(Item.rounded(item))
    :crypto.hash(:sha256, bytes) |> Base.encode16(case: :lower)
  end

  defp bytes(%{params: {p1, p2, p3, p4}} = item) do
    floats = for value <- [p1, p2, p3, p4, item.z], do: float(value)
    places = for value <- [item.x, item.y], do: <<value || 0x7FFFFFFF::signed-32>>

    [
      <<item.command::16, Item.plain_frame(item.frame)::8, item.autocontinue::8>>,
      floats,
      places
    ]
  end

  defp float(nil), do: <<0x7FC00000::32>>
  defp float(number), do: <<number::float-32>>
end
