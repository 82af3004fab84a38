defmodule Phoenix.Component.Verify do
  @moduledoc false
  # Warns after the compilation of a module about calls in its templates that do not match the components' declarations.
  # Attributes that are known only at run time, such as `{@rest}`, are not checked. The texts are the namesake's.

  alias Phoenix.Component.Declarative

  @typep argument :: {atom(), tuple() | :unknown, line :: pos_integer()}
  @typep call :: %{
           component: {module(), atom()},
           attrs: [argument()],
           # Whether all attributes are known.
           whole?: boolean(),
           slots: [%{name: atom(), attrs: [argument()], whole?: boolean(), line: pos_integer()}],
           file: String.t(),
           line: pos_integer()
         }

  @doc "Records the calls of a template in the module that is being compiled, if it uses `Phoenix.Component`."
  @spec remember([Phoenix.LiveView.Template.Parser.tree()], Macro.Env.t()) :: :ok
  def remember(tree, %{module: module} = caller) do
    if module && Module.open?(module) && is_list(Module.get_attribute(module, :__calls__)),
      do: tree |> calls(caller) |> Enum.each(&Module.put_attribute(module, :__calls__, &1)),
      else: :ok
  end

  defp calls(nodes, caller) do
    Enum.flat_map(nodes, fn
      {:element, :component, name, attributes, children, meta} ->
        inside = calls(children, caller)

        case component(name, caller) do
          nil -> inside
          component -> [call(component, attributes, children, meta, caller) | inside]
        end

      {:element, _kind, _name, _attributes, children, _meta} ->
        calls(children, caller)

      _text ->
        []
    end)
  end

  # The function behind a name. A function that is neither imported nor defined yet will be the module's own.
  defp component("." <> name, caller) do
    name = String.to_atom(name)
    imported = Enum.find_value(caller.functions, fn {module, names} -> if {name, 1} in names, do: module end)

    if imported && not Module.defines?(caller.module, {name, 1}),
      do: {imported, name},
      else: {caller.module, name}
  end

  defp component(name, caller) do
    {parts, [name]} = name |> String.split(".") |> Enum.split(-1)

    case parts |> Enum.join(".") |> Code.string_to_quoted!() |> Macro.expand(caller) do
      module when is_atom(module) -> {module, String.to_atom(name)}
      _unknown -> nil
    end
  end

  defp call(component, attributes, children, meta, caller) do
    {slots, inner} = Enum.split_with(children, &match?({:element, :slot, _, _, _, _}, &1))
    inner? = Enum.any?(inner, &(not match?({:text, _}, &1) or String.trim(elem(&1, 1)) != ""))
    inner = if inner?, do: [%{name: :inner_block, attrs: [], whole?: true, line: meta.line}], else: []

    slots =
      for {:element, :slot, slot, attributes, _children, at} <- slots,
          do: Map.merge(arguments(attributes), %{name: String.to_atom(slot), line: at.line})

    attributes
    |> arguments()
    |> Map.merge(%{
      component: component,
      slots: inner ++ slots,
      file: caller.file,
      line: meta.line
    })
  end

  defp arguments(attributes) do
    {spread, named} = Enum.split_with(attributes, &match?({:root, _, _}, &1))

    attrs =
      for {name, value, meta} <- named,
          not String.starts_with?(name, ":"),
          do: {String.to_atom(name), known(value), meta.line}

    %{attrs: attrs, whole?: spread == []}
  end

  # The type of a value, if the template shows it.
  defp known(true), do: {:boolean, true}
  defp known({:text, text}), do: {:string, text}
  defp known({:expr, value}), do: type(value)

  defp type(value) when is_boolean(value), do: {:boolean, value}
  defp type(value) when is_atom(value), do: {:atom, value}
  defp type(value) when is_binary(value), do: {:string, value}
  defp type(value) when is_integer(value), do: {:integer, value}
  defp type(value) when is_float(value), do: {:float, value}
  defp type(value) when is_list(value), do: {:list, value}
  defp type({:%{}, _meta, [{:|, _, _}]}), do: :unknown
  defp type({:%{}, _meta, _fields} = map), do: {:map, map}
  defp type({:%, _meta, [module, _fields]} = struct), do: {:struct, module, struct}
  defp type(_expression), do: :unknown

  @doc false
  @spec __after_verify__(module()) :: :ok
  def __after_verify__(module) do
    for call <- module.__component_calls__() |> Enum.reverse() |> Enum.uniq(),
        {line, words} <- check(call),
        do: IO.warn(words, file: call.file, line: line)

    :ok
  end

  @doc "The errors of a call: lines and texts."
  @spec check(call()) :: [{pos_integer(), String.t()}]
  def check(%{component: {module, name}} = call) do
    with {:module, _loaded} <- Code.ensure_loaded(module),
         true <- function_exported?(module, :__components__, 0),
         %{^name => declared} <- module.__components__() do
      include = for {_name, :global, options} <- declared.attrs, do: options[:include] || []
      global? = &(include != [] and Declarative.global?(Atom.to_string(&1), List.flatten(include)))
      of = "#{inspect(module)}.#{name}/1"
      attributes(call, declared.attrs, global?, "", of) ++ slots(call, declared.slots, of)
    else
      _not_declared -> []
    end
  end

  # `where` is the text between the attribute and the component: empty, or the slot.
  defp attributes(%{attrs: given, whole?: whole?, line: line}, declared, allowed?, where, of) do
    missing =
      for {name, _type, options} <- declared,
          whole? and options[:required] == true and not List.keymember?(given, name, 0),
          do: {line, "missing required attribute \"#{name}\"#{where} for component #{of}"}

    mistakes =
      Enum.flat_map(given, fn {name, value, at} ->
        case List.keyfind(declared, name, 0) do
          {_name, :global, _options} ->
            component = if where == "", do: " in component", else: where <> " for component"
            [{at, "global attribute \"#{name}\"#{component} #{of} may not be provided directly"}]

          {_name, type, options} ->
            component = if where == "", do: " in component", else: where <> " for component"

            for words <- value(value, type, options[:values]),
                do: {at, "attribute \"#{name}\"#{component} #{of} must be #{words}"}

          nil ->
            if allowed?.(name),
              do: [],
              else: [{at, "undefined attribute \"#{name}\"#{where} for component #{of}"}]
        end
      end)

    missing ++ mistakes
  end

  defp slots(%{slots: given, line: line}, declared, of) do
    missing =
      for {name, :slot, options} <- declared,
          options[:required] == true and not Enum.any?(given, &(&1.name == name)),
          do: {line, "missing required slot \"#{name}\" for component #{of}"}

    mistakes =
      Enum.flat_map(given, fn slot ->
        case List.keyfind(declared, slot.name, 0) do
          {name, :slot, options} ->
            attributes(slot, options[:attrs], &(&1 == :inner_block), " in slot \"#{name}\"", of)

          # Every component with slots may also have an inner block.
          nil when slot.name == :inner_block and declared != [] ->
            []

          nil ->
            [{slot.line, "undefined slot \"#{slot.name}\" for component #{of}"}]
        end
      end)

    missing ++ mistakes
  end

  defp value(:unknown, _type, _values), do: []
  defp value({:boolean, _value}, :atom, nil), do: []
  defp value(_value, :any, nil), do: []

  defp value({:struct, module, value}, type, _values) do
    same? =
      Macro.to_string(module) |> String.split(".") |> List.last() ==
        type |> inspect() |> String.split(".") |> List.last()

    if same? or type in [:any, :map], do: [], else: ["#{article(type)}, got: #{Macro.to_string(value)}"]
  end

  defp value({given, value}, type, values) do
    cond do
      values && value in values -> []
      values -> ["one of #{inspect(values)}, got: #{Macro.to_string(value)}"]
      given == type -> []
      true -> ["#{article(type)}, got: #{Macro.to_string(value)}"]
    end
  end

  defp article(type) when type in [:atom, :integer], do: "an #{inspect(type)}"

  defp article(type) do
    case inspect(type) do
      ":" <> _plain = plain -> "a #{plain}"
      module -> "a #{module} struct"
    end
  end
end
