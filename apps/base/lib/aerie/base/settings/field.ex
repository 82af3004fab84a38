defmodule Aerie.Base.Settings.Field do
  @moduledoc """
  One key of the configuration or of a request: its type, default, meaning and limits. A schema is a list of fields.

  Types:

    * `:string`, `:boolean`, `:secret` (a string kept in `Aerie.Base.Secret`), `:path` (a folder of the gateway's own,
      or a program), `:file` (a file or folder that it only reads)
    * `{:integer, min, max}`, `{:number, min, max}` (integers allowed, the result is a float); both ends included
    * `{:enum, atoms}` - one of a fixed set, written as its name
    * `{:parse, fun, words}` - a string; `fun.(string)` gives `{:ok, value}`, `:error`, or `{:error, words}` when
      it knows better than `words` what was expected
    * `{:section, fields}` - keys below this one
    * `:token` - a name that can stand in a NATS subject; `{:text, min, max}` - printable text of so many characters;
      `{:bytes, max}` - 1 to `max` bytes
    * `{:term, fun, words}` - any value; as `:parse`, but `fun` gets the value itself
    * `{:list, type}`, `{:one_or_list, type}` (a single value means a list of one), `{:map, type}` (free names)

  A key that may be left out without a default has the default nil. A list that is `filled` has an item: left out it
  means all, so an empty one would mean the opposite of what it says. `schema` describes a type that has a function
  (`schema/1`). `was`: keys beside this one that it replaced, each with what to write instead.
  """

  import Aerie.Base.Json.Schema,
    only: [bytes: 1, described: 3, integer: 2, nullable: 1, number: 2, text: 2, token: 0]

  @enforce_keys [:key, :type, :doc]
  defstruct [:key, :type, :doc, :default, :example, :unit, :schema, required: false, filled: false, was: %{}]

  @type type ::
          :string
          | :boolean
          | :secret
          | :path
          | :file
          | {:integer, integer(), integer()}
          | {:number, number(), number()}
          | {:enum, [atom()]}
          | {:parse, (String.t() -> {:ok, term()} | :error | {:error, String.t()}), String.t()}
          | {:section, [t()]}
          | {:list, type()}
          | {:one_or_list, type()}
          | {:map, type()}
          | :token
          | {:text, non_neg_integer(), pos_integer()}
          | {:bytes, pos_integer()}
          | {:term, (term() -> {:ok, term()} | :error | {:error, String.t()}), String.t()}

  @type t :: %__MODULE__{
          key: atom(),
          type: type(),
          doc: String.t(),
          default: term(),
          example: String.t() | nil,
          unit: String.t() | nil,
          schema: Aerie.Base.Json.Schema.t() | nil,
          required: boolean(),
          filled: boolean(),
          was: %{String.t() => hint :: String.t()}
        }

  @doc """
  A leaf. Options: `:default`, `:example` (YAML text shown when there is no default), `:required`, `:filled`, `:unit`,
  `:schema`.
  """
  @spec field(atom(), type(), String.t(), keyword()) :: t()
  def field(key, type, doc, opts \\ []), do: struct!(%__MODULE__{key: key, type: type, doc: doc}, opts)

  @doc "A key with keys below it."
  @spec section(atom(), String.t(), [t()]) :: t()
  def section(key, doc, fields), do: %__MODULE__{key: key, type: {:section, fields}, doc: doc}

  @doc "The name of the key as it is written."
  @spec name(t()) :: String.t()
  def name(%__MODULE__{key: key}), do: Atom.to_string(key)

  @doc "The JSON Schema of the values; null is the same as a key that may be left out."
  @spec schema(t()) :: Aerie.Base.Json.Schema.t()
  def schema(%__MODULE__{} = field) do
    schema = described(field.schema || values(field.type), field.doc, field.unit)
    schema = if field.required, do: schema, else: nullable(schema)
    if field.default == nil, do: schema, else: Map.put(schema, :default, field.default)
  end

  defp values(:token), do: token()
  defp values(:boolean), do: %{type: :boolean}
  defp values({:text, min, max}), do: text(max, min)
  defp values({:bytes, max}), do: bytes(max)
  defp values({:integer, min, max}), do: integer(min, max)
  defp values({:number, min, max}), do: number(min, max)
  defp values({:enum, atoms}), do: %{enum: atoms}
  defp values({:list, type}), do: %{type: :array, items: values(type)}

  @doc "Describes the values of this type."
  @spec expected(type()) :: String.t()
  def expected(:string), do: "text that is not empty"
  def expected(:secret), do: "text that is not empty"
  def expected(type) when type in [:path, :file], do: "a file or folder name"
  def expected(:boolean), do: "true or false"
  def expected({:integer, min, max}), do: "an integer from #{min} to #{max}"
  def expected({:number, min, max}), do: "a number from #{min} to #{max}"
  def expected({:enum, atoms}), do: "one of #{Enum.map_join(atoms, ", ", &Atom.to_string/1)}"
  def expected(:token), do: "1 to 64 letters, digits, - and _"
  def expected({:text, 0, max}), do: "a text of at most #{max} characters"
  def expected({:text, min, max}), do: "a text of #{min} to #{max} characters"
  def expected({:bytes, max}), do: "a text of 1 to #{max} bytes"
  def expected({kind, _fun, words}) when kind in [:parse, :term], do: words
  def expected({:section, _fields}), do: "a section with keys below it"
  def expected({:list, type}), do: "a list, each item: #{expected(type)}"
  def expected({:one_or_list, type}), do: "#{expected(type)}, or a list of them"
  def expected({:map, type}), do: "names with values, each: #{expected(type)}"
end
