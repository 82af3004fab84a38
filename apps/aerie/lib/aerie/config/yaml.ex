defmodule Aerie.Config.Yaml do
  @moduledoc """
  Reads YAML text into plain values: maps with string keys, lists, strings, numbers, booleans and nil. Text never becomes an atom.

  `:fast_yaml` parses with libyaml in C, which recurses: a few thousand nested brackets end the whole VM. Size, line
  length and brackets are therefore checked before it gets the text. It does not know aliases either (`*name` becomes
  the string "name"), so they are refused rather than misread; this also excludes alias bombs. Nor does it tell lines:
  `Aerie.Config.Yaml.Lines` finds them in the text.
  """

  alias Aerie.Config.Yaml.Lines

  @max_bytes 262_144
  @max_line 1_000
  @max_brackets 1_000
  # 64 bits with a sign, where the C code stops.
  @longest 9_223_372_036_854_775_807
  @shortest -9_223_372_036_854_775_808

  @type reason :: %{line: pos_integer() | nil, expected: String.t(), got: String.t() | nil}

  @doc "Parses one YAML document whose top is a mapping. An empty text is an empty mapping."
  @spec parse(binary()) :: {:ok, %{String.t() => term()}} | {:error, reason()}
  def parse(text) when is_binary(text) do
    with {:ok, value} <- parse_value(text) do
      case value do
        nil -> {:ok, %{}}
        [] -> {:ok, %{}}
        %{} = map -> {:ok, map}
        _ -> error(1, "keys with values at the top of the file", "something else")
      end
    end
  end

  @doc "The line of each key of a text, by its path; of what cannot be parsed, none."
  @spec lines(binary()) :: Lines.t()
  def lines(text) do
    with :ok <- limits(text),
         {:ok, [document]} <- decode(text),
         do: Lines.of(document, text),
         else: (_unreadable -> %{})
  end

  @doc "Parses one YAML document of any shape; for values given as text (environment, command line)."
  @spec parse_value(binary()) :: {:ok, term()} | {:error, reason()}
  def parse_value(text) when is_binary(text) do
    with :ok <- limits(text), {:ok, documents} <- decode(text) do
      case documents do
        [] -> {:ok, nil}
        [document] -> convert(document, text)
        [_ | _] -> error(nil, "one YAML document", "#{length(documents)} documents")
      end
    end
  end

  defp limits(text) do
    cond do
      byte_size(text) > @max_bytes ->
        error(nil, "at most #{@max_bytes} bytes", "#{byte_size(text)} bytes")

      not String.valid?(text) ->
        error(invalid_line(text), "UTF-8 text", "bytes that are not")

      brackets(text) > @max_brackets ->
        error(nil, "at most #{@max_brackets} brackets", "#{brackets(text)}")

      true ->
        text |> String.split("\n") |> Enum.with_index(1) |> Enum.find_value(:ok, &line_problem/1)
    end
  end

  defp brackets(text), do: text |> :binary.matches(["[", "{"]) |> length()

  defp invalid_line(text) do
    {_, valid, _} = :unicode.characters_to_binary(text) |> then(&if is_tuple(&1), do: &1, else: {:ok, &1, ""})
    1 + length(:binary.matches(valid, "\n"))
  end

  defp line_problem({line, number}) do
    cond do
      byte_size(line) > @max_line ->
        error(number, "lines of at most #{@max_line} bytes", "#{byte_size(line)} bytes")

      Regex.match?(~r/(?:^|[:\-,\[{])\s*\*[A-Za-z0-9_-]+/, without_quotes_and_comment(line)) ->
        error(number, "a plain value: YAML aliases (*name) are not read", nil)

      true ->
        nil
    end
  end

  defp without_quotes_and_comment(line) do
    line |> String.replace(~r/"(?:[^"\\]|\\.)*"|'[^']*'/, "\"\"") |> String.replace(~r/(^|\s)#.*$/, "")
  end

  defp decode(text) do
    case :fast_yaml.decode(text, [:sane_scalars]) do
      {:ok, documents} -> {:ok, documents}
      {:error, {_kind, message, line, _column}} -> error(line + 1, "valid YAML", to_string(message))
      {:error, _other} -> error(nil, "valid YAML", "something the YAML parser cannot read")
    end
  catch
    _kind, _reason -> error(nil, "valid YAML", "something the YAML parser cannot read")
  end

  defp convert(document, text) do
    {:ok, value(document, [])}
  catch
    {:bad_key, path, expected, got} -> error(Map.get(Lines.of(document, text), path), expected, got)
  end

  defp value(:undefined, _path), do: nil
  defp value([{_, _} | _] = pairs, path), do: Enum.reduce(pairs, %{}, &put(&1, &2, path))

  defp value(list, path) when is_list(list),
    do: for({item, index} <- Enum.with_index(list), do: value(item, [index | path]))

  # The reader gives the same for every longer number.
  defp value(number, path) when number in [@longest, @shortest],
    do:
      throw({:bad_key, Enum.reverse(path), "numbers of at most 18 digits (a text in quotes)", "a longer one"})

  defp value(scalar, _path), do: scalar

  # A duplicate key is an error, because one of the two lines would silently have no effect.
  defp put({key, value}, map, above) do
    key = key_text(key, above)
    path = [key | above]

    if is_map_key(map, key),
      do: throw({:bad_key, twice(path), "each key once", "\"#{String.slice(key, 0, 60)}\" twice"})

    Map.put(map, key, value(value, path))
  end

  # Its second occurrence (`Aerie.Config.Yaml.Lines`).
  defp twice(path), do: Enum.reverse([:again | path])

  defp key_text(key, _above) when is_binary(key), do: key
  defp key_text(key, _above) when is_number(key) or is_boolean(key), do: to_string(key)

  defp key_text(_key, above),
    do: throw({:bad_key, Enum.reverse(above), "keys that are plain words", "a key of another kind"})

  defp error(line, expected, got), do: {:error, %{line: line, expected: expected, got: got}}
end
