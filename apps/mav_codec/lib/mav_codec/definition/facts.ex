defmodule MavCodec.Definition.Facts do
  @moduledoc """
  The text form of a definition file's facts in `priv/definitions`: one fact a line, in the order of the XML. The same
  facts always give the same bytes.

      file tiny.xml
      include minimal.xml

      enum MAV_KIND bitmask
        MAV_KIND_ONE 1

      message 300 TINY
        uint32_t time_boot_ms units=ms
        extensions
        char[8] text

  A value's spaces and backslashes are written `\\s` and `\\\\`.
  """

  alias MavCodec.Definition.{Document, Error, Layout}
  alias MavCodec.Definition.Document.{Entry, Enumeration, Field, Message}

  @header "# Facts of a MAVLink definition, made by `mix mav.import`. Do not edit.\n"

  @field_facts [
    enum: "enum",
    units: "units",
    invalid: "invalid",
    multiplier: "multiplier",
    min: "min",
    max: "max",
    increment: "increment",
    default: "default",
    format: "format"
  ]

  @scalars Map.new(
             ~w(char int8 uint8 int16 uint16 int32 uint32 int64 uint64 float double)a,
             &{Layout.type_name(&1), &1}
           )

  ## Writing

  @doc "The facts of a document as text."
  @spec write(Document.t()) :: iodata()
  def write(%Document{} = document) do
    [
      @header,
      line(["file", escape(document.file)]),
      if(document.version, do: line(["version", "#{document.version}"]), else: []),
      if(document.dialect, do: line(["dialect", "#{document.dialect}"]), else: []),
      for({include, _line} <- document.includes, do: line(["include", escape(include)])),
      Enum.map(document.enums, &write_enum/1),
      Enum.map(document.messages, &write_message/1)
    ]
  end

  defp write_enum(%Enumeration{} = enum) do
    [
      "\n",
      line(["enum", enum.name] ++ flag(enum.bitmask, "bitmask") ++ status(enum)),
      Enum.map(enum.entries, &write_entry/1)
    ]
  end

  defp write_entry(%Entry{} = entry) do
    [
      line(["  " <> entry.name, "#{entry.value}"] ++ pairs(entry.facts) ++ status(entry)),
      for({index, facts} <- entry.params, do: line(["    param", "#{index}"] ++ pairs(facts)))
    ]
  end

  defp write_message(%Message{} = message) do
    {base, extensions} = Enum.split_while(message.fields, &(not &1.extension))

    [
      "\n",
      line(["message", "#{message.id}", message.name] ++ status(message)),
      Enum.map(base, &write_field/1),
      if(extensions == [], do: [], else: [line(["  extensions"]), Enum.map(extensions, &write_field/1)])
    ]
  end

  defp write_field(%Field{} = field) do
    type = Layout.type_name(field) <> if(field.length, do: "[#{field.length}]", else: "")
    facts = for {key, name} <- @field_facts, value = Map.fetch!(field, key), do: {name, value}
    facts = if field.constant, do: facts ++ [{"constant", "#{field.constant}"}], else: facts

    line(
      ["  " <> type, field.name] ++
        pairs(facts) ++
        flag(field.instance, "instance") ++ flag(field.bitmask, "bitmask") ++ flag(field.bytes, "bytes")
    )
  end

  defp status(%{deprecated: deprecated, wip: wip}) do
    case deprecated do
      nil -> flag(wip, "wip")
      {since, replaced_by} -> pairs([{"deprecated", since}, {"replaced_by", replaced_by}]) ++ flag(wip, "wip")
    end
  end

  defp flag(true, name), do: [name]
  defp flag(false, _name), do: []

  defp pairs(pairs), do: for({key, value} <- pairs, do: key <> "=" <> escape(value))
  defp line(words), do: [Enum.intersperse(words, " "), "\n"]

  defp escape(text) do
    text
    |> String.trim()
    |> String.replace(~r/\s+/, " ")
    |> String.replace("\\", "\\\\")
    |> String.replace(" ", "\\s")
  end

  defp unescape(text) do
    if String.contains?(text, "\\") do
      Regex.replace(~r/\\(.)/, text, fn
        _, "s" -> " "
        _, other -> other
      end)
    else
      text
    end
  end

  ## Reading

  @doc "Reads what `write/1` wrote; `path` is for error messages."
  @spec read(binary(), String.t()) :: {:ok, Document.t()} | {:error, Error.t()}
  def read(text, path) do
    lines = text |> String.split("\n") |> Enum.with_index(1)
    {:ok, sections(lines, %Document{file: path})}
  catch
    {:facts, number} -> {:error, %Error{file: path, line: number, reason: "not a line of facts"}}
  end

  defp sections([], document),
    do: %{
      document
      | includes: Enum.reverse(document.includes),
        enums: Enum.reverse(document.enums),
        messages: Enum.reverse(document.messages)
    }

  defp sections([{"", _} | lines], document), do: sections(lines, document)
  defp sections([{"#" <> _, _} | lines], document), do: sections(lines, document)

  defp sections([{line, number} | lines], document) do
    case String.split(line, " ") do
      ["file", name] ->
        sections(lines, %{document | file: unescape(name)})

      ["version", version] ->
        sections(lines, %{document | version: integer(version, number)})

      ["dialect", dialect] ->
        sections(lines, %{document | dialect: integer(dialect, number)})

      ["include", name] ->
        sections(lines, %{document | includes: [{unescape(name), number} | document.includes]})

      ["enum", name | words] ->
        {entries, lines} = entries(lines, [])
        enum = struct!(%Enumeration{name: name, line: number, entries: entries}, status(words, number))
        sections(lines, %{document | enums: [enum | document.enums]})

      ["message", id, name | words] ->
        {fields, lines} = fields(lines, false, [])

        message = %Message{
          id: integer(id, number),
          name: name,
          line: number,
          file: document.file,
          fields: fields
        }

        sections(lines, %{document | messages: [struct!(message, status(words, number)) | document.messages]})

      _other ->
        throw({:facts, number})
    end
  end

  defp entries([{"  " <> line, number} | lines], acc) do
    case String.split(line, " ") do
      [name, value | words] when name != "" ->
        {params, lines} = params(lines, [])
        {facts, words} = Enum.split_with(words, &fact?/1)
        facts = Enum.map(facts, &pair(&1, number))
        {status, facts} = Enum.split_with(facts, fn {key, _value} -> key in ["deprecated", "replaced_by"] end)
        entry = %Entry{name: name, value: integer(value, number), line: number, params: params, facts: facts}
        entries(lines, [struct!(entry, status_of(status, words, number)) | acc])

      _other ->
        throw({:facts, number})
    end
  end

  defp entries(lines, acc), do: {Enum.reverse(acc), lines}

  defp params([{"    param " <> line, number} | lines], acc) do
    [index | words] = String.split(line, " ")
    params(lines, [{integer(index, number), Enum.map(words, &pair(&1, number))} | acc])
  end

  defp params(lines, acc), do: {Enum.reverse(acc), lines}

  defp fields([{"  extensions", _} | lines], false, acc), do: fields(lines, true, acc)

  defp fields([{"  " <> line, number} | lines], extension?, acc) do
    case String.split(line, " ") do
      [type, name | words] ->
        {type, length} = type(type, number)
        field = %Field{name: name, type: type, length: length, line: number, extension: extension?}
        fields(lines, extension?, [Enum.reduce(words, field, &field_fact(&1, &2, number)) | acc])

      _other ->
        throw({:facts, number})
    end
  end

  defp fields(lines, _extension?, acc), do: {Enum.reverse(acc), lines}

  defp type(text, number) do
    case String.split(text, ["[", "]"]) do
      [base] when is_map_key(@scalars, base) -> {@scalars[base], nil}
      [base, length, ""] when is_map_key(@scalars, base) -> {@scalars[base], integer(length, number)}
      _other -> throw({:facts, number})
    end
  end

  defp field_fact("instance", field, _number), do: %{field | instance: true}
  defp field_fact("bitmask", field, _number), do: %{field | bitmask: true}
  defp field_fact("bytes", %{type: :char} = field, _number), do: %{field | type: :uint8, bytes: true}

  for {key, name} <- @field_facts do
    defp field_fact(unquote(name) <> "=" <> value, field, _number),
      do: %{field | unquote(key) => unescape(value)}
  end

  defp field_fact("constant=" <> value, field, number), do: %{field | constant: integer(value, number)}
  defp field_fact(_other, _field, number), do: throw({:facts, number})

  defp status(words, number) do
    {facts, flags} = Enum.split_with(words, &fact?/1)
    facts |> Enum.map(&pair(&1, number)) |> status_of(flags, number)
  end

  defp status_of(facts, flags, number) do
    deprecated =
      case facts do
        [] -> []
        [{"deprecated", since}, {"replaced_by", replaced_by}] -> [deprecated: {since, replaced_by}]
        _other -> throw({:facts, number})
      end

    Enum.reduce(flags, deprecated, fn
      "bitmask", acc -> [{:bitmask, true} | acc]
      "wip", acc -> [{:wip, true} | acc]
      _other, _acc -> throw({:facts, number})
    end)
  end

  defp fact?(word), do: String.contains?(word, "=")

  defp pair(word, number) do
    case :binary.split(word, "=") do
      [key, value] -> {key, unescape(value)}
      _other -> throw({:facts, number})
    end
  end

  defp integer(text, number) do
    case Integer.parse(text) do
      {integer, ""} when integer >= 0 -> integer
      _other -> throw({:facts, number})
    end
  end
end
