defmodule Aerie.Vehicle.Command.Param do
  @moduledoc """
  A parameter of a command: its name, type, unit, range, default and meaning, and the check of a value that came from
  outside.

  Checked values are numbers as floats, integers, booleans, texts and lists; a choice stays the text that it is.
  """

  alias Aerie.Base.Json

  @enforce_keys [:name, :type, :meaning]
  defstruct [:name, :type, :unit, :min, :max, :values, :default, :meaning, :items, required: false]

  @typedoc """
    * `:type` - `:list` has at most `max` items, each of which is checked by `items`
    * `:min`, `:max` - both included; for `:text` and `:list` the length
    * `:values` - the texts to choose from; for `:boolean` the one that is allowed, nil for both
    * `:default` - used when the parameter is not given; nil: it is left out, and the meaning says what follows
  """
  @type t :: %__MODULE__{
          name: atom(),
          type: :number | :integer | :boolean | :choice | :text | :list,
          unit: String.t() | nil,
          min: number() | nil,
          max: number() | nil,
          values: [String.t()] | [boolean()] | nil,
          default: term(),
          meaning: String.t(),
          items: t() | nil,
          required: boolean()
        }

  @doc "A number from `min` to `max`. Options: `:required`, `:default`."
  @spec number(atom(), String.t() | nil, number(), number(), String.t(), keyword()) :: t()
  def number(name, unit, min, max, meaning, options \\ []),
    do:
      struct!(
        %__MODULE__{name: name, type: :number, unit: unit, min: min, max: max, meaning: meaning},
        options
      )

  @doc "An integer from `min` to `max`."
  @spec integer(atom(), String.t() | nil, integer(), integer(), String.t(), keyword()) :: t()
  def integer(name, unit, min, max, meaning, options \\ []),
    do:
      struct!(
        %__MODULE__{name: name, type: :integer, unit: unit, min: min, max: max, meaning: meaning},
        options
      )

  @doc "One of some texts."
  @spec choice(atom(), [String.t()], String.t(), keyword()) :: t()
  def choice(name, values, meaning, options \\ []),
    do: struct!(%__MODULE__{name: name, type: :choice, values: values, meaning: meaning}, options)

  @doc "true or false."
  @spec boolean(atom(), String.t(), keyword()) :: t()
  def boolean(name, meaning, options \\ []),
    do: struct!(%__MODULE__{name: name, type: :boolean, meaning: meaning}, options)

  @doc "A text of at most `max` characters."
  @spec text(atom(), pos_integer(), String.t(), keyword()) :: t()
  def text(name, max, meaning, options \\ []),
    do: struct!(%__MODULE__{name: name, type: :text, max: max, meaning: meaning}, options)

  @doc "A list of at most `max` of what `items` says."
  @spec list(atom(), t(), pos_integer(), String.t(), keyword()) :: t()
  def list(name, items, max, meaning, options \\ []),
    do: struct!(%__MODULE__{name: name, type: :list, items: items, max: max, meaning: meaning}, options)

  @doc "Checks a value; `{:error, key, expected, got}` names the item of a list that is wrong."
  @spec check(t(), term(), key :: String.t()) ::
          {:ok, term()} | {:error, String.t(), String.t(), term()}
  def check(%{type: :number} = param, value, key) when is_number(value) do
    if value >= param.min and value <= param.max, do: {:ok, value * 1.0}, else: error(param, value, key)
  end

  def check(%{type: :integer} = param, value, key) when is_number(value) do
    # JSON writers turn 3 into 3.0 at will; the range goes first, because trunc/1 of a huge float is a huge integer.
    if value >= param.min and value <= param.max and trunc(value) == value,
      do: {:ok, trunc(value)},
      else: error(param, value, key)
  end

  def check(%{type: :boolean, values: nil}, value, _key) when is_boolean(value), do: {:ok, value}
  def check(%{type: :boolean, values: [value]}, value, _key), do: {:ok, value}

  def check(%{type: :choice} = param, value, key) do
    if value in param.values, do: {:ok, value}, else: error(param, value, key)
  end

  def check(%{type: :text} = param, value, key) when is_binary(value) do
    if Json.text?(value, 1, param.max), do: {:ok, value}, else: error(param, value, key)
  end

  def check(%{type: :list} = param, [_ | _] = values, key) do
    # Not length/1: an improper or very long list costs nothing more than this.
    if match?([_ | _], Enum.drop(values, param.max)),
      do: error(param, "more than #{param.max} items", key),
      else: items(param, values, key)
  end

  def check(param, value, key), do: error(param, value, key)

  defp items(param, values, key) do
    values
    |> Enum.with_index()
    |> Enum.reduce_while({:ok, []}, fn {value, index}, {:ok, checked} ->
      case check(param.items, value, "#{key}[#{index}]") do
        {:ok, value} -> {:cont, {:ok, [value | checked]}}
        error -> {:halt, error}
      end
    end)
    |> case do
      {:ok, checked} -> {:ok, Enum.reverse(checked)}
      error -> error
    end
  end

  defp error(param, value, key), do: {:error, key, expected(param), value}

  @doc "Describes valid values: `a number from 0 to 500 (m)`."
  @spec expected(t()) :: String.t()
  def expected(%{type: :number} = param), do: "a number #{range(param)}"
  def expected(%{type: :integer} = param), do: "an integer #{range(param)}"
  def expected(%{type: :boolean, values: nil}), do: "true or false"
  def expected(%{type: :boolean, values: [value]}), do: "#{value}"
  def expected(%{type: :choice, values: values}), do: "one of #{Enum.join(values, ", ")}"
  def expected(%{type: :text, max: max}), do: "a text of 1 to #{max} characters"
  def expected(%{type: :list} = param), do: "a list of 1 to #{param.max} items, each #{expected(param.items)}"

  defp range(param) do
    unit = if param.unit, do: " (#{param.unit})", else: ""
    "from #{Json.number(param.min)} to #{Json.number(param.max)}#{unit}"
  end
end
