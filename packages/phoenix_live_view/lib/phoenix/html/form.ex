defmodule Phoenix.HTML.FormField do
  @moduledoc "One field of a form: what an input needs to show it."
  @enforce_keys [:id, :name, :errors, :field, :form, :value]
  defstruct [:id, :name, :errors, :field, :form, :value]

  @type t :: %__MODULE__{}
end

defmodule Phoenix.HTML.Form do
  @moduledoc "A form as a value: `form[:field]` is a `Phoenix.HTML.FormField`. Made by `Phoenix.Component.to_form/2`."

  alias Phoenix.HTML.FormField

  @behaviour Access
  defstruct source: nil,
            id: nil,
            name: nil,
            action: nil,
            params: %{},
            errors: [],
            data: %{},
            hidden: [],
            options: []

  @type t :: %__MODULE__{}

  @doc "A form from params (string keys). Options: `:as`, `:id`, `:errors` (a keyword list), `:action`; the others are attributes."
  @spec new(map(), keyword()) :: t()
  def new(params, options) when is_map(params) do
    if Enum.any?(Map.keys(params), &(not is_binary(&1))),
      do: raise(ArgumentError, "expected the params of a form to have text as keys, got: #{inspect(params)}")

    {name, options} = Keyword.pop(options, :as)
    name = if name, do: to_string(name)
    {id, options} = Keyword.pop(options, :id, name)
    {errors, options} = Keyword.pop(options, :errors, [])
    {action, options} = Keyword.pop(options, :action)

    %__MODULE__{
      source: params,
      id: id,
      name: name,
      params: params,
      errors: errors,
      action: action,
      options: options
    }
  end

  @impl Access
  def fetch(%__MODULE__{} = form, field) when is_atom(field) or is_binary(field) do
    text = to_string(field)

    {:ok,
     %FormField{
       id: if(form.id, do: "#{form.id}_#{text}", else: text),
       name: if(form.name, do: "#{form.name}[#{text}]", else: text),
       errors: if(is_atom(field), do: Keyword.get_values(form.errors, field), else: []),
       field: field,
       form: form,
       value: form.params[text]
     }}
  end

  @impl Access
  def get_and_update(_form, _field, _fun),
    do: raise(ArgumentError, "a form is not changed; make another with to_form/2")

  @impl Access
  def pop(_form, _field), do: raise(ArgumentError, "a form is not changed; make another with to_form/2")

  @doc "Whether two values are equal in a form, such as `1` and `\"1\"`."
  @spec normalize_value(String.t(), term()) :: term()
  def normalize_value("checkbox", value), do: to_string(value || "") == "true"
  def normalize_value(_type, value), do: value

  @doc """
  The `<option>`s of a select: text, `{label, value}` or `{label, options}` for a group; those with `value` (or in a list of values) are selected.
  """
  @spec options_for_select(Enumerable.t(), term()) :: Phoenix.HTML.safe()
  def options_for_select(options, value) do
    selected = value |> List.wrap() |> Enum.map(&to_string/1)
    {:safe, Enum.map(options, &option(&1, selected))}
  end

  defp option({label, options}, selected) when is_list(options),
    do: [
      "<optgroup",
      Phoenix.HTML.attribute({"label", label}),
      ">",
      Enum.map(options, &option(&1, selected)),
      "</optgroup>"
    ]

  defp option({label, value}, selected) do
    text = to_string(value)

    attributes = [
      Phoenix.HTML.attribute({"value", text}),
      Phoenix.HTML.attribute({"selected", text in selected})
    ]

    ["<option", attributes, ">", Phoenix.HTML.Safe.to_iodata(label), "</option>"]
  end

  defp option(value, selected), do: option({value, value}, selected)
end
