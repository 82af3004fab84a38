defmodule Aerie.Console.UI.Button do
  @moduledoc "Buttons, and links that look like one."
  use Phoenix.Component

  import Aerie.Console.UI.Icon

  attr :kind, :string, default: "plain", values: ~w(plain primary danger quiet)
  attr :type, :string, default: "button"
  attr :icon, :string, default: nil
  attr :label, :string, default: nil, doc: "for a button with an icon alone"
  attr :small, :boolean, default: false
  attr :class, :string, default: nil

  attr(:rest, :global,
    include:
      ~w(disabled name value form autofocus navigate patch href download popovertarget aria-pressed aria-expanded
       aria-current)
  )

  slot :inner_block

  @doc "A button. With `navigate`, `patch` or `href` it is a link."
  def button(assigns) do
    {to, rest} = Map.split(assigns.rest, [:navigate, :patch, :href])
    assigns = assign(assigns, to: to, rest: rest)

    ~H"""
    <.link :if={@to != %{}} {@to} class={class(assigns)} aria-label={@label} title={@label} {@rest}><.icon :if={@icon} name={@icon} />{render_slot(
      @inner_block
    )}</.link>
    <button :if={@to == %{}} type={@type} class={class(assigns)} aria-label={@label} title={@label} {@rest}><.icon :if={@icon} name={@icon} />{render_slot(
      @inner_block
    )}</button>
    """
  end

  defp class(assigns),
    do: [
      "button",
      assigns.kind,
      assigns.small && "small",
      assigns.inner_block == [] && "icon-only",
      assigns.class
    ]
end
