defmodule Aerie.Console.UI.Dialog do
  @moduledoc "A dialog in front of the page. It keeps the focus while it is open, and returns it afterwards."
  use Phoenix.Component

  import Aerie.Console.UI.Button

  alias Phoenix.LiveView.JS

  attr :id, :string, required: true
  attr :title, :string, required: true
  attr :cancel, :string, required: true, doc: "the event of Escape and of the cross"
  attr :kind, :string, default: nil
  slot :inner_block, required: true
  slot :action

  @doc "A dialog, which is open while it is rendered: `<.dialog :if={@asking} …>`."
  def dialog(assigns) do
    ~H"""
    <dialog
      id={@id}
      class={["dialog", @kind]}
      aria-labelledby={"#{@id}-title"}
      phx-hook="Dialog"
      phx-mounted={JS.ignore_attributes("open")}
      data-cancel={@cancel}
    >
      <header>
        <h2 id={"#{@id}-title"}>{@title}</h2>
        <.button kind="quiet" icon="x" label="Close" phx-click={@cancel} />
      </header>
      <div class="dialog-body">{render_slot(@inner_block)}</div>
      <footer :if={@action != []}>{render_slot(@action)}</footer>
    </dialog>
    """
  end
end
