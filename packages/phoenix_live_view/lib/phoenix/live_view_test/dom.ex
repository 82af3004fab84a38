defmodule Phoenix.LiveViewTest.DOM do
  @moduledoc false
  # Parses HTML of our own pages into a tree, and applies CSS selectors. Nodes are text or `{tag, [{name, value}], children}`. It reads what
  # templates write: every element is closed and every attribute is quoted; anything else is an error of the page, and raises.

  @type html_node :: String.t() | {String.t(), [{String.t(), String.t()}], [html_node()]}

  @void ~w(area base br col embed hr img input link meta param source track wbr)

  @doc "The nodes of an HTML text."
  @spec parse(String.t()) :: [html_node()]
  def parse(html) do
    case children(html, nil, []) do
      {nodes, ""} -> nodes
      {_nodes, rest} -> raise ArgumentError, "cannot read the page from here on: #{String.slice(rest, 0, 60)}"
    end
  end

  defp children("", nil, done), do: {Enum.reverse(done), ""}
  defp children("", tag, _done), do: raise(ArgumentError, "<#{tag}> is not closed")

  defp children("<!--" <> rest, tag, done) do
    [_comment, rest] = String.split(rest, "-->", parts: 2)
    children(rest, tag, done)
  end

  defp children("<!" <> rest, tag, done) do
    [_doctype, rest] = String.split(rest, ">", parts: 2)
    children(rest, tag, done)
  end

  defp children("</" <> rest, tag, done) do
    [name, rest] = String.split(rest, ">", parts: 2)

    if String.trim(name) == tag,
      do: {Enum.reverse(done), rest},
      else: raise(ArgumentError, "</#{name}> closes <#{tag}>")
  end

  defp children("<" <> rest, tag, done) do
    [name, rest] = Regex.run(~r/\A([a-zA-Z][^\s>\/]*)(.*)\z/s, rest, capture: :all_but_first)
    {attributes, closed?, rest} = attributes(String.trim_leading(rest), [])

    cond do
      closed? or name in @void ->
        children(rest, tag, [{name, attributes, []} | done])

      name in ["script", "style"] ->
        [inside, rest] = String.split(rest, "</#{name}>", parts: 2)
        children(rest, tag, [{name, attributes, [inside]} | done])

      true ->
        {inside, rest} = children(rest, name, [])
        children(rest, tag, [{name, attributes, inside} | done])
    end
  end

  defp children(text, tag, done) do
    {text, rest} =
      case :binary.match(text, "<") do
        {at, 1} -> {binary_part(text, 0, at), binary_part(text, at, byte_size(text) - at)}
        :nomatch -> {text, ""}
      end

    children(rest, tag, [unescape(text) | done])
  end

  defp attributes("/>" <> rest, done), do: {Enum.reverse(done), true, rest}
  defp attributes(">" <> rest, done), do: {Enum.reverse(done), false, rest}

  defp attributes(text, done) do
    case Regex.run(~r/\A([^\s=>\/]+)(?:="([^"]*)")?\s*(.*)\z/s, text, capture: :all_but_first) do
      [name, value, rest] -> attributes(rest, [{name, unescape(value)} | done])
      nil -> raise ArgumentError, "cannot read the attributes from here on: #{String.slice(text, 0, 60)}"
    end
  end

  defp unescape(text) do
    text
    |> String.replace("&lt;", "<")
    |> String.replace("&gt;", ">")
    |> String.replace("&quot;", "\"")
    |> String.replace("&#39;", "'")
    |> String.replace("&amp;", "&")
  end

  @doc "Nodes as HTML."
  @spec html([html_node()] | html_node()) :: String.t()
  def html(nodes), do: nodes |> List.wrap() |> Enum.map(&markup/1) |> IO.iodata_to_binary()

  defp markup(text) when is_binary(text), do: Phoenix.HTML.Escape.text(text)

  defp markup({tag, attributes, children}) do
    inside = if tag in ["script", "style"], do: children, else: Enum.map(children, &markup/1)
    closing = if tag in @void, do: [], else: [inside, "</", tag, ">"]

    [
      "<",
      tag,
      for({name, value} <- attributes, do: [" ", name, "=\"", Phoenix.HTML.Escape.text(value), "\""]),
      ">" | closing
    ]
  end

  @doc "The text of nodes, without markup."
  @spec text([html_node()] | html_node()) :: String.t()
  def text(text) when is_binary(text), do: text
  def text({_tag, _attributes, children}), do: text(children)
  def text(nodes) when is_list(nodes), do: Enum.map_join(nodes, &text/1)

  @doc "The value of an attribute, nil without one."
  @spec attribute(html_node(), String.t()) :: String.t() | nil
  def attribute({_tag, attributes, _children}, name) do
    with {_name, value} <- List.keyfind(attributes, name, 0), do: value
  end

  @doc """
  All elements that match a selector: `tag`, `#id`, `.class`, `[name]`, `[name=value]`, `[name^=value]`, `[name*=value]`, `:checked`, `:not(…)`, several of them
  together, descendants (a space), children (`>`), and alternatives (`,`).
  """
  @spec all([html_node()], String.t()) :: [html_node()]
  def all(nodes, selector) do
    alternatives = selector |> String.split(",") |> Enum.map(&steps/1)

    nodes
    |> walk([])
    |> Enum.filter(fn {node, above} -> Enum.any?(alternatives, &fits?(&1, node, above)) end)
    |> Enum.map(&elem(&1, 0))
  end

  # Every element with its ancestors, nearest first, in page order.
  defp walk(nodes, above) do
    Enum.flat_map(nodes, fn
      {_tag, _attributes, children} = node -> [{node, above} | walk(children, [node | above])]
      _text -> []
    end)
  end

  # Last step first: `{how, conditions}`, where `how` says where the previous step has to match.
  defp steps(selector) do
    ~r/\s*>\s*|\s+|(?:\[[^\]]*\]|[^\s>\[])+/
    |> Regex.scan(String.trim(selector))
    |> Enum.map(fn [part] -> part end)
    |> Enum.reduce({[], :self}, fn part, {steps, how} ->
      case String.trim(part) do
        ">" -> {steps, :child}
        "" -> {steps, :descendant}
        simple -> {[{how, conditions(simple)} | steps], :self}
      end
    end)
    |> elem(0)
  end

  # As in CSS, a name begins with no digit, and a value that is not a name has quotes.
  @condition ~r/\[([\w:-]+)(?:([\^*$]?=)(?|"([^"\]]*)"|'([^'\]]*)'|([a-z_-][\w-]*)))?\]|:not\(([^()]+)\)|([#.:]?)([a-z_-][\w-]*)|(\*)/i

  defp conditions(simple) do
    found = Regex.scan(@condition, simple)

    if Enum.map_join(found, &hd/1) != simple,
      do: raise(ArgumentError, "cannot read the selector #{inspect(simple)}")

    Enum.map(found, fn
      [_all, name] -> {:attribute, name, nil, nil}
      [_all, name, how, value] -> {:attribute, name, how, value}
      [_all, _, _, _, inner] -> {:not, conditions(inner)}
      [_all, _, _, _, _, "#", id] -> {:attribute, "id", "=", id}
      [_all, _, _, _, _, ".", class] -> {:class, class}
      [_all, _, _, _, _, ":", "checked"] -> {:attribute, "checked", nil, nil}
      [_all, _, _, _, _, "", tag] -> {:tag, tag}
      ["*" | _any] -> :any
      [other | _any] -> raise ArgumentError, "#{other} is not known in selectors of tests"
    end)
  end

  defp fits?([{how, conditions} | before], node, above),
    do: Enum.all?(conditions, &condition?(&1, node)) and before?(how, before, above)

  defp before?(_how, [], _above), do: true
  defp before?(:child, before, [parent | above]), do: fits?(before, parent, above)

  defp before?(:descendant, before, [parent | above]),
    do: fits?(before, parent, above) or before?(:descendant, before, above)

  defp before?(_how, _before, []), do: false

  defp condition?(:any, _node), do: true
  defp condition?({:not, conditions}, node), do: not Enum.all?(conditions, &condition?(&1, node))
  defp condition?({:tag, tag}, {name, _, _}), do: tag == name
  defp condition?({:class, class}, node), do: class in String.split(attribute(node, "class") || "")

  defp condition?({:attribute, name, how, value}, node) do
    case {attribute(node, name), how} do
      {nil, _how} -> false
      {_any, nil} -> true
      {given, "="} -> given == value
      {given, "^="} -> String.starts_with?(given, value)
      {given, "*="} -> String.contains?(given, value)
      {given, "$="} -> String.ends_with?(given, value)
    end
  end
end
