defmodule Aerie.Console.UI.Badge do
  @moduledoc "A state as a word, in a small frame or behind a sign of its own shape, never by colour alone."
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

  @ready %{
    ready: {"●", "Ready"},
    check: {"◐", "Check"},
    not_ready: {"✕", "Not ready"},
    unknown: {"–", "Unknown"}
  }

  attr :state, :atom, required: true, values: [:ready, :check, :not_ready, :unknown]

  @doc "Whether a vehicle is ready to take off."
  def readiness(assigns) do
    {sign, word} = @ready[assigns.state]
    assigns = assign(assigns, sign: sign, word: word)

    ~H"""
    <span class={["ready", Atom.to_string(@state)]}><span aria-hidden="true">{@sign}</span> {@word}</span>
    """
  end
end
