defmodule Phoenix.HTML.Form do
  @moduledoc "Parts of forms."

  alias Phoenix.HTML.Safe

  @doc "The `<option>`s of a select: text or `{label, value}`; those with `value` (or in a list of values) are selected."
  @spec options_for_select(Enumerable.t(), term()) :: Phoenix.HTML.safe()
  def options_for_select(options, value) do
    selected = value |> List.wrap() |> Enum.map(&to_string/1)
    {:safe, Enum.map(options, &option(&1, selected))}
  end

  defp option({label, value}, selected) do
    text = to_string(value)

    attributes = [
      Phoenix.HTML.attribute({"value", text}),
      Phoenix.HTML.attribute({"selected", text in selected})
    ]

    ["<option", attributes, ">", Safe.to_iodata(label), "</option>"]
  end

  defp option(value, selected), do: option({value, value}, selected)
end
