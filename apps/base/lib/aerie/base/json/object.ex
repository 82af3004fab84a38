defmodule Aerie.Base.Json.Object do
  @moduledoc """
  An object of JSON that is declared: its fields with type, unit and meaning. What is shown of a value (`show/2`), its
  JSON Schema (`schema/1`) and its table in the documentation (`rows/1`) are made of the declaration. Pure.

      @fields Object.fields([
                {:offset_s, {:seconds, 6}, "s", "the vehicle's clock minus the gateway's", :offset_us},
                {:time, :time, nil, "time of the last answer", :at}
              ])

  The last element is where the value is: a key of what is shown, a path of keys, or a function of that; left out, the
  key has the field's name. With options in its place, `:from` is that, and `:metric` the name that the value has for
  Prometheus. An unknown value is null. The types:

    * `:text`, `:boolean`, `:integer`, `:number`, `{:one_of, values}`, `:any` - as it is
    * a number of decimals - a number that is rounded to them, 0 for whole numbers; null for what is not a number
    * `:time` - unix microseconds, shown as ISO 8601; `{:time, :second}` - the same from unix seconds
    * `{:seconds, decimals}` - microseconds, shown as seconds
    * `{:list, type}`, `{:map, type}` (free names), `{:object, fields}`
    * `{:shown, fields}` - an object that is shown already, as it is
    * `{:schema, schema}` - as it is, described by that JSON Schema
  """

  alias Aerie.Base.Json
  alias Aerie.Base.Json.Schema

  @enforce_keys [:name, :type, :unit, :meaning, :from]
  defstruct @enforce_keys ++ [:metric]

  @type type ::
          :text
          | :boolean
          | :integer
          | :number
          | :any
          | {:one_of, [atom() | String.t()]}
          | non_neg_integer()
          | :time
          | {:time, :second}
          | {:seconds, non_neg_integer()}
          | {:list, type()}
          | {:map, type()}
          | {:object, [t()]}
          | {:shown, [t()]}
          | {:schema, Schema.t()}
  @type t :: %__MODULE__{
          name: atom(),
          type: type(),
          unit: String.t() | nil,
          meaning: String.t(),
          from: from(),
          metric: String.t() | {String.t(), help :: String.t()} | nil
        }
  @type from :: atom() | [atom()] | (map() -> term())
  @type declared ::
          {atom(), type(), unit :: String.t() | nil, meaning :: String.t()}
          | {atom(), type(), unit :: String.t() | nil, meaning :: String.t(), from() | keyword()}

  @doc "The fields of a declaration."
  @spec fields([declared()]) :: [t()]
  def fields(declared) do
    for row <- declared do
      {name, type, unit, meaning, options} =
        with {name, type, unit, meaning} <- row, do: {name, type, unit, meaning, []}

      options = if Keyword.keyword?(options), do: options, else: [from: options]
      field = %__MODULE__{name: name, type: type, unit: unit, meaning: meaning, from: name}
      struct!(field, options)
    end
  end

  @doc "The fields of an object in it."
  @spec inside([t()], atom()) :: [t()]
  def inside(fields, name) do
    %{type: {:object, fields}} = Enum.find(fields, &(&1.name == name))
    fields
  end

  @doc "The fields that are metrics, each with the metric's name and its help: the meaning, unless it has its own."
  @spec metrics([t()]) :: [{t(), name :: String.t(), help :: String.t()}]
  def metrics(fields) do
    for %{metric: metric} = field when metric != nil <- fields do
      {name, help} = with name when is_binary(name) <- metric, do: {name, sentence(field.meaning)}
      {field, name, help}
    end
  end

  defp sentence(<<first::utf8, rest::binary>>), do: String.upcase(<<first::utf8>>) <> rest <> "."

  @doc "What is shown of a value."
  @spec show([t()], map()) :: %{atom() => term()}
  def show(fields, value), do: Map.new(fields, &{&1.name, value(&1, value)})

  @doc "What one field shows of a value."
  @spec value(t(), map()) :: term()
  def value(%{type: type, from: from}, value) when is_atom(from), do: plain(type, Map.get(value, from))

  def value(%{type: type, from: [_ | _] = path}, value),
    do: plain(type, Enum.reduce(path, value, &(&2 && Map.get(&2, &1))))

  def value(%{type: type, from: from}, value), do: plain(type, from.(value))

  defp plain(_type, nil), do: nil
  defp plain(0, number) when is_float(number), do: round(number)
  defp plain(n, number) when is_integer(n) and is_float(number), do: Float.round(number, n)
  defp plain(n, number) when is_integer(n), do: if(is_integer(number), do: number)
  defp plain(:time, us), do: Json.time(us)
  defp plain({:time, :second}, s), do: Json.time(s * 1_000_000)
  defp plain({:seconds, n}, us), do: Float.round(us / 1_000_000, n)
  defp plain({:list, type}, list), do: Enum.map(list, &plain(type, &1))
  defp plain({:map, type}, map), do: Map.new(map, fn {name, value} -> {name, plain(type, value)} end)
  defp plain({:object, fields}, value), do: show(fields, value)
  defp plain({:shown, _fields}, value), do: value
  defp plain(_as_it_is, value), do: Json.plain(value)

  @doc "The JSON Schema: each field is there, and may be null; later versions may have more."
  @spec schema([t()]) :: Schema.t()
  def schema(fields) do
    properties = properties(fields)
    Schema.object(properties, Map.keys(properties), open: true)
  end

  @doc "The JSON Schema of each field by its name."
  @spec properties([t()]) :: %{atom() => Schema.t()}
  def properties(fields) do
    for field <- fields, into: %{} do
      {field.name, field.type |> schema_of() |> nullable() |> Schema.described(field.meaning, field.unit)}
    end
  end

  # Anything may be null already.
  defp nullable(schema) when schema == %{}, do: schema
  defp nullable(schema), do: Schema.nullable(schema)

  defp schema_of(:text), do: %{type: :string}
  defp schema_of(:boolean), do: %{type: :boolean}
  defp schema_of(type) when type in [:integer, 0], do: %{type: :integer}
  defp schema_of(type) when type == :number or is_integer(type), do: %{type: :number}
  defp schema_of({:seconds, _decimals}), do: %{type: :number}
  defp schema_of(time) when time in [:time, {:time, :second}], do: %{type: :string, format: :"date-time"}
  defp schema_of({:one_of, values}), do: %{enum: values}
  defp schema_of({:list, type}), do: %{type: :array, items: schema_of(type)}
  defp schema_of({:map, type}), do: %{type: :object, additionalProperties: schema_of(type)}
  defp schema_of({kind, fields}) when kind in [:object, :shown], do: schema(fields)
  defp schema_of({:schema, schema}), do: schema
  defp schema_of(:any), do: %{}

  @doc "Its fields for a table: name (with dots for one of an object in it), unit, meaning."
  @spec rows([t()]) :: [{String.t(), unit :: String.t() | nil, meaning :: String.t()}]
  def rows(fields), do: rows(fields, "")

  defp rows(fields, above) do
    Enum.flat_map(fields, fn field ->
      name = above <> Atom.to_string(field.name)
      [{name, field.unit, field.meaning} | field.type |> below() |> rows(name <> ".")]
    end)
  end

  defp below({kind, fields}) when kind in [:object, :shown], do: fields
  defp below({kind, type}) when kind in [:list, :map], do: below(type)
  defp below(_other), do: []
end
