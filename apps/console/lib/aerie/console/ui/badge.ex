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

  @ready [
    ready: {"●", "Ready", "ready"},
    check: {"◐", "Check", "to check"},
    not_ready: {"✕", "Not ready", "not ready"},
    unknown: {"–", "Unknown", "unknown"}
  ]

  attr :state, :atom, required: true, values: [:ready, :check, :not_ready, :unknown]

  @doc "Whether a vehicle is ready to take off."
  def readiness(assigns) do
    {sign, word, _many} = @ready[assigns.state]
    assigns = assign(assigns, sign: sign, word: word)

    ~H"""
    <span class={["ready", Atom.to_string(@state)]}><span aria-hidden="true">{@sign}</span> {@word}</span>
    """
  end

  @doc "How many vehicles are how ready: `4 ready, 1 not ready`."
  @spec counts([atom()]) :: String.t()
  def counts(states) do
    of_each = for {state, {_sign, _word, many}} <- @ready, do: {Enum.count(states, &(&1 == state)), many}
    Enum.map_join(Enum.filter(of_each, &(elem(&1, 0) > 0)), ", ", fn {n, many} -> "#{n} #{many}" end)
  end
end
