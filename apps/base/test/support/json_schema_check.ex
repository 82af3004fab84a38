defmodule Aerie.JsonSchemaCheck do
  @moduledoc """
  Validates values against JSON Schemas as `docs/asyncapi.json` and `docs/openapi.json` have them; written for the tests, so only the keywords
  that they use are there, and any other one raises. A document is decoded JSON, a schema one of its `components.schemas` or a part of it.
  """

  @ignored ~w(description default examples format contentEncoding title)

  @doc "What is wrong with a value, as texts with the place. `closed: true`: an object may have no key that its schema does not describe."
  @spec errors(map() | boolean(), term(), document :: map(), closed: boolean()) :: [String.t()]
  def errors(schema, value, document, options \\ []) do
    check(schema, value, %{document: document, closed: options[:closed] == true, at: ""})
  end

  @doc "The component of a name."
  @spec component(map(), String.t()) :: map()
  def component(document, name), do: Map.fetch!(document["components"]["schemas"], name)

  @doc "What a reference stands for."
  @spec resolve(String.t(), map()) :: map()
  def resolve("#/" <> path, document) do
    for key <- String.split(path, "/"), reduce: document do
      part -> Map.fetch!(part, key)
    end
  end

  @doc "A pattern, which is ECMA's, for `Regex`."
  @spec regex(String.t()) :: Regex.t()
  def regex(pattern) do
    pattern
    |> String.replace(~r/\\u([0-9a-f]{4})/, "\\x{\\1}")
    |> Regex.compile!([:unicode, :dollar_endonly])
  end

  defp check(true, _value, _context), do: []
  defp check(false, _value, context), do: wrong(context, "nothing is allowed here")
  defp check(schema, value, context), do: Enum.flat_map(schema, &keyword(&1, value, schema, context))

  defp keyword({"$ref", reference}, value, _schema, context),
    do: reference |> resolve(context.document) |> check(value, context)

  defp keyword({"type", types}, value, _schema, context) do
    if Enum.any?(List.wrap(types), &type?(&1, value)),
      do: [],
      else: wrong(context, "#{inspect(value)} is not of #{inspect(types)}")
  end

  defp keyword({"enum", values}, value, _schema, context),
    do: if(value in values, do: [], else: wrong(context, "#{inspect(value)} is not one of the values"))

  defp keyword({"const", const}, value, _schema, context),
    do: if(value === const, do: [], else: wrong(context, "#{inspect(value)} is not #{inspect(const)}"))

  defp keyword({"properties", properties}, value, schema, context) when is_map(value) do
    unknown =
      if context.closed and schema["additionalProperties"] == nil,
        do: Map.keys(value) -- Map.keys(properties),
        else: []

    Enum.flat_map(unknown, &wrong(context, "#{&1} is not described")) ++
      for {name, one} <- properties,
          {:ok, part} <- [Map.fetch(value, name)],
          error <- check(one, part, at(context, name)),
          do: error
  end

  defp keyword({"additionalProperties", one}, value, schema, context) when is_map(value) do
    for {name, part} <- Map.drop(value, Map.keys(schema["properties"] || %{})),
        error <- check(one, part, at(context, name)),
        do: error
  end

  defp keyword({"propertyNames", one}, value, _schema, context) when is_map(value),
    do: for({name, _part} <- value, error <- check(one, name, context), do: error)

  defp keyword({"required", names}, value, _schema, context) when is_map(value),
    do:
      for(
        name <- names,
        not is_map_key(value, name),
        error <- wrong(context, "#{name} is missing"),
        do: error
      )

  defp keyword({"minProperties", n}, value, _schema, context) when is_map(value),
    do: if(map_size(value) >= n, do: [], else: wrong(context, "fewer than #{n} properties"))

  defp keyword({"maxProperties", n}, value, _schema, context) when is_map(value),
    do: if(map_size(value) <= n, do: [], else: wrong(context, "more than #{n} properties"))

  defp keyword({"items", one}, value, _schema, context) when is_list(value) do
    for {part, index} <- Enum.with_index(value), error <- check(one, part, at(context, index)), do: error
  end

  defp keyword({"minItems", n}, value, _schema, context) when is_list(value),
    do: if(length(value) >= n, do: [], else: wrong(context, "fewer than #{n} items"))

  defp keyword({"maxItems", n}, value, _schema, context) when is_list(value),
    do: if(length(value) <= n, do: [], else: wrong(context, "more than #{n} items"))

  defp keyword({"minimum", n}, value, _schema, context) when is_number(value),
    do: if(value >= n, do: [], else: wrong(context, "#{value} is less than #{n}"))

  defp keyword({"maximum", n}, value, _schema, context) when is_number(value),
    do: if(value <= n, do: [], else: wrong(context, "#{value} is more than #{n}"))

  defp keyword({"exclusiveMinimum", n}, value, _schema, context) when is_number(value),
    do: if(value > n, do: [], else: wrong(context, "#{value} is not more than #{n}"))

  defp keyword({"exclusiveMaximum", n}, value, _schema, context) when is_number(value),
    do: if(value < n, do: [], else: wrong(context, "#{value} is not less than #{n}"))

  defp keyword({"minLength", n}, value, _schema, context) when is_binary(value),
    do: if(length(String.codepoints(value)) >= n, do: [], else: wrong(context, "shorter than #{n}"))

  defp keyword({"maxLength", n}, value, _schema, context) when is_binary(value),
    do: if(length(String.codepoints(value)) <= n, do: [], else: wrong(context, "longer than #{n}"))

  defp keyword({"pattern", pattern}, value, _schema, context) when is_binary(value),
    do:
      if(value =~ regex(pattern), do: [], else: wrong(context, "#{inspect(value)} does not match #{pattern}"))

  # Without the key of an alternative that is chosen by it, the errors of each would be listed.
  defp keyword({"anyOf", schemas}, value, _schema, context), do: some(schemas, value, context, &(&1 > 0))
  defp keyword({"oneOf", schemas}, value, _schema, context), do: some(schemas, value, context, &(&1 == 1))

  defp keyword({"allOf", schemas}, value, _schema, context),
    do: Enum.flat_map(schemas, &check(&1, value, context))

  defp keyword({"not", one}, value, _schema, context),
    do: if(check(one, value, context) == [], do: wrong(context, "it is what it must not be"), else: [])

  defp keyword({"format", "date-time"}, value, _schema, context) when is_binary(value) do
    case DateTime.from_iso8601(value) do
      {:ok, _time, _offset} -> []
      {:error, _reason} -> wrong(context, "#{inspect(value)} is not a time")
    end
  end

  defp keyword({key, _}, _value, _schema, _context) when key in @ignored, do: []

  defp keyword({key, _}, _value, _schema, _context)
       when key in ~w(properties additionalProperties propertyNames required minProperties maxProperties items minItems maxItems) or
              key in ~w(minimum maximum exclusiveMinimum exclusiveMaximum minLength maxLength pattern),
       do: []

  defp keyword({key, _}, _value, _schema, _context),
    do: raise(ArgumentError, "the keyword #{key} is not known")

  defp some(schemas, value, context, enough?) do
    results = Enum.map(schemas, &check(&1, value, context))
    fitting = Enum.count(results, &(&1 == []))

    cond do
      enough?.(fitting) ->
        []

      fitting > 0 ->
        wrong(context, "it fits #{fitting} alternatives")

      true ->
        [
          Enum.join(
            ["#{context.at}: none of #{length(schemas)}" | results |> Enum.min_by(&length/1) |> Enum.take(3)],
            "; "
          )
        ]
    end
  end

  defp type?("object", value), do: is_map(value)
  defp type?("array", value), do: is_list(value)
  defp type?("string", value), do: is_binary(value)
  defp type?("boolean", value), do: is_boolean(value)
  defp type?("null", value), do: is_nil(value)
  defp type?("number", value), do: is_number(value)
  defp type?("integer", value), do: is_integer(value) or (is_float(value) and trunc(value) == value)

  defp at(context, name), do: %{context | at: "#{context.at}/#{name}"}
  defp wrong(context, text), do: ["#{context.at}: #{text}"]
end
