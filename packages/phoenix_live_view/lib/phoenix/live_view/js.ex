defmodule Phoenix.LiveView.JS do
  @moduledoc """
  Commands that the browser runs by itself on an event: show, hide, set classes and attributes, move the focus, send events. They are
  chained and used in any `phx-` binding:

      <button phx-click={JS.push("inc") |> JS.add_class("done", to: "#row")}>

  Common options: `:to`, a CSS selector (or `{:inner, selector}`, `{:closest, selector}`); without it the element itself. `:transition`, classes
  as text or `{transition, start, end}`; `:time` of a transition in ms (200); `:blocking` (true).
  """

  alias __MODULE__

  defstruct ops: []

  @type t :: %JS{ops: [[term()]]}
  @type options :: keyword()

  @doc "Sends an event. Options: `:value` (a map), `:target`, `:loading`, `:page_loading`."
  @spec push(String.t(), options()) :: t()
  def push(event, options) when is_binary(event) and is_list(options), do: push(%JS{}, event, options)
  @spec push(t(), String.t()) :: t()
  def push(%JS{} = js, event), do: push(js, event, [])
  @spec push(t(), String.t(), options()) :: t()
  def push(%JS{} = js, event, options) do
    given = options |> allowed([:value, :target, :loading, :page_loading]) |> Map.new()

    if is_map_key(given, :value) and not is_map(given.value),
      do: raise(ArgumentError, "push :value expected to be a map, got: #{inspect(given.value)}")

    put(js, "push", Map.put(given, :event, event))
  end

  @doc "Sends an event."
  @spec push(String.t()) :: t()
  def push(event) when is_binary(event), do: push(%JS{}, event, [])

  @doc "Triggers a DOM event. Options: `:to`, `:detail` (a map), `:bubbles` (true), `:blocking` (false)."
  def dispatch(js \\ %JS{}, event, options \\ [])

  def dispatch(event, options, []) when is_binary(event) and is_list(options),
    do: dispatch(%JS{}, event, options)

  def dispatch(%JS{} = js, event, options) do
    given = allowed(options, [:to, :detail, :bubbles, :blocking])
    detail!(event, given)

    put(
      js,
      "dispatch",
      given |> common() |> Map.merge(%{event: event, detail: given[:detail], bubbles: given[:bubbles]})
    )
  end

  for {name, doc} <- [show: "Shows elements. Option `:display`, such as \"flex\".", hide: "Hides elements."] do
    @doc doc
    def unquote(name)(js_or_options \\ [])
    def unquote(name)(%JS{} = js), do: unquote(name)(js, [])
    def unquote(name)(options) when is_list(options), do: unquote(name)(%JS{}, options)

    @doc doc
    @spec unquote(name)(t(), options()) :: t()
    def unquote(name)(%JS{} = js, options) do
      given = allowed(options, [:to, :transition, :time, :blocking, :display])

      args =
        given
        |> common()
        |> Map.merge(%{display: given[:display], transition: classes(given[:transition])})

      put(js, unquote(to_string(name)), args)
    end
  end

  @doc "Toggles elements between shown and hidden. Options: `:in` and `:out` transitions, `:display`."
  def toggle(js_or_options \\ [])
  def toggle(%JS{} = js), do: toggle(js, [])
  def toggle(options) when is_list(options), do: toggle(%JS{}, options)

  @doc "Toggles elements between shown and hidden."
  @spec toggle(t(), options()) :: t()
  def toggle(%JS{} = js, options) do
    given = allowed(options, [:to, :in, :out, :time, :blocking, :display])
    extra = %{display: given[:display], ins: classes(given[:in]), outs: classes(given[:out])}
    put(js, "toggle", given |> common() |> Map.merge(extra))
  end

  for {name, op} <- [add_class: "add_class", remove_class: "remove_class", toggle_class: "toggle_class"] do
    @doc "Classes, separated by spaces. Options: `:to`, `:transition`, `:time`."
    def unquote(name)(names) when is_binary(names), do: unquote(name)(%JS{}, names, [])
    @doc false
    def unquote(name)(%JS{} = js, names) when is_binary(names), do: unquote(name)(js, names, [])

    def unquote(name)(names, options) when is_binary(names) and is_list(options),
      do: unquote(name)(%JS{}, names, options)

    @doc false
    @spec unquote(name)(t(), String.t(), options()) :: t()
    def unquote(name)(%JS{} = js, names, options) do
      given = allowed(options, [:to, :transition, :time, :blocking])

      args =
        given
        |> common()
        |> Map.merge(%{names: String.split(names), transition: classes(given[:transition])})

      put(js, unquote(op), args)
    end
  end

  @doc "Runs a transition."
  def transition(js \\ %JS{}, transition, options \\ [])

  def transition(transition, options, []) when not is_struct(transition) and is_list(options),
    do: transition(%JS{}, transition, options)

  def transition(%JS{} = js, transition, options) do
    given = allowed(options, [:to, :time, :blocking])
    put(js, "transition", given |> common() |> Map.put(:transition, classes(transition)))
  end

  @doc "Sets an attribute: `{name, value}`."
  def set_attribute(js \\ %JS{}, attribute, options \\ [])
  def set_attribute({_, _} = attribute, options, []), do: set_attribute(%JS{}, attribute, options)

  def set_attribute(%JS{} = js, {name, value}, options),
    do: put(js, "set_attr", options |> allowed([:to]) |> common() |> Map.put(:attr, [name, value]))

  @doc "Removes an attribute."
  def remove_attribute(js \\ %JS{}, name, options \\ [])

  def remove_attribute(name, options, []) when is_binary(name) and is_list(options),
    do: remove_attribute(%JS{}, name, options)

  def remove_attribute(%JS{} = js, name, options),
    do: put(js, "remove_attr", options |> allowed([:to]) |> common() |> Map.put(:attr, name))

  @doc "Sets or removes an attribute: `{name, value}`, or `{name, on, off}`."
  def toggle_attribute(js \\ %JS{}, attribute, options \\ [])

  def toggle_attribute(attribute, options, []) when is_tuple(attribute) and is_list(options),
    do: toggle_attribute(%JS{}, attribute, options)

  def toggle_attribute(%JS{} = js, attribute, options),
    do:
      put(
        js,
        "toggle_attr",
        options |> allowed([:to]) |> common() |> Map.put(:attr, Tuple.to_list(attribute))
      )

  for {name, doc} <- [
        focus: "Focuses an element.",
        focus_first: "Focuses the first focusable element within an element.",
        push_focus: "Remembers an element, to focus it again later."
      ] do
    @doc doc
    def unquote(name)(js_or_options \\ [])
    def unquote(name)(%JS{} = js), do: unquote(name)(js, [])
    def unquote(name)(options) when is_list(options), do: unquote(name)(%JS{}, options)

    @doc doc
    @spec unquote(name)(t(), options()) :: t()
    def unquote(name)(%JS{} = js, options),
      do: put(js, unquote(to_string(name)), options |> allowed([:to]) |> common())
  end

  @doc "Focuses the element that was last remembered."
  @spec pop_focus(t()) :: t()
  def pop_focus(js \\ %JS{}), do: put(js, "pop_focus", %{})

  @doc "Runs the commands in an attribute of an element."
  def exec(js \\ %JS{}, attribute, options \\ [])
  def exec(name, options, []) when is_binary(name) and is_list(options), do: exec(%JS{}, name, options)

  def exec(%JS{} = js, attribute, options),
    do: put(js, "exec", options |> allowed([:to]) |> common() |> Map.put(:attr, attribute))

  for {name, doc} <- [navigate: "Goes to another view.", patch: "Changes the URL within the view."] do
    @doc doc <> " Option `:replace`."
    def unquote(name)(href) when is_binary(href), do: unquote(name)(%JS{}, href, [])
    @doc false
    def unquote(name)(%JS{} = js, href), do: unquote(name)(js, href, [])
    def unquote(name)(href, options) when is_binary(href), do: unquote(name)(%JS{}, href, options)
    @doc false
    def unquote(name)(%JS{} = js, href, options),
      do:
        put(js, unquote(to_string(name)), %{
          href: href!(href, unquote("JS.#{name}")),
          replace: !!allowed(options, [:replace])[:replace]
        })
  end

  @doc "Attributes that the server no longer changes; names may end with `*`."
  @spec ignore_attributes(t(), String.t() | [String.t()]) :: t()
  def ignore_attributes(js \\ %JS{}, names), do: put(js, "ignore_attrs", %{attrs: List.wrap(names)})

  @doc "The commands as a value for JSON, such as the payload of `push_event/3`."
  @spec to_encodable(t()) :: [[term()]]
  def to_encodable(%JS{ops: ops}), do: ops

  @doc "Concatenates two lists of commands."
  @spec concat(t(), t()) :: t()
  def concat(%JS{ops: first}, %JS{ops: second}), do: %JS{ops: first ++ second}

  defp put(%JS{ops: ops}, kind, args),
    do: %JS{ops: ops ++ [[kind, Map.reject(args, fn {_key, value} -> is_nil(value) end)]]}

  defp href!(href, what), do: Phoenix.LiveView.Navigation.href!(href, what)

  # The client uses these keys itself.
  defp detail!(event, given) do
    cond do
      given[:detail] != nil and not is_map(given[:detail]) ->
        raise ArgumentError, "the detail option to JS.dispatch must be a map, got: #{inspect(given[:detail])}"

      given[:detail] != nil and event == "click" ->
        raise ArgumentError, "click events cannot be dispatched with details: the browser has its own there"

      given[:blocking] == true and
          (is_map_key(given[:detail] || %{}, :done) or is_map_key(given[:detail] || %{}, "done")) ->
        raise ArgumentError,
              "the detail of a blocking JS.dispatch must not contain a `done` key, which is the client's"

      true ->
        :ok
    end
  end

  defp allowed(options, known) do
    case Keyword.keys(options) -- known do
      [] -> options
      unknown -> raise ArgumentError, "unknown options #{inspect(unknown)}; known: #{inspect(known)}"
    end
  end

  defp common(options), do: %{to: to(options[:to]), time: options[:time], blocking: options[:blocking]}

  defp to({kind, selector}) when kind in [:inner, :closest] and is_binary(selector), do: %{kind => selector}
  defp to({:document, selector}) when is_binary(selector), do: selector
  defp to(selector) when is_binary(selector) or is_nil(selector), do: selector

  defp classes(nil), do: nil
  defp classes(classes) when is_binary(classes), do: [String.split(classes), [], []]

  defp classes({classes, first, last}),
    do: [String.split(classes), String.split(first), String.split(last)]
end

defimpl Phoenix.HTML.Safe, for: Phoenix.LiveView.JS do
  def to_iodata(%{ops: ops}), do: ops |> JSON.encode!() |> Phoenix.HTML.Escape.text()
end

defimpl JSON.Encoder, for: Phoenix.LiveView.JS do
  def encode(%{ops: ops}, encoder), do: encoder.(ops, encoder)
end
