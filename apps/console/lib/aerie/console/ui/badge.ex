defmodule Aerie.Console.UI.Badge do
  @moduledoc "A state as a word in a small frame, never by colour alone."
  use Phoenix.Component

  attr :kind, :string, default: "plain", values: ~w(plain ok warn bad info off)
  attr :class, :string, default: nil
  attr :rest, :global
  slot :inner_block, required: true

  @doc "A badge."
  def badge(assigns) do
    ~H"""
    <span class={["badge", @kind, @class]} {@rest}>{render_slot(@inner_block)}</span>
    """
  end
end
