defmodule Aerie.Console.Pages.Fleet.Toolbar do
  @moduledoc "The search and the filters above the table."
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Fleet.{Filter, Sequence}
  alias Aerie.Console.Pages.Fleet.Table
  alias Aerie.Console.Part
  alias Aerie.Console.UI.Age

  @doc "What stands above the rows and seldom changes: search and filters (`@tools`), heads of the columns (`@heads`)."
  @spec tools(Phoenix.LiveView.Socket.t()) :: Phoenix.LiveView.Socket.t()
  def tools(%{assigns: %{filter: filter, order: order, choices: choices}} = socket) do
    socket
    |> Part.keep(:tools, &toolbar/1, %{filter: filter, choices: choices})
    |> Part.keep(:heads, &Table.heads/1, %{order: order})
  end

  attr :filter, :map, required: true
  attr :choices, :map, required: true, doc: "of `Aerie.Console.Pages.Fleet.Board.news/3`"

  @doc "Search and filters, on a phone behind the button of `status/1`."
  def toolbar(assigns) do
    ~H"""
    <form id="fleet-filter" class="fleet-filter" popover phx-change="filter" phx-submit="filter" role="search">
      <.field id="fleet-search" type="search" name="q" label="Search" label_hidden placeholder="Search" value={@filter.search} phx-debounce="150" autocomplete="off" />
      <.field id="fleet-type" type="select" name="type" label="Type" label_hidden value={@filter.type} options={options("All types", @filter.type, @choices.kinds)} />
      <.field
        id="fleet-firmware"
        type="select"
        name="firmware"
        label="Firmware"
        label_hidden
        value={@filter.firmware}
        options={options("All firmware", @filter.firmware, Enum.map(@choices.autopilots, &Atom.to_string/1))}
      />
      <.field id="fleet-tag" type="select" name="tag" label="Tag" label_hidden value={@filter.tag} options={options("All tags", @filter.tag, @choices.tags)} />
      <div class="fleet-flags" role="group" aria-label="Only those that are">
        <.button :for={{name, label} <- Filter.flags()} small phx-click="flag" phx-value-flag={name} aria-pressed={pressed(@filter, name)}>{label}</.button>
      </div>
    </form>
    """
  end

  @doc "What stands between map and table: it gives each its share of the width, and folds the table away."
  def splitter(assigns) do
    ~H"""
    <div id="fleet-split" class="fleet-split" phx-hook="Splitter" phx-update="ignore">
      <div
        class="fleet-bar" role="separator" tabindex="0" aria-orientation="vertical" aria-controls="fleet-map"
        aria-label="Width of the map, in per cent" aria-valuemin="20" aria-valuemax="80" aria-valuenow="50"
      ></div>
      <.button
        icon="chevron-right" label="Fold the table away, or show it" small aria-expanded="true"
        aria-controls="fleet-list" aria-keyshortcuts="\"
      />
    </div>
    """
  end

  attr :all, :list, required: true
  attr :shown, :integer, required: true
  attr :selected, :integer, required: true
  attr :filter, Filter, required: true
  attr :sequence, Sequence, required: true
  attr :now, :integer, required: true, doc: "as of `Sequence`"

  @doc "One line that is always there: the number of matching vehicles, whether anybody is heard, and how old the order of rows is that keep their places."
  def status(assigns) do
    ~H"""
    <div class="fleet-status">
      <p class="fleet-count muted" aria-live="polite">{count(@shown, length(@all), @selected)}</p>
      <span :if={@all != [] and Enum.all?(@all, &(&1.status != :online))} class="fleet-bad" role="status"><.icon name="clock" /> No vehicle is heard. What you see is what was last known.</span>
      <span :if={@sequence.differs} class="fleet-order muted">
        <span class="wide-only">Order from {Age.text((@now - @sequence.at) * 1000)} ago</span>
        <.button small phx-click="sort_now">Sort now</.button>
      </span>
      <.button
        small icon="filter" class="phone-only" popovertarget="fleet-filter"
        aria-pressed={to_string(Filter.any?(@filter))}
      >Filter</.button>
    </div>
    """
  end

  defp pressed(filter, name),
    do: if(Enum.any?(filter.flags, &(Atom.to_string(&1) == name)), do: "true", else: "false")

  # The chosen value stays in the list when its last vehicle has gone.
  defp options(all, chosen, values) do
    values = [chosen | values] |> Enum.reject(&is_nil/1) |> Enum.uniq() |> Enum.sort()
    [{all, ""} | Enum.map(values, &{&1, &1})]
  end

  defp count(all, all, 0), do: "#{all} #{vehicles(all)}"
  defp count(shown, all, 0), do: "#{shown} of #{all} #{vehicles(all)}"
  defp count(shown, all, selected), do: count(shown, all, 0) <> ", #{selected} selected"

  defp vehicles(1), do: "vehicle"
  defp vehicles(_n), do: "vehicles"
end
