defmodule Aerie.Console.Pages.Fleet.Selection do
  @moduledoc """
  The selected vehicles. Pure. `anchor` is where a range with Shift begins: the vehicle that was last selected or deselected by itself.
  """

  alias Aerie.Console.Pages.Fleet.Board.Row

  defstruct ids: MapSet.new(), anchor: nil

  @type t :: %__MODULE__{ids: MapSet.t(String.t()), anchor: String.t() | nil}

  @doc "Selects only this vehicle."
  @spec only(t(), String.t()) :: t()
  def only(_selection, id), do: %__MODULE__{ids: MapSet.new([id]), anchor: id}

  @doc "Adds this vehicle, or removes it."
  @spec toggle(t(), String.t()) :: t()
  def toggle(selection, id) do
    ids = if id in selection.ids, do: MapSet.delete(selection.ids, id), else: MapSet.put(selection.ids, id)
    %{selection | ids: ids, anchor: id}
  end

  @doc "Selects only the vehicles from the anchor to this one in the table's order. Without an anchor in the table, only this one."
  @spec range(t(), String.t(), [String.t()]) :: t()
  def range(selection, id, order) do
    from = Enum.find_index(order, &(&1 == selection.anchor))
    to = Enum.find_index(order, &(&1 == id))

    if from && to,
      do: %{selection | ids: order |> Enum.slice(min(from, to)..max(from, to)//1) |> MapSet.new()},
      else: only(selection, id)
  end

  @doc "Adds these vehicles."
  @spec add(t(), [String.t()]) :: t()
  def add(selection, ids), do: %{selection | ids: MapSet.union(selection.ids, MapSet.new(ids))}

  @doc "Removes these vehicles."
  @spec remove(t(), [String.t()]) :: t()
  def remove(selection, ids), do: %{selection | ids: MapSet.difference(selection.ids, MapSet.new(ids))}

  @doc "Selects all of these, or none if all are selected."
  @spec all(t(), [String.t()]) :: t()
  def all(selection, ids) do
    if ids != [] and Enum.all?(ids, &(&1 in selection.ids)),
      do: %__MODULE__{},
      else: %{selection | ids: MapSet.new(ids)}
  end

  @doc "Removes vehicles that no longer exist."
  @spec keep(t(), [String.t()]) :: t()
  def keep(%{ids: selected, anchor: anchor} = selection, ids) do
    if anchor == nil and MapSet.size(selected) == 0 do
      selection
    else
      known = MapSet.new(ids)
      %{selection | ids: MapSet.intersection(selected, known), anchor: if(anchor in known, do: anchor)}
    end
  end

  @doc "The number of selected vehicles."
  @spec size(t()) :: non_neg_integer()
  def size(selection), do: MapSet.size(selection.ids)

  @doc """
  Whether a press was made for the vehicles that are selected now (`ids`). The browser may show an earlier selection than the server has.
  """
  @spec meant?(event :: map(), [String.t()]) :: boolean()
  def meant?(%{"ids" => meant}, ids) when is_list(meant), do: Enum.sort(meant) == Enum.sort(ids)
  def meant?(_event, _ids), do: false

  @doc "The selected vehicles in words, and those of them that the table does not list, nil for none. `all` and `listed`: ids."
  @spec summary(t(), all :: [String.t()], listed :: [String.t()]) :: {String.t() | nil, String.t() | nil}
  def summary(selection, all, listed) do
    listed = MapSet.new(listed)
    {seen, hidden} = selection |> among(all) |> Enum.split_with(&(&1 in listed))

    {if(seen != [], do: names(seen)),
     if(hidden != [], do: "#{count(hidden)} hidden by the filter: #{names(hidden)}")}
  end

  defp count([_one]), do: "1 selected vehicle is"
  defp count(ids), do: "#{length(ids)} selected vehicles are"

  @doc "Why nothing is done with such a selection, by a button or a key, and what to do."
  @spec hidden_refusal() :: String.t()
  def hidden_refusal, do: "Hidden vehicles are selected. Clear the filter or the selection first."

  @doc "Vehicles in a few words."
  @spec names([String.t()]) :: String.t()
  def names(ids) when length(ids) <= 3, do: Enum.join(ids, ", ")
  def names(ids), do: "#{length(ids)} vehicles (#{ids |> Enum.take(3) |> Enum.join(", ")} …)"

  @doc "The selected vehicles of a list, in its order."
  @spec among(t(), [String.t()]) :: [String.t()]
  def among(selection, ids), do: chosen(selection, ids, & &1)

  @doc "The rows of the selected vehicles."
  @spec chosen(t(), [Row.t()]) :: [Row.t()]
  def chosen(selection, rows), do: chosen(selection, rows, & &1.id)

  # Usually none is selected.
  defp chosen(%{ids: ids}, items, id),
    do: if(MapSet.size(ids) > 0, do: Enum.filter(items, &MapSet.member?(ids, id.(&1))), else: [])
end
