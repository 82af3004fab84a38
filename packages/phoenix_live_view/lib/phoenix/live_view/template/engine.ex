defmodule Phoenix.LiveView.Template.Engine do
  @moduledoc false
  # Functions that compiled templates call: each value becomes a node of the tree, so that no number, nil or boolean
  # reaches the wire.

  alias Phoenix.HTML.Safe
  alias Phoenix.LiveView.{Comprehension, Rendered}

  @spec node(term()) :: Rendered.tree()
  def node(text) when is_binary(text), do: text |> Phoenix.HTML.Escape.text() |> IO.iodata_to_binary()
  def node(%Rendered{} = rendered), do: rendered
  def node(%Comprehension{} = comprehension), do: comprehension
  def node({:safe, data}), do: IO.iodata_to_binary(data)
  def node(nil), do: ""
  def node(value), do: value |> Safe.to_iodata() |> IO.iodata_to_binary()

  # The names of attributes in a template are checked when it is compiled.
  @spec attribute(String.t(), term()) :: String.t()
  def attribute(_name, value) when value in [nil, false], do: ""
  def attribute(name, true), do: " " <> name

  def attribute(name, value) when name in ["class", "style"],
    do: IO.iodata_to_binary([" ", name, "=\"", Phoenix.HTML.class_value(value), "\""])

  def attribute(name, value), do: IO.iodata_to_binary([" ", name, "=\"", Safe.to_iodata(value), "\""])

  @spec attributes(Enumerable.t()) :: String.t()
  def attributes(attributes),
    do: attributes |> Phoenix.HTML.attributes_escape() |> Phoenix.HTML.safe_to_string()

  @spec component(term(), String.t()) :: Rendered.tree()
  def component(%Rendered{} = rendered, _name), do: rendered
  def component(%Comprehension{} = comprehension, _name), do: comprehension

  def component(other, name),
    do: raise(ArgumentError, "expected the component <#{name}> to return ~H, got: #{inspect(other)}")

  @spec slot(term(), term()) :: Rendered.tree()
  def slot(entries, argument) do
    case List.wrap(entries) do
      [] -> ""
      [entry] -> inner(entry, argument)
      entries -> Comprehension.new(["", ""], Enum.map(entries, &{:index, [inner(&1, argument)]}))
    end
  end

  defp inner(%{inner_block: nil}, _argument), do: ""
  defp inner(%{inner_block: inner}, argument), do: inner.(nil, argument)

  defp inner(other, _argument),
    do: raise(ArgumentError, "expected a slot, such as @inner_block, got: #{inspect(other)}")

  @spec assign!(map(), atom()) :: term()
  def assign!(assigns, name) do
    case assigns do
      %{^name => value} ->
        value

      _missing ->
        known = assigns |> Map.keys() |> Enum.reject(&(&1 in [:__changed__, :inner_block])) |> inspect()

        raise KeyError,
          key: name,
          term: assigns,
          message: "assign @#{name} is not there. Assigns are: #{known}"
    end
  end
end
