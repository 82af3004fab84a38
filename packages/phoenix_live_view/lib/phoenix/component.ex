defmodule Phoenix.Component do
  @moduledoc """
  Function components: functions that take a map of assigns and return `~H`.

      attr :level, :atom, values: [:info, :warning], default: :info
      slot :inner_block, required: true

      def notice(assigns) do
        ~H\"\"\"
        <p class={["notice", @level]}>{render_slot(@inner_block)}</p>
        \"\"\"
      end

  `use Phoenix.Component` imports `~H`, `attr/3`, `slot/3` and the functions below. In a template `{…}` holds an expression,
  `@name` is an assign, `<.name>` and `<Module.name>` call components, `<:name>` fills a slot, and `:if`, `:for`, `:key` and
  `:let` are special attributes. See `Phoenix.LiveView.Template.Tokenizer` for the syntax.
  """

  alias Phoenix.LiveView.Socket
  alias Phoenix.LiveView.Template.{Compiler, Engine, Parser}

  @doc false
  defmacro __using__(_options) do
    quote do
      import Phoenix.Component
      import Phoenix.Component.Elements
      use Phoenix.Component.Declarative
    end
  end

  @doc "A template; `assigns` must be a variable in its scope."
  defmacro sigil_H({:<<>>, meta, [source]}, _modifiers) do
    unless Macro.Env.has_var?(__CALLER__, {:assigns, nil}),
      do: raise(ArgumentError, "~H needs a variable named assigns in its scope")

    # A heredoc begins on the line after its quotes, with their indentation.
    {line, column} =
      if meta[:indentation],
        do: {__CALLER__.line + 1, meta[:indentation] + 1},
        else: {__CALLER__.line, (meta[:column] || 1) + 3}

    place = [file: __CALLER__.file, line: line, column: column, indentation: meta[:indentation] || 0]
    tree = Parser.parse(source, place)
    Phoenix.Component.Verify.remember(tree, __CALLER__)

    quote do
      _ = unquote(Macro.var(:assigns, nil))
      unquote(Compiler.compile_tree(tree, __CALLER__.file))
    end
  end

  @doc "The contents of a slot, with an argument for its `:let`."
  defmacro render_slot(slot, argument \\ nil) do
    quote do: Phoenix.LiveView.Template.Engine.slot(unquote(slot), unquote(argument))
  end

  @doc """
  Adds a value to a socket or to a component's assigns. Equal values change nothing.
  """
  @spec assign(Socket.t() | map(), atom(), term()) :: Socket.t() | map()
  def assign(%Socket{assigns: assigns} = socket, key, value),
    do: %{socket | assigns: assign(assigns, key, value)}

  def assign(%{__changed__: changed} = assigns, key, value) when is_atom(key) do
    case assigns do
      %{^key => ^value} ->
        assigns

      _differs
      when key in [:flash, :live_action, :socket, :uploads, :streams, :myself] and not is_nil(changed) ->
        raise ArgumentError, ":#{key} is a reserved assign"

      _differs ->
        put(assigns, key, value)
    end
  end

  def assign(assigns, _key, _value),
    do:
      raise(ArgumentError, "assign/3 takes a socket or the assigns of a component, got: #{inspect(assigns)}")

  @doc "Adds several values."
  @spec assign(Socket.t() | map(), keyword() | map()) :: Socket.t() | map()
  def assign(target, values) when is_list(values) or is_map(values),
    do: Enum.reduce(values, target, fn {key, value}, target -> assign(target, key, value) end)

  @doc "Updates an assign by a function of its value."
  @spec update(Socket.t() | map(), atom(), (term() -> term())) :: Socket.t() | map()
  def update(%Socket{assigns: assigns} = socket, key, fun), do: %{socket | assigns: update(assigns, key, fun)}
  def update(assigns, key, fun), do: assign(assigns, key, fun.(Engine.assign!(assigns, key)))

  defp put(%{__changed__: nil} = assigns, key, value), do: Map.put(assigns, key, value)

  defp put(%{__changed__: changed} = assigns, key, value),
    do: assigns |> Map.put(key, value) |> Map.put(:__changed__, Map.put(changed, key, true))
end
