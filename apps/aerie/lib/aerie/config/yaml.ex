defmodule Aerie.Config.Yaml do
  @moduledoc """
  Reads YAML text into plain values: maps with string keys, lists, strings, numbers, booleans and nil. Text never becomes an atom.

  `:fast_yaml` parses with libyaml in C, which recurses: a few thousand nested brackets end the whole VM. Size, line
  length and brackets are therefore checked before it gets the text. It does not know aliases either (`*name` becomes
  the string "name"), so they are refused rather than misread; this also excludes alias bombs.
  """

  @max_bytes 262_144
  @max_line 1_000
  @max_brackets 1_000

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

  @doc "Parses one YAML document of any shape; for values given as text (environment, command line)."
  @spec parse_value(binary()) :: {:ok, term()} | {:error, reason()}
  def parse_value(text) when is_binary(text) do
    with :ok <- limits(text), {:ok, documents} <- decode(text) do
      case documents do
        [] -> {:ok, nil}
        [document] -> convert(document)
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

  defp convert(document) do
    {:ok, value(document)}
  catch
    {:bad_key, expected, got} -> error(nil, expected, got)
  end

  defp value(:undefined), do: nil
  defp value([{_, _} | _] = pairs), do: Enum.reduce(pairs, %{}, &put/2)
  defp value(list) when is_list(list), do: Enum.map(list, &value/1)
  defp value(scalar), do: scalar

  # A duplicate key is an error, because one of the two lines would silently have no effect.
  defp put({key, value}, map) do
    key = key_text(key)
    if is_map_key(map, key), do: throw({:bad_key, "each key once", "\"#{String.slice(key, 0, 60)}\" twice"})
    Map.put(map, key, value(value))
  end

  defp key_text(key) when is_binary(key), do: key
  defp key_text(key) when is_number(key) or is_boolean(key), do: to_string(key)
  defp key_text(_key), do: throw({:bad_key, "keys that are plain words", "a key of another kind"})

  defp error(line, expected, got), do: {:error, %{line: line, expected: expected, got: got}}
end
