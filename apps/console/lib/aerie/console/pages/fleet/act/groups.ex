defmodule Aerie.Console.Pages.Fleet.Act.Groups do
  @moduledoc """
  Groups of the vehicles in the table, as chips that select them: all, in the air, ready, and each tag. Pure but for the
  component. The keys 1 to 9 select the first nine tags.
  """
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Fleet.Selection
  alias Aerie.Console.Pages.Fleet.Board.Row

  @most_tags 24

  @typedoc "`:key` - the digit that selects it"
  @type t :: %{name: String.t(), label: String.t(), key: String.t() | nil, ids: [String.t(), ...]}

  @doc "The groups that have vehicles, of the rows that the table lists."
  @spec of([Row.t()]) :: [t()]
  def of(rows) do
    tags = rows |> Enum.flat_map(& &1.tags) |> Enum.uniq() |> Enum.sort() |> Enum.take(@most_tags)

    own = [
      {"all", "All", nil, rows},
      {"air", "In air", nil, Enum.filter(rows, & &1.in_air)},
      {"ready", "Ready", nil, Enum.filter(rows, &(&1.readiness == :ready))}
    ]

    tagged =
      for {tag, n} <- Enum.with_index(tags, 1),
          do: {"tag:" <> tag, tag, if(n < 10, do: "#{n}"), Enum.filter(rows, &(tag in &1.tags))}

    for {name, label, key, [_ | _] = rows} <- own ++ tagged,
        do: %{name: name, label: label, key: key, ids: Enum.map(rows, & &1.id)}
  end

  @doc "The selection after a press on a group: its vehicles, or none if they are selected."
  @spec select(Selection.t(), [t()], name :: term()) :: Selection.t()
  def select(selection, groups, name) do
    case Enum.find(groups, &(&1.name == name)) do
      nil -> selection
      group -> if selected?(selection, group), do: %Selection{}, else: %Selection{ids: MapSet.new(group.ids)}
    end
  end

  defp selected?(%{ids: ids}, group), do: MapSet.equal?(ids, MapSet.new(group.ids))

  attr :groups, :list, required: true
  attr :selection, :map, required: true

  @doc "The chips."
  def groups(assigns) do
    ~H"""
    <div class="fleet-groups" role="group" aria-label="Select a group">
      <.button
        :for={group <- @groups}
        small
        phx-click="group"
        phx-value-name={group.name}
        data-digit={group.key}
        data-tag={tag(group)}
        aria-keyshortcuts={group.key}
        aria-pressed={to_string(selected?(@selection, group))}
      >
        <.icon :if={tag(group)} name="tag" />
        {group.label} {length(group.ids)}<kbd :if={group.key}>{group.key}</kbd>
      </.button>
    </div>
    """
  end

  # Its colour is that on the map (hooks/map/vehicles/tags.js).
  defp tag(%{name: "tag:" <> tag}), do: tag
  defp tag(_own), do: nil
end
