defmodule Aerie.Console.UI.Flash do
  @moduledoc "Messages that answer a user's action."
  use Phoenix.Component

  import Aerie.Console.UI.Icon

  attr :flash, :map, required: true

  @doc "The messages of a page. Information disappears by itself; an error stays until it is closed."
  def flash(assigns) do
    ~H"""
    <div id="flash" class="toasts" aria-live="polite">
      <div :for={{kind, text} <- Enum.sort(@flash)} :key={kind} id={"flash-#{kind}"} class={["toast", class(kind)]} role="status" phx-hook="Toast" data-kind={kind}>
        <.icon name={if(kind == "error", do: "alert", else: "check")} />
        <span>{text}</span>
        <button type="button" class="button quiet icon-only" aria-label="Close" phx-click="lv:clear-flash" phx-value-key={kind}><.icon name="x" /></button>
      </div>
    </div>
    """
  end

  defp class("error"), do: "bad"
  defp class(_info), do: "ok"
end
