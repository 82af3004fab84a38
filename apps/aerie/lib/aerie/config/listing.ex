defmodule Aerie.Config.Listing do
  @moduledoc """
  A configuration in words, for the console's page of settings: each key with its value, where it came from, its unit and meaning. Pure.
  Secrets are "set" or "not set"; URLs are shown without a login.
  """

  alias Aerie.Config
  alias Aerie.Config.Keys
  alias Aerie.Base.Settings.{Field, Schema}
  alias Aerie.Console.Pages.Settings.Configuration

  # The name of a key ends with its unit.
  @units [
    {"_ms", "ms"},
    {"_us", "µs"},
    {"_s", "s"},
    {"_minutes", "min"},
    {"_days", "d"},
    {"_hz", "Hz"},
    {"hz", "Hz"},
    {"_kb", "KiB"},
    {"_mb", "MiB"},
    {"_altitude", "m"},
    {"_altitude_msl", "m"}
  ]
  @max_text 300

  @doc "The sections, in the order of the example file; keys at the top are the section `gateway`."
  @spec sections(Config.t()) :: [Configuration.section()]
  def sections(%Config{} = config) do
    {top, sections} = Enum.split_with(Keys.fields(), &(not match?({:section, _fields}, &1.type)))

    [%{name: "gateway", meaning: "", keys: keys(top, config, [], config)}] ++
      for field <- sections do
        %{name: Field.name(field), meaning: line(field.doc), keys: keys([field], config, [], config)}
      end
  end

  defp keys(fields, values, above, config) do
    Enum.flat_map(fields, fn field ->
      value = Map.get(values, field.key)
      path = above ++ [Field.name(field)]

      case field.type do
        {:section, below} -> keys(below, value || %{}, path, config)
        _leaf -> [key(field, value, Enum.join(path, "."), config)]
      end
    end)
  end

  defp key(field, value, path, config) do
    %{
      path: path,
      value: text(field.type, value),
      default: text(field.type, Schema.default(field)),
      source: config.given[path],
      unit: unit(path),
      expected: Field.expected(field.type),
      meaning: line(field.doc)
    }
  end

  defp unit(path),
    do: Enum.find_value(@units, fn {ending, unit} -> if String.ends_with?(path, ending), do: unit end)

  defp line(doc), do: doc |> String.split() |> Enum.join(" ")

  defp text(:secret, nil), do: "not set"
  defp text(:secret, _value), do: "set"

  defp text(type, value) do
    case format(type, value) do
      text when byte_size(text) > @max_text -> String.slice(text, 0, @max_text) <> " …"
      text -> text
    end
  end

  defp format(_type, nil), do: "–"
  defp format(_type, []), do: "none"
  defp format(_type, map) when map == %{}, do: "none"
  defp format(:secret, _value), do: "set"

  defp format({list, type}, values) when list in [:list, :one_or_list] and is_list(values),
    do: Enum.map_join(values, "; ", &format(type, &1))

  defp format({:map, type}, values) when is_map(values) and not is_struct(values),
    do: Enum.map_join(Enum.sort(values), "; ", fn {name, value} -> "#{name}: #{format(type, value)}" end)

  defp format({:section, fields}, values) when is_map(values) do
    for(field <- fields, value = Map.get(values, field.key), value not in [nil, []], do: {field, value})
    |> Enum.map_join(", ", fn {field, value} -> "#{field.key}: #{format(field.type, value)}" end)
  end

  defp format(_type, number) when is_float(number) and trunc(number) == number and abs(number) < 1.0e15,
    do: Integer.to_string(trunc(number))

  defp format(_type, value) when is_number(value) or is_atom(value), do: to_string(value)

  # A login in an address is as good as a password.
  defp format(_type, text) when is_binary(text), do: String.replace(text, ~r|//[^/@\s]*@|, "//…@")

  defp format(_type, list) when is_list(list), do: Enum.map_join(list, ", ", &format(:any, &1))
  defp format(_type, {host, port}) when is_integer(port), do: "#{format(:any, host)}:#{port}"
  defp format(_type, {_, _, _, _} = ip), do: List.to_string(:inet.ntoa(ip))
  defp format(_type, %_{}), do: "set"

  defp format(_type, map) when is_map(map),
    do: Enum.map_join(map, ", ", fn {k, v} -> "#{format(:any, k)}: #{format(:any, v)}" end)

  defp format(_type, _other), do: "set"
end
