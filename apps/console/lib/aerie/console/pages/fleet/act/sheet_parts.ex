defmodule Aerie.Console.Pages.Fleet.Act.SheetParts do
  @moduledoc "What the dialogs of all sheets have."
  use Aerie.Console, :component

  attr :sheet, :string, required: true, doc: "the id of the dialog"
  attr :name, :string, required: true
  attr :label, :string, required: true
  attr :unit, :string, required: true
  attr :value, :any, required: true
  attr :limits, :any, required: true
  attr :error, :string, default: nil

  @doc "A number of the form."
  def number(assigns) do
    {min, max} = assigns.limits
    assigns = assign(assigns, min: min, max: max)

    ~H"""
    <.field
      id={"#{@sheet}-#{@name}"}
      type="number"
      name={@name}
      label={@label}
      unit={@unit}
      value={@value}
      errors={List.wrap(@error)}
      min={@min}
      max={@max}
      step="any"
      inputmode="decimal"
      phx-debounce="300"
      autocomplete="off"
    />
    """
  end

  attr :line, :map, required: true

  @doc "The buttons that move a vehicle to an earlier or later place."
  def order(assigns) do
    ~H"""
    <.button
      :for={{to, icon, word} <- [{"up", "chevron-up", "earlier"}, {"down", "chevron-down", "later"}]}
      small
      icon={icon}
      label={"#{@line.id} #{word}"}
      phx-click="sheet_move"
      phx-value-id={@line.id}
      phx-value-to={to}
    />
    """
  end

  attr :line, :map, required: true

  @doc "The button that leaves a vehicle out or takes it along."
  def leave(assigns) do
    ~H"""
    <.button small phx-click="sheet_leave" phx-value-id={@line.id}>
      {if @line.n, do: "Leave out", else: "Take along"}
    </.button>
    """
  end

  attr :error, :string, default: nil, doc: "why the gateway has not begun it"
  attr :refusal, :string, default: nil

  @doc "Why it cannot begin, or has not begun."
  def errors(assigns) do
    ~H"""
    <p :if={@error} class="field-error" role="alert">{@error}</p>
    <p :if={@refusal} class="field-error" role="status">{@refusal}</p>
    """
  end

  attr :sheet, :string, required: true
  attr :icon, :string, required: true
  attr :value, :map, required: true
  attr :refusal, :string, default: nil
  slot :inner_block, required: true

  @doc "The button that begins it, held for 1.5 seconds."
  def go(assigns) do
    ~H"""
    <.button phx-click="sheet_close">Cancel</.button>
    <.hold_button
      id={"#{@sheet}-go"}
      event="sheet_go"
      icon={@icon}
      hold_ms={1500}
      value={@value}
      refusal={@refusal}
    >{render_slot(@inner_block)}</.hold_button>
    """
  end

  @doc "How many vehicles, in words."
  @spec count(non_neg_integer()) :: String.t()
  def count(1), do: "1 vehicle"
  def count(n), do: "#{n} vehicles"
end
