defmodule Aerie.Base.Json.Schema do
  @moduledoc """
  Pieces of the JSON Schemas in `docs/asyncapi.json` and `docs/openapi.json`, as maps. Only keywords that draft-07
  (AsyncAPI) and 2020-12 (OpenAPI 3.1) read alike are used. Pure.
  """

  @type t :: %{atom() => term()}

  @token "^[A-Za-z0-9_-]{1,64}$"
  # What `String.printable?/1` takes.
  @printable "^[^\\u0000-\\u0006\\u000e-\\u001a\\u001c-\\u001f\\u0080-\\u009f\\ufffe\\uffff]*$"
  @hours "([01][0-9]|2[0-3]):[0-5][0-9]"
  @time "^[0-9]{4}-(0[1-9]|1[0-2])-(0[1-9]|[12][0-9]|3[01])[T ]#{@hours}:[0-5][0-9]([.,][0-9]+)?(Z|[+]#{@hours}|-(?!00:00)#{@hours})$"

  @doc "A component of the same document."
  @spec ref(atom() | String.t()) :: t()
  def ref(name), do: %{"$ref": "#/components/schemas/#{name}"}

  @doc "An object of these properties; by default of no others, `open: true` of others as well."
  @spec object(map(), [atom() | String.t()], keyword()) :: t()
  def object(properties, required \\ [], options \\ []) do
    {open?, more} = Keyword.pop(options, :open, false)
    schema = Map.merge(%{type: :object, properties: properties}, Map.new(more))
    # A map's keys have no order of their own.
    required = Enum.sort_by(required, &to_string/1)
    schema = if required == [], do: schema, else: Map.put(schema, :required, required)
    if open?, do: schema, else: Map.put(schema, :additionalProperties, false)
  end

  @doc "A printable text of `min` to `max` characters."
  @spec text(pos_integer(), non_neg_integer()) :: t()
  def text(max, min \\ 1), do: %{type: :string, minLength: min, maxLength: max, pattern: @printable}

  @doc """
  A text of 1 to `max` bytes, without NUL. A schema cannot count bytes, so it allows that many
  characters of ASCII, or a quarter as many of any kind.
  """
  @spec bytes(pos_integer()) :: t()
  def bytes(max) do
    ascii = %{maxLength: max, pattern: "^[\\u0001-\\u007f]*$"}
    any = %{maxLength: div(max, 4), pattern: "^[^\\u0000]*$"}
    %{type: :string, minLength: 1, anyOf: [ascii, any]}
  end

  @doc "A name: 1 to 64 letters, digits, - and _."
  @spec token() :: t()
  def token, do: %{type: :string, pattern: @token}

  @doc "A time as ISO 8601 with its offset."
  @spec time() :: t()
  def time, do: %{type: :string, format: :"date-time", pattern: @time, maxLength: 64}

  @doc "A number, both limits included."
  @spec number(number(), number()) :: t()
  def number(min, max), do: %{type: :number, minimum: min, maximum: max}

  @doc "An integer, both limits included."
  @spec integer(integer(), integer()) :: t()
  def integer(min, max), do: %{type: :integer, minimum: min, maximum: max}

  @doc "The same, or null."
  @spec nullable(t()) :: t()
  def nullable(%{enum: values} = schema), do: %{schema | enum: values ++ [nil]} |> typed()
  def nullable(%{type: _one, const: _value} = schema), do: %{anyOf: [schema, %{type: :null}]}
  def nullable(%{type: _one} = schema), do: typed(schema)
  def nullable(schema), do: %{anyOf: [schema, %{type: :null}]}

  defp typed(%{type: types} = schema), do: %{schema | type: Enum.uniq(List.wrap(types) ++ [:null])}
  defp typed(schema), do: schema

  @doc "The schema with what people read beside it; a unit is part of the text."
  @spec described(t(), String.t(), String.t() | nil) :: t()
  def described(schema, meaning, unit \\ nil)
  def described(schema, meaning, nil), do: Map.put(schema, :description, meaning)
  def described(schema, meaning, unit), do: Map.put(schema, :description, "#{meaning} (#{unit})")

  @doc """
  The text of a document: the same bytes each time, keys in their order, what fits on a line on one. `depth`: what is
  nested deeper stays on its line.
  """
  @spec pretty(map(), pos_integer()) :: String.t()
  def pretty(document, depth \\ 4), do: IO.iodata_to_binary([lines(document, 0, depth), "\n"])

  defp lines(map, depth, most) when is_map(map) and map_size(map) > 0 do
    one = IO.iodata_to_binary(line(map))

    if byte_size(one) + 2 * depth <= 120 or depth > most do
      one
    else
      members =
        for {key, value} <- sorted(map),
            do: [indent(depth + 1), JSON.encode!(key), ": ", lines(value, depth + 1, most)]

      ["{\n", Enum.intersperse(members, ",\n"), "\n", indent(depth), "}"]
    end
  end

  defp lines(value, _depth, _most), do: line(value)

  defp line(map) when is_map(map) do
    members = Enum.map_intersperse(sorted(map), ", ", fn {k, v} -> [JSON.encode!(k), ": ", line(v)] end)
    ["{", members, "}"]
  end

  defp line(list) when is_list(list), do: ["[", Enum.map_intersperse(list, ", ", &line/1), "]"]
  defp line(value), do: JSON.encode!(value)

  defp sorted(map), do: map |> Enum.map(fn {key, value} -> {to_string(key), value} end) |> Enum.sort()

  defp indent(depth), do: String.duplicate("  ", depth)
end
