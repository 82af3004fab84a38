defmodule Aerie.Base.Settings.Schema do
  @moduledoc """
  Checks a tree of plain values against a list of `Aerie.Base.Settings.Field`s and gives the typed tree, or every
  problem at once.

  Pure. Input values are what YAML gives (maps with string keys, lists, scalars). A value may also be
  `{:text, string}` or `{:text, string, decode}`: a value from the environment or the command line, which is read as
  the type of its key. `decode` reads a text that stands for a list or a map, as `{:ok, value}` or
  `{:error, %{expected: words, got: words}}`.
  """

  alias Aerie.Base.{Json, Secret}
  alias Aerie.Base.Net.Address
  alias Aerie.Base.Settings.{Field, Types}

  @type path :: [String.t() | non_neg_integer()]
  @typedoc "A problem without its file: the caller knows which source a path came from."
  @type problem :: %{path: path(), expected: String.t(), got: String.t() | nil, hint: String.t() | nil}
  @max_items 10_000
  @scalars [:integer, :number, :enum, :parse]

  @doc "The typed tree (atom keys, defaults filled in) and the problems; the tree is only of use without problems."
  @spec validate([Field.t()], term()) :: {map(), [problem()]}
  def validate(fields, raw), do: section(fields, raw, [])

  @doc "The defaults of a list of fields."
  @spec defaults([Field.t()]) :: map()
  def defaults(fields), do: Map.new(fields, &{&1.key, default(&1)})

  @doc "The default of one field."
  @spec default(Field.t()) :: term()
  def default(%Field{type: {:section, fields}}), do: defaults(fields)
  def default(%Field{default: default}), do: default

  @doc "A typed tree that lacks keys, or has nil for them, with the defaults of its fields, also in the sections of its lists."
  @spec complete([Field.t()], map()) :: map()
  def complete(fields, tree), do: Map.new(fields, &{&1.key, completed(&1, tree[&1.key])})

  defp completed(%Field{type: {:section, fields}}, value), do: complete(fields, value || %{})
  defp completed(field, nil), do: default(field)
  defp completed(%Field{type: {:list, {:section, fields}}}, items), do: Enum.map(items, &complete(fields, &1))
  defp completed(_field, value), do: value

  @doc """
  What callers in Elixir write, as the schema reads it: names of keys and values of enumerations are strings there,
  and a key that is nil is left out.
  """
  @spec plain(term()) :: term()
  def plain(map) when is_map(map) and not is_struct(map),
    do: for({key, value} <- map, value != nil, into: %{}, do: {to_string(key), plain(value)})

  def plain(list) when is_list(list), do: Enum.map(list, &plain/1)
  def plain(value) when is_boolean(value) or is_nil(value), do: value
  def plain(atom) when is_atom(atom), do: Atom.to_string(atom)
  def plain(value), do: value

  @doc "Every leaf below the fields, with its path. Lists and maps are leaves."
  @spec leaves([Field.t()], path()) :: [{path(), Field.t()}]
  def leaves(fields, above \\ []) do
    Enum.flat_map(fields, fn
      %Field{type: {:section, below}} = field -> leaves(below, above ++ [Field.name(field)])
      field -> [{above ++ [Field.name(field)], field}]
    end)
  end

  @doc "`did you mean \"x\"?` for the known name that is closest, or nil if none is close."
  @spec did_you_mean(String.t(), [String.t()]) :: String.t() | nil
  def did_you_mean(name, known) do
    name = String.slice(name, 0, 80)

    case Enum.max_by(known, &String.jaro_distance(&1, name), fn -> nil end) do
      nil -> nil
      best -> if String.jaro_distance(best, name) >= 0.77, do: "did you mean \"#{best}\"?"
    end
  end

  defp section(fields, nil, path), do: section(fields, %{}, path)
  defp section(fields, [], path), do: section(fields, %{}, path)

  defp section(fields, raw, path) when is_map(raw) do
    names = Enum.map(fields, &Field.name/1)

    unknown =
      for {name, _value} <- Enum.sort(raw), name not in names do
        hint = replaced(fields, name) || did_you_mean(name, names) || known_keys(names)

        problem(path ++ [name], "a known key", nil, hint)
        |> Map.put(:got, "an unknown one")
      end

    {values, problems} =
      Enum.map_reduce(fields, [], fn field, problems ->
        {value, more} = key(field, Map.fetch(raw, Field.name(field)), path ++ [Field.name(field)])
        {{field.key, value}, problems ++ more}
      end)

    {Map.new(values), unknown ++ problems}
  end

  defp section(fields, raw, path) do
    {defaults(fields), [problem(path, Field.expected({:section, fields}), raw)]}
  end

  defp replaced(fields, name), do: Enum.find_value(fields, & &1.was[name])

  defp known_keys(names) do
    shown = names |> Enum.take(12) |> Enum.join(", ")
    "known here: #{shown}#{if length(names) > 12, do: ", ..."}"
  end

  # A section without keys is one whose keys are all left out.
  defp key(%Field{type: {:section, _fields}} = field, :error, path), do: key(field, {:ok, nil}, path)

  defp key(%Field{type: {:section, fields}}, {:ok, raw}, path) do
    case structured(raw) do
      {:ok, raw} -> section(fields, raw, path)
      {:error, reason} -> {defaults(fields), [syntax(path, reason)]}
    end
  end

  defp key(%Field{required: true} = field, absent, path) when absent in [:error, {:ok, nil}],
    do: {nil, [problem(path, Field.expected(field.type), nil) |> Map.put(:got, "nothing (it is required)")]}

  defp key(field, :error, _path), do: {field.default, []}

  # `max_altitude:` without a value was meant as a limit; the default would be no limit.
  defp key(field, {:ok, nil}, path),
    do: {field.default, [problem(path, Field.expected(field.type), nil, "leave the key out for its default")]}

  defp key(%Field{filled: true} = field, {:ok, raw}, path) do
    case value(field.type, raw, path) do
      {[], []} -> {[], [problem(path, Field.expected(field.type), [], "leave the key out for all")]}
      result -> result
    end
  end

  defp key(field, {:ok, raw}, path), do: value(field.type, raw, path)

  defp value({:section, fields}, raw, path),
    do: key(%Field{key: :_, type: {:section, fields}, doc: ""}, {:ok, raw}, path)

  defp value({:one_or_list, type}, raw, path) do
    case comma_list(raw) do
      list when is_list(list) -> value({:list, type}, list, path)
      single -> value({:list, type}, [single], path)
    end
  end

  defp value(type, {:text, text, _decode}, path) when is_atom(type) or elem(type, 0) in @scalars,
    do: value(type, {:text, text}, path)

  defp value({:list, type}, raw, path) when is_tuple(raw) do
    case structured(raw) do
      {:ok, list} when is_list(list) -> value({:list, type}, list, path)
      {:ok, _other} -> value({:list, type}, comma_list(raw), path)
      {:error, reason} -> {[], [syntax(path, reason)]}
    end
  end

  defp value({:list, _type} = list, raw, path) when is_list(raw) and length(raw) > @max_items,
    do: {[], [problem(path, Field.expected(list) <> ", at most #{@max_items}", raw)]}

  defp value({:list, type}, raw, path) when is_list(raw) do
    {values, problems} =
      raw |> Enum.with_index() |> Enum.map(fn {item, i} -> value(type, item, path ++ [i]) end) |> Enum.unzip()

    {values, Enum.concat(problems)}
  end

  defp value({:map, type}, raw, path) do
    case structured(raw) do
      {:ok, map} when is_map(map) ->
        {pairs, problems} =
          map
          |> Enum.sort()
          |> Enum.map(fn {name, item} ->
            {item, problems} = value(type, item, path ++ [name])
            {{name, item}, problems}
          end)
          |> Enum.unzip()

        {Map.new(pairs), Enum.concat(problems)}

      {:ok, []} ->
        {%{}, []}

      {:ok, _other} ->
        {%{}, [problem(path, Field.expected({:map, type}), raw)]}

      {:error, reason} ->
        {%{}, [syntax(path, reason)]}
    end
  end

  defp value(type, raw, path) do
    case scalar(type, raw) do
      {:ok, value} -> {value, []}
      {:error, expected} -> {nil, [problem(path, expected, raw)]}
      :error -> {nil, [refused(type, raw, path)]}
    end
  end

  defp refused(:secret, "", path), do: problem(path, Field.expected(:secret), "")

  defp refused(:secret, number, path) when is_number(number) do
    # The YAML reader drops leading zeros and cuts long numbers.
    %{problem(path, Field.expected(:secret), :hidden, "write it in quotes") | got: "a number"}
  end

  defp refused(:secret, _hidden, path), do: problem(path, Field.expected(:secret), :hidden)
  defp refused(type, raw, path), do: problem(path, Field.expected(type), raw)

  defp scalar(type, {:text, text}) when type in [:string, :secret, :path, :file], do: scalar(type, text)
  defp scalar(:string, text) when is_binary(text), do: if(blank?(text), do: :error, else: {:ok, text})
  # A version or a call sign that happens to look like a number is still text to its writer.
  defp scalar(:string, number) when is_integer(number), do: {:ok, Integer.to_string(number)}

  defp scalar(:secret, text) when is_binary(text),
    do: if(blank?(text), do: :error, else: {:ok, Secret.new(text)})

  defp scalar(type, text) when type in [:path, :file] and is_binary(text) and text != "", do: {:ok, text}
  defp scalar(:boolean, bool) when is_boolean(bool), do: {:ok, bool}
  defp scalar(:boolean, {:text, text}) when text in ~w(true 1 yes on), do: {:ok, true}
  defp scalar(:boolean, {:text, text}) when text in ~w(false 0 no off), do: {:ok, false}

  # JSON writers turn 3 into 3.0 at will; the range goes first, because trunc/1 of a huge float is a huge integer.
  defp scalar({:integer, min, max}, n) when is_number(n) and n >= min and n <= max and trunc(n) == n,
    do: {:ok, trunc(n)}

  defp scalar({:integer, _, _} = type, {:text, text}) do
    with {n, ""} <- Integer.parse(text), do: scalar(type, n), else: (_ -> :error)
  end

  defp scalar({:number, min, max}, n) when is_number(n) and n >= min and n <= max, do: {:ok, n / 1}

  defp scalar({:number, _, _} = type, {:text, text}) do
    with {n, ""} <- Float.parse(text), do: scalar(type, n), else: (_ -> :error)
  end

  defp scalar({:enum, atoms}, text) when is_binary(text) do
    with nil <- Enum.find(atoms, &(Atom.to_string(&1) == text)), do: :error, else: (atom -> {:ok, atom})
  end

  defp scalar({:enum, _} = type, {:text, text}), do: scalar(type, text)
  # `off` for a key whose names are true/false-like in YAML: the YAML reader has already made a boolean of it.
  defp scalar({:enum, _} = type, bool) when is_boolean(bool), do: scalar(type, to_string(bool))
  defp scalar({:parse, fun, _}, text) when is_binary(text), do: fun.(text)
  defp scalar({:parse, fun, _}, number) when is_integer(number), do: fun.(Integer.to_string(number))
  defp scalar({:parse, _, _} = type, {:text, text}), do: scalar(type, text)
  defp scalar({:term, fun, _}, {:text, text}), do: fun.(text)
  defp scalar({:term, fun, _}, value), do: fun.(value)

  defp scalar(type, {:text, text}) when type == :token or elem(type, 0) in [:text, :bytes],
    do: scalar(type, text)

  defp scalar(:token, text) when is_binary(text), do: Types.parse_token(text)
  defp scalar({:text, min, max}, text), do: if(Json.text?(text, min, max), do: {:ok, text}, else: :error)
  defp scalar({:bytes, max}, text) when is_binary(text) and byte_size(text) in 1..max//1, do: {:ok, text}
  defp scalar(_type, _raw), do: :error

  defp blank?(text), do: String.trim(text) == ""

  # Text given for a key with structure is YAML (and so JSON too): AERIE_LINKS='[{id: a, url: "tcp:10.0.0.2:5760"}]'
  defp structured({:text, text, decode}), do: decode.(text)
  defp structured(raw), do: {:ok, raw}

  defp comma_list(raw) when is_tuple(raw) do
    case structured(raw) do
      {:ok, list} when is_list(list) -> list
      _no_list -> raw |> elem(1) |> String.split(",", trim: true) |> Enum.map(&{:text, String.trim(&1)})
    end
  end

  defp comma_list(raw), do: raw

  defp syntax(path, reason), do: %{path: path, expected: reason.expected, got: reason.got, hint: nil}

  defp problem(path, expected, raw, hint \\ nil)
  defp problem(path, expected, :hidden, hint), do: %{path: path, expected: expected, got: nil, hint: hint}
  defp problem(path, expected, nil, hint), do: %{path: path, expected: expected, got: "nothing", hint: hint}

  defp problem(path, expected, raw, hint),
    do: %{path: path, expected: expected, got: show(raw), hint: hint}

  @doc "A value as it would be written in YAML, cut to a readable length."
  @spec show(term()) :: String.t()
  def show(text) when elem(text, 0) == :text, do: show(elem(text, 1))
  def show(nil), do: "nothing"
  def show(value) when is_binary(value), do: "\"#{value |> Address.shown() |> printable()}\""
  def show(value) when is_map(value), do: "a section (#{map_size(value)} keys)"
  def show([]), do: "an empty list"
  def show(value) when is_list(value), do: "a list (#{length(value)} items)"
  def show(value) when is_number(value) or is_boolean(value), do: to_string(value)
  def show(_value), do: "something else"

  defp printable(text) do
    text = Aerie.Base.Printable.line(text)
    if String.length(text) > 60, do: String.slice(text, 0, 57) <> "...", else: text
  end
end
