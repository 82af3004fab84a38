defmodule Aerie.Console.UI.State do
  @moduledoc "What a page or a part of it shows while there is no data, while it loads, when data is old, and after a failure."
  use Phoenix.Component

  import Aerie.Console.UI.Icon

  attr :icon, :string, default: "info"
  attr :title, :string, required: true
  slot :inner_block
  slot :action

  @doc "There is no data: says why, and what would bring some."
  def empty(assigns) do
    ~H"""
    <div class="state empty">
      <.icon name={@icon} />
      <p class="state-title">{@title}</p>
      <div :if={@inner_block != []} class="state-text">{render_slot(@inner_block)}</div>
      <div :if={@action != []} class="state-action">{render_slot(@action)}</div>
    </div>
    """
  end

  attr :title, :string, default: "Loading"

  @doc "Data is being loaded."
  def loading(assigns) do
    ~H"""
    <div class="state loading" role="status"><span class="spinner"></span><p class="state-title">{@title} …</p></div>
    """
  end

  slot :inner_block, required: true

  @doc "The data is old: says since when."
  def stale(assigns) do
    ~H"""
    <p class="notice warn" role="status"><.icon name="clock" /> <span>{render_slot(@inner_block)}</span></p>
    """
  end

  @doc "Where the buttons would be that a viewer lacks."
  def watching(assigns) do
    ~H"""
    <p class="muted"><.icon name="eye" /> Viewers watch. Ask an operator or admin for more.</p>
    """
  end

  attr :via, :string, required: true
  slot :inner_block, required: true

  @doc "Another gateway hears the vehicle: says which, and what is only there."
  def elsewhere(assigns) do
    ~H"""
    <p class="notice info" role="status" data-elsewhere={@via}><.icon name="info" /> <span>The gateway <strong>{@via}</strong> hears this vehicle. {render_slot(@inner_block)}</span></p>
    """
  end

  attr :title, :string, required: true
  slot :inner_block

  @doc "Something failed: says why, and what to do."
  def error(assigns) do
    ~H"""
    <div class="state error" role="alert">
      <.icon name="alert" />
      <p class="state-title">{@title}</p>
      <div :if={@inner_block != []} class="state-text">{render_slot(@inner_block)}</div>
    </div>
    """
  end
end
