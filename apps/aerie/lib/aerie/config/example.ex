defmodule Aerie.Config.Example do
  @moduledoc """
  The text of `config/gateway.example.yaml`, made from `Aerie.Config.Keys`: every key with its meaning, type and default,
  commented out, so that the unchanged file means the defaults. `mix aerie.config.example` writes it.
  """

  alias Aerie.Config.Keys
  alias Aerie.Base.Settings.Field

  @head """
  # Aerie gateway: every key with its meaning and default. Made from the schema by `mix aerie.config.example`.
  # A line "#key: value" shows the default (or, where it says so, an example); take the # away to set it.
  # Each key can also be set by the environment: AERIE_ and the path in capitals, as AERIE_NATS_URL for nats.url;
  # lists and maps as YAML or JSON text. The command line comes last and wins.
  # The relative name of a key, a certificate or another file to read begins at the folder of this file, that of a folder for the
  # gateway's data at AERIE_HOME (in a checkout, the checkout).
  """

  @doc "The whole file."
  @spec yaml() :: String.t()
  def yaml, do: @head <> Enum.map_join(Keys.fields(), "", &("\n" <> render(&1, [])))

  defp render(%Field{type: {:section, fields}} = field, above) do
    path = above ++ [Field.name(field)]
    separator = if field.doc == "" or Enum.all?(fields, &(&1.doc == "")), do: "", else: "\n"
    comment(field.doc, above) <> indent(above) <> Field.name(field) <> ":\n" <> body(fields, path, separator)
  end

  defp render(%Field{doc: ""} = field, above), do: line(field, above)

  defp render(field, above) do
    comment(field.doc, above) <> comment(facts(field), above) <> line(field, above) <> env(field, above)
  end

  defp body(fields, path, separator), do: fields |> Enum.map(&render(&1, path)) |> Enum.join(separator)

  defp env(_field, _above), do: ""

  defp line(field, above), do: "#{indent(above)}##{Field.name(field)}: #{example(field)}\n"

  defp example(%Field{example: example}) when is_binary(example), do: example
  defp example(%Field{default: default}), do: value(default)

  defp facts(%Field{type: type} = field) do
    default =
      cond do
        field.example && field.default in [nil, []] -> "No default; the line shows an example."
        true -> "Default: #{value(field.default)}."
      end

    kind = if simple?(type), do: "Must be #{Field.expected(type)}. ", else: ""
    kind <> default
  end

  defp simple?({structure, _}) when structure in [:list, :map], do: false
  defp simple?(type), do: type not in [:string, :secret, :path, :file]

  defp value(nil), do: "null"
  defp value([]), do: "[]"
  defp value(list) when is_list(list), do: "[" <> Enum.map_join(list, ", ", &value/1) <> "]"
  defp value(map) when map == %{}, do: "{}"

  defp value(map) when is_map(map),
    do: "{" <> Enum.map_join(map, ", ", fn {k, v} -> "#{k}: #{value(v)}" end) <> "}"

  defp value(float) when is_float(float) and trunc(float) == float, do: Integer.to_string(trunc(float))
  defp value(value) when is_number(value) or is_boolean(value), do: to_string(value)
  defp value(atom) when is_atom(atom), do: Atom.to_string(atom)

  defp value(text) when is_binary(text) do
    if text =~ ~r/\A[A-Za-z][A-Za-z0-9\/_-]*\z/, do: text, else: inspect(text)
  end

  defp comment(text, above) do
    text |> String.split("\n", trim: true) |> Enum.map_join("", &"#{indent(above)}# #{&1}\n")
  end

  defp indent(above), do: String.duplicate("  ", length(above))
end
