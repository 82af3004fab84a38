defmodule Phoenix.Component.Declarative do
  @moduledoc false
  # `attr` and `slot`: their declarations are recorded for the function that follows, which then gets defaults and
  # global attributes, and raises if required ones are missing. A module's declarations are `__components__/0`,
  # the calls in its templates `__component_calls__/0`; `Phoenix.Component.Verify` compares them when it has been compiled.

  @globals ~w(data aria id class style title lang dir role tabindex hidden draggable autofocus accesskey contenteditable inert
    spellcheck translate itemid itemprop itemref itemscope itemtype popover nonce part slot enterkeyhint inputmode is exportparts)
  @prefixes ~w(aria- data- on phx- hx- x-)

  @types ~w(any string atom boolean integer float list map global)a

  defmacro __using__(_options) do
    quote do
      import Phoenix.Component.Declarative, only: [attr: 2, attr: 3, slot: 1, slot: 2, slot: 3]
      Module.register_attribute(__MODULE__, :__attrs__, accumulate: true)
      Module.register_attribute(__MODULE__, :__slots__, accumulate: true)
      Module.register_attribute(__MODULE__, :__slot_attrs__, accumulate: true)
      Module.register_attribute(__MODULE__, :__calls__, accumulate: true)
      Module.put_attribute(__MODULE__, :__declared__, %{})
      @on_definition Phoenix.Component.Declarative
      @before_compile Phoenix.Component.Declarative
      @after_verify Phoenix.Component.Verify
    end
  end

  @doc """
  Declares an attribute of the component that follows. Types: #{Enum.map_join(@types, ", ", &"`:#{&1}`")}, or a struct's
  module. Options: `:required`, `:default`, `:values`, `:doc`; for `:global` also `:include`.
  """
  defmacro attr(name, type, options \\ []) do
    quote bind_quoted: [name: name, type: type, options: options] do
      Phoenix.Component.Declarative.declare(__MODULE__, :__attrs__, {name, type, options}, __ENV__)
    end
  end

  @doc "Declares a slot of the component that follows. Options: `:required`, `:doc`; a `do` block may hold `attr`s."
  defmacro slot(name, options \\ [], block \\ []) do
    {block, options} = if Keyword.keyword?(options), do: pop_block(options, block), else: {block, options}

    quote do
      @__in_slot__ true
      unquote(block)
      @__in_slot__ false
      Phoenix.Component.Declarative.declare_slot(__MODULE__, unquote(name), unquote(options), __ENV__)
    end
  end

  @doc false
  def declare_slot(module, name, options, env) do
    attrs = take(module, :__slot_attrs__)
    declare(module, :__slots__, {name, :slot, Keyword.put(options, :attrs, attrs)}, env)
  end

  # Declarations so far, in their order.
  defp take(module, attribute) do
    declared = module |> Module.delete_attribute(attribute) |> List.wrap() |> Enum.reverse()
    Module.register_attribute(module, attribute, accumulate: true)
    declared
  end

  defp pop_block(options, block) do
    {inner, options} = Keyword.pop(options, :do)
    {inner || block[:do], options}
  end

  @doc false
  def declare(module, attribute, {name, type, options} = declaration, env) do
    in_slot? = attribute == :__attrs__ and Module.get_attribute(module, :__in_slot__) == true
    attribute = if in_slot?, do: :__slot_attrs__, else: attribute

    known =
      cond do
        type == :slot -> ~w(required doc attrs)a
        # The attributes of a slot have no defaults: they are a map.
        in_slot? -> ~w(required values doc)a
        true -> ~w(required default values doc include)a
      end

    with :ok <- name(name),
         :ok <- type(type),
         :ok <- options(options, known),
         :ok <- once(module, attribute, name) do
      Module.put_attribute(module, attribute, declaration)
    else
      {:error, words} ->
        raise CompileError, file: env.file, line: env.line, description: "#{inspect(name)}: #{words}"
    end
  end

  defp once(module, attribute, name) do
    if List.keymember?(Module.get_attribute(module, attribute), name, 0),
      do: {:error, "declared twice"},
      else: :ok
  end

  defp name(name) when is_atom(name), do: :ok
  defp name(_name), do: {:error, "expected a name as an atom"}

  defp type(:slot), do: :ok
  defp type(type) when type in @types, do: :ok

  defp type(type) when is_atom(type) do
    if match?("Elixir." <> _, Atom.to_string(type)),
      do: :ok,
      else: {:error, "unknown type #{inspect(type)}; known: #{inspect(@types)} or a struct's module"}
  end

  defp type(type), do: {:error, "unknown type #{inspect(type)}"}

  defp options(options, known) do
    case Keyword.keys(options) -- known do
      [] ->
        if options[:required] && Keyword.has_key?(options, :default),
          do: {:error, "required and with a default"},
          else: :ok

      unknown ->
        {:error, "unknown options #{inspect(unknown)}; known: #{inspect(known)}"}
    end
  end

  @doc false
  def __on_definition__(env, kind, name, [_assigns], _guards, _body) when kind in [:def, :defp] do
    attrs = take(env.module, :__attrs__)
    slots = take(env.module, :__slots__)

    if attrs != [] or slots != [] do
      declared = Module.get_attribute(env.module, :__declared__)
      entry = %{kind: kind, attrs: attrs, slots: slots, line: env.line}
      Module.put_attribute(env.module, :__declared__, Map.put(declared, name, entry))
    end
  end

  def __on_definition__(env, kind, _name, _args, _guards, _body) when kind in [:def, :defp] do
    if Module.get_attribute(env.module, :__attrs__) not in [nil, []] or
         Module.get_attribute(env.module, :__slots__) not in [nil, []],
       do:
         raise(CompileError,
           file: env.file,
           line: env.line,
           description: "attr and slot stand before a function of one argument"
         )
  end

  def __on_definition__(_env, _kind, _name, _args, _guards, _body), do: :ok

  defmacro __before_compile__(env) do
    declared = Module.get_attribute(env.module, :__declared__)

    overrides =
      for {name, %{kind: kind} = entry} <- declared do
        call_of = entry |> contract() |> Macro.escape()
        assigns = Macro.var(:assigns, __MODULE__)

        call =
          quote do
            super(Phoenix.Component.Declarative.given(unquote(assigns), unquote(call_of), unquote(name)))
          end

        definition =
          if kind == :def,
            do: quote(do: def(unquote(name)(unquote(assigns)), do: unquote(call))),
            else: quote(do: defp(unquote(name)(unquote(assigns)), do: unquote(call)))

        quote do
          defoverridable [{unquote(name), 1}]
          unquote(definition)
        end
      end

    calls = Module.get_attribute(env.module, :__calls__)

    quote do
      unquote_splicing(overrides)
      @doc false
      def __components__, do: unquote(Macro.escape(declared))
      @doc false
      def __component_calls__, do: unquote(Macro.escape(calls))
    end
  end

  # What a call needs of the declarations, worked out once.
  defp contract(%{attrs: attrs, slots: slots}) do
    {globals, plain} = Enum.split_with(attrs, fn {_name, type, _options} -> type == :global end)
    required = for {name, _type, options} <- slots ++ plain, options[:required], do: {name, word(name, slots)}

    defaults =
      for {name, _type, options} <- plain,
          {:ok, default} <- [Keyword.fetch(options, :default)],
          do: {name, default}

    none = for {name, :slot, options} <- slots, !options[:required], do: {name, []}
    own = [:__changed__, :__slot__, :inner_block | Enum.map(slots ++ attrs, &elem(&1, 0))]

    globals =
      for {name, :global, options} <- globals,
          do: {name, options[:include] || [], Map.new(options[:default] || %{})}

    %{defaults: Map.new(none ++ defaults), required: required, own: own, globals: globals}
  end

  defp word(name, slots),
    do: if(List.keymember?(slots, name, 0), do: "the slot :#{name}", else: "the attribute #{name}")

  @doc false
  # The assigns of a call, with defaults, globals and empty slots; a missing required one is an error.
  def given(assigns, %{defaults: defaults, required: required, own: own, globals: globals}, component) do
    for {name, word} <- required,
        not is_map_key(assigns, name),
        do: raise(ArgumentError, "#{word} of <.#{component}> is required")

    Enum.reduce(globals, Map.merge(defaults, assigns), &global(&1, &2, assigns, own))
  end

  # Undeclared attributes that every element may have.
  defp global({name, include, default}, merged, assigns, own) do
    rest =
      for {key, value} <- assigns,
          key not in own,
          global?(to_string(key), include),
          into: %{},
          do: {key, value}

    merged |> Map.drop(Map.keys(rest)) |> Map.put(name, Map.merge(default, rest))
  end

  @doc false
  # Whether every element may have an attribute of this name, or the component includes it.
  @spec global?(String.t(), [String.t()]) :: boolean()
  def global?(key, include),
    do: key in @globals or key in include or Enum.any?(@prefixes, &String.starts_with?(key, &1))
end
