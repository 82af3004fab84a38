defmodule Aerie.Console.Map do
  @moduledoc """
  The map of all pages. The README in `map/` lists its attributes and the events between page and map.
  """
  use Aerie.Console, :component

  @tools ~w(in out north fit follow tracks rings measure)

  attr :id, :string, required: true
  attr :label, :string, required: true
  attr :follow, :string, default: nil
  attr :selected, :list, default: []
  attr :tool, :string, default: "select", values: ~w(select point plan)
  attr :tools, :list, default: @tools
  attr :class, :string, default: nil

  attr :menu, :map,
    default: nil,
    doc: "what a place's menu offers (`Aerie.Console.Commands.Guided.menu/3`); nil: no menu"

  attr :box, :boolean, default: false, doc: "whether Shift and a drag select vehicles"

  @doc "The map. Its content is pushed to it."
  def map(assigns) do
    ~H"""
    <div
      id={@id}
      class={["map", @class]}
      role="region"
      aria-label={@label}
      phx-hook="FleetMap"
      phx-update="ignore"
      data-label={@label}
      data-follow={@follow}
      data-selected={JSON.encode!(@selected)}
      data-tool={@tool}
      data-tools={JSON.encode!(@tools)}
      data-menu={@menu && JSON.encode!(@menu)}
      data-box={@box}
    ></div>
    """
  end
end
