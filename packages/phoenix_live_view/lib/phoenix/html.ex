defmodule Phoenix.HTML do
  @moduledoc """
  Safe HTML: text is escaped unless it is marked as safe.

  A value is either unsafe (any term that implements `Phoenix.HTML.Safe`) or `{:safe, iodata}`, which is emitted as it is.
  Templates escape every value that is not marked.
  """

  alias Phoenix.HTML.Safe

  @type safe :: {:safe, iodata()}
  @type unsafe :: Safe.t()

  @doc "Escapes a value for HTML text and quoted attributes."
  @spec html_escape(unsafe()) :: safe()
  def html_escape({:safe, _} = safe), do: safe
  def html_escape(value), do: {:safe, Safe.to_iodata(value)}

  @doc "The text of a safe value."
  @spec safe_to_string(safe()) :: String.t()
  def safe_to_string({:safe, iodata}), do: IO.iodata_to_binary(iodata)

  @doc """
  Attributes as HTML, each with a space before it: `[class: "a", hidden: true, title: nil]` gives ` class="a" hidden`.

  `nil` and `false` leave an attribute out, `true` writes its name alone. Lists of `class` and `style` are flattened, with
  `nil` and `false` left out.
  """
  @spec attributes_escape(Enumerable.t()) :: safe()
  def attributes_escape(attributes), do: {:safe, Enum.map(attributes, &attribute/1)}

  @doc false
  @spec attribute({atom() | String.t(), term()}) :: iodata()
  def attribute({_name, nil}), do: []
  def attribute({_name, false}), do: []
  def attribute({name, true}), do: [?\s, name(name)]

  def attribute({name, value}) when name in [:class, "class", :style, "style"],
    do: [?\s, name(name), ?=, ?", class_value(value), ?"]

  def attribute({name, value}), do: [?\s, name(name), ?=, ?", Safe.to_iodata(value), ?"]

  # Attribute names may come from a caller's map: characters that would end the name are an error, not markup.
  defp name(name) do
    name = if is_atom(name), do: name |> Atom.to_string() |> String.replace("_", "-"), else: name

    if name == "" or
         String.contains?(name, [" ", "\"", "'", ">", "/", "=", "<", "\t", "\n", "\r", "\f", <<0>>]),
       do: raise(ArgumentError, "expected the name of an attribute, got: #{inspect(name)}"),
       else: name
  end

  @doc false
  @spec class_value(term()) :: iodata()
  def class_value(value) when is_list(value) do
    value |> List.flatten() |> Enum.filter(& &1) |> Enum.map_intersperse(" ", &Safe.to_iodata/1)
  end

  def class_value(nil), do: []
  def class_value(false), do: []
  def class_value(value), do: Safe.to_iodata(value)
end
