defmodule Aerie.JsonSchemaSample do
  @moduledoc """
  Makes values that a JSON Schema takes (`Aerie.JsonSchemaCheck` says so): the smallest, with every key, at the limits and in between. By
  `:rand`, so that a seed gives the same again.
  """

  alias Aerie.JsonSchemaCheck

  # Of one to four bytes, and what programs tend to trip over.
  @characters ~w(a Z 0 - _ . , ; : / & é ß € 漢 😀) ++ [" ", "'", "\"", "\\", "\n", "\t"]
  @tries 200

  @doc "A value. `:least`: only what must be there; `:most`: every property; `:some`: any of them."
  @spec value(map() | boolean(), map(), :least | :most | :some) :: term()
  def value(schema, document, how \\ :some) do
    Enum.find_value(1..@tries, fn _try ->
      value = schema |> flat(document) |> one(document, how)
      if JsonSchemaCheck.errors(schema, value, document) == [], do: {value}
    end)
    |> case do
      {value} -> value
      nil -> raise ArgumentError, "no value found for #{inspect(schema, limit: 20, printable_limit: 300)}"
    end
  end

  # One of its alternatives, with everything that holds besides.
  defp flat(true, _document), do: %{}

  defp flat(schema, document) do
    {branches, own} = Map.split(schema, ["$ref", "allOf", "anyOf", "oneOf"])

    Enum.reduce(branches, own, fn
      {"$ref", reference}, all -> merge(all, flat(JsonSchemaCheck.resolve(reference, document), document))
      {"allOf", schemas}, all -> Enum.reduce(schemas, all, &merge(&2, flat(&1, document)))
      {_one_of, schemas}, all -> merge(all, flat(Enum.random(schemas), document))
    end)
  end

  defp merge(a, b) do
    Map.merge(a, b, fn
      "properties", x, y -> Map.merge(x, y, fn _name, one, other -> %{"allOf" => [one, other]} end)
      "required", x, y -> Enum.uniq(x ++ y)
      "type", x, y -> both(x, y)
      "enum", x, y -> Enum.filter(x, &(&1 in y))
      key, x, y when key in ["minimum", "minLength", "minItems", "minProperties"] -> max(x, y)
      key, x, y when key in ["maximum", "maxLength", "maxItems", "maxProperties"] -> min(x, y)
      "additionalProperties", false, _y -> false
      _key, _x, y -> y
    end)
  end

  defp both(x, y) do
    case for(
           type <- List.wrap(x),
           type in List.wrap(y) or (type == "integer" and "number" in List.wrap(y)),
           do: type
         ) do
      [] -> y
      types -> types
    end
  end

  defp one(%{"const" => value}, _document, _how), do: value
  defp one(%{"enum" => values}, _document, _how) when values != [], do: Enum.random(values)

  defp one(%{"type" => types} = schema, document, how) do
    types = List.wrap(types)
    types = if how == :most and types != ["null"], do: types -- ["null"], else: types
    made(Enum.random(types), schema, document, how)
  end

  defp one(%{"properties" => _some} = schema, document, how), do: made("object", schema, document, how)
  defp one(%{"pattern" => _some} = schema, document, how), do: made("string", schema, document, how)
  defp one(_any, _document, _how), do: Enum.random([1, "a", true, nil, [1], %{"a" => 1}])

  defp made("null", _schema, _document, _how), do: nil
  defp made("boolean", _schema, _document, _how), do: Enum.random([true, false])

  defp made("integer", schema, _document, _how) do
    {low, high} = limits(schema, 1)
    Enum.random([ceil(low), floor(high), Enum.random(ceil(low)..floor(high)//1)])
  end

  defp made("number", schema, _document, _how) do
    {low, high} = limits(schema, 1.0e-6)
    # Not one of the limits' difference, which may be too large for a float.
    Enum.random([low, high, low * 0.5 + high * 0.5, low * 0.9 + high * 0.1])
  end

  defp made("string", %{"format" => "date-time"}, _document, _how) do
    DateTime.utc_now()
    |> DateTime.add(60)
    |> DateTime.truncate(Enum.random([:second, :millisecond]))
    |> DateTime.to_iso8601()
  end

  defp made("string", schema, _document, _how) do
    least = schema["minLength"] || 0
    most = schema["maxLength"] || least + 12
    length = Enum.random([least, most, Enum.random(least..most)])

    case schema["pattern"] do
      nil -> characters(@characters, length)
      pattern -> pattern(pattern, length)
    end
  end

  defp made("array", schema, document, how) do
    least = schema["minItems"] || 0
    most = min(schema["maxItems"] || least + 3, 64)
    count = if how == :least, do: least, else: Enum.random([least, most, Enum.random(least..most)])
    for _n <- 1..count//1, do: value(schema["items"] || %{}, document, how)
  end

  defp made("object", schema, document, how) do
    required = schema["required"] || []
    properties = schema["properties"] || %{}

    chosen =
      for {name, _one} <- properties,
          name in required or how == :most or (how == :some and :rand.uniform(3) == 1),
          do: name

    missing = (schema["minProperties"] || 0) - length(chosen)
    more = if missing > 0, do: Enum.take_random(Map.keys(properties) -- chosen, missing), else: []
    named = Map.new(chosen ++ more, &{&1, value(properties[&1], document, how)})
    Map.merge(more(schema, document, how, map_size(named)), named)
  end

  defp more(%{"additionalProperties" => %{} = one} = schema, document, how, there) do
    least = max((schema["minProperties"] || 0) - there, 0)
    count = if how == :least, do: least, else: least + :rand.uniform(3)
    names = Map.put_new(schema["propertyNames"] || %{"minLength" => 1}, "type", "string")
    for _n <- 1..count//1, into: %{}, do: {value(names, document, how), value(one, document, how)}
  end

  defp more(_closed_or_open, _document, _how, _there), do: %{}

  defp limits(schema, beside) do
    low = schema["minimum"] || above(schema["exclusiveMinimum"], beside)
    high = schema["maximum"] || above(schema["exclusiveMaximum"], -beside)
    low = low || min(-1000, (high || 0) - 1000)
    {low, high || max(1000, low + 1000)}
  end

  defp above(nil, _beside), do: nil
  defp above(limit, beside), do: limit + beside

  defp characters(pool, length), do: for(_n <- 1..length//1, into: "", do: Enum.random(pool))

  # --- Patterns: sequences, alternatives, classes and repetitions. What may be repeated without end is, about `length` times.

  defp pattern(pattern, length) do
    {alternatives, ""} =
      pattern |> String.trim_leading("^") |> String.trim_trailing("$") |> alternatives([[]])

    text(alternatives, length)
  end

  defp text(alternatives, length) do
    for {atom, {least, most}} <- Enum.random(alternatives), into: "" do
      count =
        if most == :any, do: max(least, length), else: Enum.random([least, most, Enum.random(least..most)])

      for _n <- 1..count//1, into: "", do: atom(atom, length)
    end
  end

  defp atom({:group, alternatives}, length),
    do: text(alternatives, if(length > 0, do: :rand.uniform(length), else: 0))

  defp atom({:pool, pool}, _length), do: Enum.random(pool)
  defp atom(:nothing, _length), do: ""

  defp alternatives("", done), do: {finished(done), ""}
  defp alternatives(")" <> rest, done), do: {finished(done), rest}
  defp alternatives("|" <> rest, done), do: alternatives(rest, [[] | done])

  defp alternatives("(?!" <> rest, done) do
    {_never, rest} = alternatives(rest, [[]])
    add(:nothing, rest, done)
  end

  defp alternatives("(?:" <> rest, done), do: alternatives("(" <> rest, done)

  defp alternatives("(" <> rest, done) do
    {group, rest} = alternatives(rest, [[]])
    add({:group, group}, rest, done)
  end

  defp alternatives("[" <> rest, done) do
    [_all, class, rest] = Regex.run(~r/\A((?:\\.|[^\]\\])+)\](.*)\z/s, rest)
    regex = JsonSchemaCheck.regex("^[#{class}]$")
    pool = for character <- @characters ++ Enum.map(?!..?~, &<<&1>>), character =~ regex, do: character
    add({:pool, pool}, rest, done)
  end

  defp alternatives("\\" <> <<character::utf8, rest::binary>>, done),
    do: add({:pool, [<<character::utf8>>]}, rest, done)

  defp alternatives(<<character::utf8, rest::binary>>, done),
    do: add({:pool, [<<character::utf8>>]}, rest, done)

  defp add(atom, rest, [sequence | others]) do
    {times, rest} = times(rest)
    alternatives(rest, [[{atom, times} | sequence] | others])
  end

  defp times("*" <> rest), do: {{0, :any}, rest}
  defp times("+" <> rest), do: {{1, :any}, rest}
  defp times("?" <> rest), do: {{0, 1}, rest}

  defp times("{" <> rest) do
    [numbers, rest] = String.split(rest, "}", parts: 2)

    case numbers |> String.split(",") |> Enum.map(&String.to_integer/1) do
      [n] -> {{n, n}, rest}
      [least, most] -> {{least, most}, rest}
    end
  end

  defp times(rest), do: {{1, 1}, rest}

  defp finished(alternatives), do: Enum.map(alternatives, &Enum.reverse/1)
end
