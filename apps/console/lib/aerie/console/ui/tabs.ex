defmodule Aerie.Console.UI.Tabs do
  @moduledoc "Tabs: parts of a page, one of which is shown. Each has its own address."
  use Phoenix.Component

  import Aerie.Console.UI.Icon

  attr :label, :string, required: true, doc: "what the tabs choose among, for screen readers"

  slot :tab, required: true do
    attr :patch, :string, required: true
    attr :current, :boolean
    attr :icon, :string
  end

  @doc "The row of tabs."
  def tabs(assigns) do
    ~H"""
    <nav class="tabs" aria-label={@label}>
      <.link :for={tab <- @tab} patch={tab.patch} class="tab" aria-current={if(tab[:current], do: "page")}><.icon :if={tab[:icon]} name={tab[:icon]} />{render_slot(
        tab
      )}</.link>
    </nav>
    """
  end
end
