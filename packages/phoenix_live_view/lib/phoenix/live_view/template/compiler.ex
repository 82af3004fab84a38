defmodule Phoenix.LiveView.Template.Compiler do
  @moduledoc """
  Compiles the tree of a template to Elixir code that returns a `Phoenix.LiveView.Rendered`, when the template's module is compiled.

  Every expression is evaluated each time, without an analysis of what may have changed. Text and attributes with literal
  values are static. `:if` and `:for` make separate nodes, components give what their function returns, and slots are
  functions that the component calls.
  """

  alias Phoenix.LiveView.{Comprehension, Rendered}
  alias Phoenix.LiveView.Template.{Engine, Error, Parser}

  @doc "The code of a source. Options as `Phoenix.LiveView.Template.Tokenizer.tokenize/2`. Raises `Template.Error`."
  @spec compile(String.t(), keyword()) :: Macro.t()
  def compile(source, options) do
    source |> Parser.parse(options) |> compile_tree(Keyword.get(options, :file, "nofile"))
  end

  @doc "The code of a tree of `Phoenix.LiveView.Template.Parser`."
  @spec compile_tree([Parser.tree()], String.t()) :: Macro.t()
  def compile_tree(tree, file), do: rendered(tree, file)

  defp rendered(nodes, file) do
    nodes = trim(nodes)
    {static, dynamic} = nodes |> parts(file) |> split()
    quote do: %Rendered{static: unquote(static), dynamic: unquote(dynamic), root: unquote(root?(nodes))}
  end

  # White space around a single element would hide that it is the root.
  defp trim(nodes) do
    trimmed =
      nodes |> Enum.drop_while(&blank?/1) |> Enum.reverse() |> Enum.drop_while(&blank?/1) |> Enum.reverse()

    if root?(trimmed), do: trimmed, else: nodes
  end

  defp blank?({:text, text}), do: String.trim(text) == ""
  defp blank?(_node), do: false

  defp root?([{:element, :tag, _name, attributes, _children, _meta}]),
    do: not Enum.any?(attributes, &match?({":" <> _special, _, _}, &1))

  defp root?(_nodes), do: false

  # Parts are text and {:dynamic, code}; text that meets text is one static.
  defp split(parts) do
    {static, dynamic, last} =
      Enum.reduce(parts, {[], [], []}, fn
        {:dynamic, code}, {static, dynamic, text} ->
          {[IO.iodata_to_binary(text) | static], [code | dynamic], []}

        more, {static, dynamic, text} ->
          {static, dynamic, [text, more]}
      end)

    {Enum.reverse([IO.iodata_to_binary(last) | static]), Enum.reverse(dynamic)}
  end

  defp parts(nodes, file), do: Enum.flat_map(nodes, &part(&1, file))

  defp part({:text, text}, _file), do: [text]
  defp part({:expr, quoted, _meta}, _file), do: [{:dynamic, quote(do: Engine.node(unquote(assigns(quoted))))}]

  defp part({:element, kind, name, attributes, children, meta}, file) do
    {special, attributes} = special(attributes, file)
    inner = {kind, name, attributes, special[:let], children, meta}
    control(special, inner, file)
  end

  defp control(%{for: generator} = special, inner, file) do
    {pattern, enumerable} = generator(generator, file)
    {static, dynamic} = inner |> element(file) |> split()
    key = if special[:key], do: assigns(elem(special.key, 0)), else: :index

    rows =
      {:for, [],
       [quote(do: unquote(pattern) <- unquote(enumerable))] ++
         condition(special) ++ [[do: quote(do: {unquote(key), unquote(dynamic)})]]}

    [{:dynamic, quote(do: Comprehension.new(unquote(static), unquote(rows)))}]
  end

  defp control(%{if: {condition, _meta}}, inner, file) do
    {static, dynamic} = inner |> element(file) |> split()
    root = match?({:tag, _, _, _, _, _}, inner)
    rendered = quote do: %Rendered{static: unquote(static), dynamic: unquote(dynamic), root: unquote(root)}
    [{:dynamic, quote(do: if(unquote(assigns(condition)), do: unquote(rendered), else: ""))}]
  end

  defp control(%{key: {_quoted, meta}}, _inner, file),
    do: Error.raise!(file, meta, ":key needs a :for beside it")

  defp control(_special, inner, file), do: element(inner, file)

  defp generator({{:<-, _, [pattern, enumerable]}, _meta}, _file), do: {pattern, assigns(enumerable)}

  defp generator({_other, meta}, file),
    do: Error.raise!(file, meta, "expected :for={pattern <- enumerable}")

  defp element({:tag, _name, _attributes, {_let, at}, _children, _meta}, file),
    do: Error.raise!(file, at, ":let is for components and slots")

  defp element({:tag, name, attributes, nil, children, meta}, file) do
    attributes = Enum.flat_map(attributes, &attribute(&1, file))

    case meta.close do
      :void -> ["<", name] ++ attributes ++ [">"]
      _other -> ["<", name] ++ attributes ++ [">"] ++ parts(children, file) ++ ["</", name, ">"]
    end
  end

  defp element({:component, name, attributes, let, children, meta}, file) do
    {slots, inner} = Enum.split_with(children, &match?({:element, :slot, _, _, _, _}, &1))
    given = given(attributes, file)
    slots = slots(slots, file)

    inner =
      if Enum.all?(inner, &blank?/1),
        do: [],
        else: [
          inner_block: [quote(do: %{__slot__: :inner_block, inner_block: unquote(inner(inner, let, file))})]
        ]

    assigns = merged(given, slots ++ inner ++ [__changed__: nil])
    [{:dynamic, quote(do: Engine.component(unquote(call(name, assigns, meta)), unquote(name)))}]
  end

  defp call("." <> name, assigns, meta), do: {String.to_atom(name), [line: meta.line], [assigns]}

  defp call(name, assigns, meta) do
    {module, ["." <> function]} = name |> String.split(~r/(?=\.[^.]+\z)/) |> List.pop_at(0)
    module = Code.string_to_quoted!(module, line: meta.line)
    {{:., [line: meta.line], [module, String.to_atom(function)]}, [line: meta.line], [assigns]}
  end

  # Slots of one name are one list, in the order of the template.
  defp slots(slots, file) do
    slots
    |> Enum.group_by(fn {:element, :slot, name, _, _, _} -> name end)
    |> Enum.map(fn {name, slots} ->
      {String.to_atom(name), quote(do: Enum.concat(unquote(Enum.map(slots, &slot(&1, file)))))}
    end)
  end

  defp slot({:element, :slot, name, attributes, children, _meta}, file) do
    {special, attributes} = special(attributes, file)
    inner = if children == [], do: nil, else: inner(children, special[:let], file)
    entry = attributes |> given(file) |> merged(__slot__: String.to_atom(name), inner_block: inner)

    case {special, condition(special)} do
      {%{for: generator}, condition} ->
        {pattern, enumerable} = generator(generator, file)
        {:for, [], [quote(do: unquote(pattern) <- unquote(enumerable))] ++ condition ++ [[do: entry]]}

      {_always, []} ->
        [entry]

      {_one, [condition]} ->
        quote(do: if(unquote(condition), do: [unquote(entry)], else: []))
    end
  end

  # `:if` as a filter of the `for`.
  defp condition(%{if: {condition, _meta}}), do: [assigns(condition)]
  defp condition(_special), do: []

  defp inner(nodes, nil, file), do: quote(do: fn _changed, _argument -> unquote(rendered(nodes, file)) end)

  defp inner(nodes, {pattern, _meta}, file) do
    # Generated: a pattern that matches everything leaves nothing for the second clause.
    quote generated: true do
      fn _changed, argument ->
        case argument do
          unquote(pattern) ->
            unquote(rendered(nodes, file))

          other ->
            raise ArgumentError, "the argument of a slot does not match its :let: " <> inspect(other)
        end
      end
    end
  end

  # The attributes of a component, as the code of a map: pairs while every name is known, the last of a name holds.
  defp given(attributes, _file) do
    Enum.reduce(attributes, {:%{}, [], []}, fn
      {:root, {:expr, quoted}, _meta}, map ->
        quote(do: Map.merge(unquote(map), Map.new(unquote(assigns(quoted)))))

      {name, value, _meta}, map ->
        merged(map, [{String.to_atom(name), value(value)}])
    end)
  end

  defp merged({:%{}, [], pairs}, more), do: {:%{}, [], Keyword.merge(pairs, more)}
  defp merged(map, more), do: quote(do: Map.merge(unquote(map), unquote({:%{}, [], more})))

  defp value(true), do: true
  defp value({:text, text}), do: text
  defp value({:expr, quoted}), do: assigns(quoted)

  defp attribute({:root, {:expr, quoted}, _meta}, _file),
    do: [{:dynamic, quote(do: Engine.attributes(unquote(assigns(quoted))))}]

  defp attribute({name, true, _meta}, _file), do: [" ", name]

  defp attribute({name, {:text, text}, _meta}, _file),
    do: [" ", name, "=\"", String.replace(text, "\"", "&quot;"), "\""]

  defp attribute({name, {:expr, literal}, _meta}, _file)
       when is_binary(literal) or is_number(literal) or is_boolean(literal) or is_nil(literal),
       do: [Engine.attribute(name, literal)]

  defp attribute({name, {:expr, quoted}, _meta}, _file),
    do: [{:dynamic, quote(do: Engine.attribute(unquote(name), unquote(assigns(quoted))))}]

  # :if, :for, :key and :let, apart from the attributes.
  defp special(attributes, file) do
    {special, attributes} = Enum.split_with(attributes, &match?({":" <> _name, _, _}, &1))

    special =
      Map.new(special, fn
        {":if", {:expr, quoted}, meta} ->
          {:if, {quoted, meta}}

        {":for", {:expr, quoted}, meta} ->
          {:for, {quoted, meta}}

        {":key", {:expr, quoted}, meta} ->
          {:key, {quoted, meta}}

        {":let", {:expr, quoted}, meta} ->
          {:let, {quoted, meta}}

        {name, {:expr, _}, meta} ->
          Error.raise!(file, meta, "unknown #{name}: there are :if, :for, :key and :let")

        {name, _value, meta} ->
          Error.raise!(file, meta, "expected an expression: #{name}={…}")
      end)

    {special, attributes}
  end

  # @name in a template is the assign of that name.
  defp assigns(quoted) do
    Macro.prewalk(quoted, fn
      {:@, meta, [{name, _, context}]} when is_atom(name) and is_atom(context) ->
        quote line: meta[:line] || 0 do
          Engine.assign!(unquote(Macro.var(:assigns, nil)), unquote(name))
        end

      other ->
        other
    end)
  end
end
