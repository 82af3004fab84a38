defmodule Aerie.Console.UI.HoldButton do
  @moduledoc """
  A button that has to be held down, for everything that moves a vehicle, so that a slip of the hand does nothing. Space and Enter are held like the
  pointer; Escape and leaving the button stop it.

  The event's value has the `phx-value-*` attributes, `value`, the fields of the form around it, and `"id"`, which the browser makes for each press: the
  id of the command, by which the gateway recognises a duplicate. All are taken when the press begins, and a press during which they change
  sends nothing. A page that acts on more than the event says compares: what it has may have changed since the press was made. While there is
  no gateway, a press is dropped, not queued.
  """
  use Phoenix.Component

  import Aerie.Console.UI.Icon

  alias Phoenix.LiveView.JS

  attr :id, :string, required: true
  attr :event, :string, required: true
  attr :kind, :string, default: "primary", values: ~w(plain primary danger)
  attr :icon, :string, default: nil
  attr :hold_ms, :integer, default: 800, values: [500, 800, 1500]
  attr :shortcut, :string, default: nil, doc: "a key that is held instead, wherever the focus is"
  attr :refusal, :string, default: nil, doc: "why it does nothing now, by its key or the hand"

  attr :key_refusal, :string,
    default: nil,
    doc: "why the key does nothing, where the hand does something else"

  attr :value, :map, default: %{}, doc: "what it is for, as the operator sees it"
  attr :disabled, :boolean, default: false
  attr :reason, :string, default: nil, doc: "why it is disabled"
  attr :class, :string, default: nil
  attr :rest, :global
  slot :inner_block, required: true

  @doc "A button that has to be held, as `#hold-note` says to screen readers (`Aerie.Console.Frame`)."
  def hold_button(assigns) do
    ~H"""
    <button
      type="button"
      id={@id}
      class={["button hold", @kind, "hold-#{@hold_ms}", @class]}
      phx-hook="HoldButton"
      phx-mounted={JS.ignore_attributes(~w(data-state data-slip data-held-count data-slipped-count))}
      data-event={@event}
      data-hold={@hold_ms}
      data-shortcut={@shortcut}
      data-refusal={@refusal}
      data-key-refusal={@key_refusal}
      aria-disabled={@refusal && "true"}
      data-value={JSON.encode!(@value)}
      disabled={@disabled}
      title={if(@disabled, do: @reason, else: @refusal || "Press and hold")}
      aria-describedby={if(!@disabled and @refusal == nil, do: "hold-note")}
      {@rest}
    ><.icon :if={@icon} name={@icon} /><span>{render_slot(@inner_block)}</span><kbd :if={@shortcut && @key_refusal == nil}>{String.replace(@shortcut, "Escape", "Esc")}</kbd></button>
    """
  end
end
