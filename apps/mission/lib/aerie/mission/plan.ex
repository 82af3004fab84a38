defmodule Aerie.Mission.Plan do
  @moduledoc """
  A plan as a value: a mission, a fence and rally points. Files are read into it (`Aerie.Mission.File.QgcPlan`,
  `Aerie.Mission.File.Waypoints`), and it is converted to what a vehicle stores (`Aerie.Mission.Onboard`).

  Items are counted from 1, also in DO_JUMP: home is not an item. The adapter of a firmware that counts otherwise converts.
  """

  alias Aerie.Mission.Item

  defstruct home: nil, items: [], fence: [], fence_return: nil, rally: []

  @typedoc "Degrees times 1e7."
  @type position :: {lat :: integer(), lon :: integer()}

  @typedoc "An area that the vehicle must stay in or keep out of; a circle's radius is in metres."
  @type zone ::
          {:inclusion | :exclusion, {:polygon, [position(), ...]} | {:circle, position(), radius :: float()}}

  @typedoc """
    * `:home` - the planned start, with metres above mean sea level, or nil
    * `:items` - the mission
    * `:fence_return` - where to go after leaving the fence, with metres above home
    * `:rally` - rally points, with metres above home
  """
  @type t :: %__MODULE__{
          home: {position(), float()} | nil,
          items: [Item.t()],
          fence: [zone()],
          fence_return: {position(), float()} | nil,
          rally: [{position(), float()}]
        }

  @doc "Whether a plan has nothing of a kind. A fence without zones is none, even if it has a return point."
  @spec empty?(t(), :mission | :fence | :rally) :: boolean()
  def empty?(plan, :mission), do: plan.items == []
  def empty?(plan, :fence), do: plan.fence == []
  def empty?(plan, :rally), do: plan.rally == []

  @doc "Describes a part of a plan: `\"3 items\"`, `\"4 corners and 1 circle\"`, `\"2 rally points\"`; nil for nothing."
  @spec contents(t(), :mission | :fence | :rally) :: String.t() | nil
  def contents(%{items: items}, :mission), do: counted([{length(items), "item"}])
  def contents(%{rally: points}, :rally), do: counted([{length(points), "rally point"}])

  def contents(%{fence: zones, fence_return: back}, :fence) do
    polygons = for {_kind, {:polygon, corners}} <- zones, do: length(corners)
    circles = Enum.count(zones, &match?({_kind, {:circle, _centre, _radius}}, &1))
    counted([{Enum.sum(polygons), "corner"}, {circles, "circle"}, {length(List.wrap(back)), "return point"}])
  end

  defp counted(numbers) do
    case for {n, word} <- numbers, n > 0, do: "#{n} #{word}#{if n > 1, do: "s"}" do
      [] -> nil
      texts -> Enum.join(texts, " and ")
    end
  end

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
      <<item.command::16, Aerie.Vehicle.Protocol.Mavlink.plain_frame(item.frame)::8, item.autocontinue::8>>,
      floats,
      places
    ]
  end

  defp float(nil), do: <<0x7FC00000::32>>
  defp float(number), do: <<number::float-32>>
end
