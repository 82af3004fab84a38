defmodule Aerie.Console.UI do
  @moduledoc """
  The components that all pages are made of. `use Aerie.Console` imports them. Their styles are in `assets/css/ui.css`, made from the
  tokens of `tokens.css`; no component takes a style.
  """

  alias Aerie.Console.UI

  @doc false
  defmacro __using__(_options) do
    for module <- [
          UI.Age,
          UI.Badge,
          UI.Button,
          UI.Dialog,
          UI.Field,
          UI.Flash,
          UI.HoldButton,
          UI.Icon,
          UI.Meter,
          UI.State,
          UI.Table,
          UI.Tabs
        ],
        do: quote(do: import(unquote(module)))
  end
end
