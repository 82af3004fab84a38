defmodule MavCodec.Definition.Facts do
  @moduledoc """
  The facts of a definition file, one a line, in the order of the XML. The text in `priv/definitions` is made of them,
  and so is a `MavCodec.Definition.Document`. Its checks are here: all that do not depend on includes.

      file tiny.xml
      include minimal.xml

      enum MAV_KIND bitmask
        MAV_KIND_ONE 1

      message 300 TINY
        uint32_t time_boot_ms units=ms
        extensions
        char[8] text

  In the text, spaces and backslashes of a word are written `\\s` and `\\\\`. The same facts always give the same bytes.
  """

  alias MavCodec.Definition.{Document, Error, Layout}
  alias MavCodec.Definition.Document.{Entry, Enumeration, Field, Message}

  @header "# Facts of a MAVLink definition, made by `mix mav.import`. Do not edit.\n"

  @max_id 0xFFFFFF
  @max_fields 64
  @max_payload 255
  @max_value 0xFFFF_FFFF_FFFF_FFFF

  @scalars Map.new(
             ~w(char int8 uint8 int16 uint16 int32 uint32 int64 uint64 float double)a,
             &{Layout.type_name(&1), &1}
           )

  @typedoc "The line that it comes from, how deep it is indented, and its words, such as `enum=MAV_STATE`."
  @type fact :: {line :: pos_integer(), depth :: 0..2, [String.t()]}

  @doc "Facts as text."
  @spec text([fact()]) :: iodata()
  def text(facts), do: [@header | Enum.map(facts, &line/1)]

  defp line({_line, depth, [kind | _] = words}) do
    space = if depth == 0 and kind in ["enum", "message"], do: "\n", else: ""
    [space, List.duplicate("  ", depth), Enum.map_intersperse(words, " ", &escape/1), "\n"]
  end

  defp escape(word), do: word |> String.replace("\\", "\\\\") |> String.replace(" ", "\\s")

  @doc "The facts in a text."
  @spec facts(String.t()) :: [fact()]
  def facts(text) do
    for {line, number} <- text |> String.split("\n") |> Enum.with_index(1),
        line != "" and not String.starts_with?(line, "#") do
      {depth, words} = indented(line, 0)
      {number, depth, words |> String.split(" ") |> Enum.map(&unescape/1)}
    end
  end

  defp indented("  " <> line, depth), do: indented(line, depth + 1)
  defp indented(line, depth), do: {depth, line}

  defp unescape(word) do
    if String.contains?(word, "\\"),
      do: Regex.replace(~r/\\(.)/, word, fn _, escaped -> if escaped == "s", do: " ", else: escaped end),
      else: word
  end

  @doc "The document that facts describe; `file` is for error messages."
  @spec document([fact()], String.t()) :: {:ok, Document.t()} | {:error, Error.t()}
  def document(facts, file) do
    document = sections(facts, %Document{file: file})
    unique(document.messages, & &1.id, &"message id #{&1}")
    unique(document.messages, & &1.name, &"message name #{&1}")
    {:ok, document}
  catch
    {:definition, line, reason} -> {:error, %Error{file: file, line: line, reason: reason}}
  end

  defp sections([{line, 0, words} | facts], document) do
    {inside, facts} = Enum.split_while(facts, fn {_line, depth, _words} -> depth > 0 end)
    sections(facts, section(words, line, inside, document))
  end

  defp sections([], document) do
    %{
      document
      | includes: Enum.reverse(document.includes),
        enums: Enum.reverse(document.enums),
        messages: Enum.reverse(document.messages)
    }
  end

  defp sections([{line, _depth, _words} | _facts], _document), do: no_fact(line)

  defp section(["file", name], _line, [], document), do: %{document | file: name}

  defp section(["version", text], line, [], document),
    do: %{document | version: integer(text, 255, line, "version")}

  defp section(["dialect", text], line, [], document),
    do: %{document | dialect: integer(text, 255, line, "dialect")}

  defp section(["include", name], line, [], document),
    do: %{document | includes: [{name, line} | document.includes]}

  defp section(["enum", name | words], line, inside, document) do
    entries = entries(inside, [])
    unique(entries, & &1.name, &"entry #{&1} of enum #{name}")
    unique(entries, & &1.value, &"value #{&1} of enum #{name}")
    enum = %Enumeration{name: name(name, "enum", line), line: line, entries: entries}
    %{document | enums: [status(enum, words, line) | document.enums]}
  end

  defp section(["message", id, name | words], line, inside, document) do
    message = %Message{
      id: integer(id, @max_id, line, "id of #{name}"),
      name: name(name, "message", line),
      line: line,
      file: document.file,
      fields: fields(inside, false, [])
    }

    check(message)
    %{document | messages: [status(message, words, line) | document.messages]}
  end

  defp section(_words, line, _inside, _document), do: no_fact(line)

  ## Enums

  defp entries([{line, 1, [name, value | words]} | facts], entries) do
    {params, facts} = Enum.split_while(facts, &match?({_line, 2, _words}, &1))
    params = Enum.map(params, &param/1)
    unique(params, &elem(&1, 0), &"parameter #{&1} of #{name}", fn _param -> line end)
    {status, own} = Enum.split_with(words, &String.starts_with?(&1, ["wip", "deprecated=", "replaced_by="]))

    entry = %Entry{
      name: name(name, "entry", line),
      value: integer(value, @max_value, line, "value of #{name}"),
      line: line,
      params: params,
      facts: Enum.map(own, &pair(&1, line))
    }

    entries(facts, [status(entry, status, line) | entries])
  end

  defp entries([], entries), do: Enum.reverse(entries)
  defp entries([{line, _depth, _words} | _facts], _entries), do: no_fact(line)

  defp param({line, 2, ["param", index | words]}) do
    index = integer(index, 7, line, "index")
    if index == 0, do: fail(line, "index is 0, expected 1 to 7")
    {index, Enum.map(words, &pair(&1, line))}
  end

  defp param({line, _depth, _words}), do: no_fact(line)

  ## Messages

  defp fields([{_line, 1, ["extensions"]} | facts], _extension?, fields), do: fields(facts, true, fields)

  defp fields([{line, 1, [type, name | words]} | facts], extension?, fields) do
    {type, length} = type(type, name, line)
    name = name(name, "field", line)
    field = %Field{name: name, type: type, length: length, line: line, extension: extension?}
    fields(facts, extension?, [Enum.reduce(words, field, &field_fact(&1, &2, line)) | fields])
  end

  defp fields([], _extension?, fields), do: Enum.reverse(fields)
  defp fields([{line, _depth, _words} | _facts], _extension?, _fields), do: no_fact(line)

  defp type(text, name, line) do
    case String.split(text, ["[", "]"]) do
      [base] when is_map_key(@scalars, base) -> {@scalars[base], nil}
      [base, length, ""] when is_map_key(@scalars, base) -> {@scalars[base], array(length, text, name, line)}
      _other -> no_type(text, name, line)
    end
  end

  defp array(text, type, name, line) do
    case Integer.parse(text) do
      {length, ""} when length in 1..255 -> length
      {length, ""} -> fail(line, "field #{name} is an array of #{length}, expected 1 to 255")
      _other -> no_type(type, name, line)
    end
  end

  @spec no_type(String.t(), String.t(), pos_integer()) :: no_return()
  defp no_type(text, name, line), do: fail(line, "field #{name} has the unknown type #{inspect(text)}")

  defp field_fact("instance", field, _line), do: %{field | instance: true}
  defp field_fact("bitmask", field, _line), do: %{field | bitmask: true}
  defp field_fact("bytes", %{type: :char} = field, _line), do: %{field | type: :uint8, bytes: true}

  defp field_fact("constant=" <> text, field, line),
    do: %{field | constant: integer(text, 255, line, "constant of #{field.name}")}

  for key <- ~w(enum units invalid multiplier min max increment default format)a do
    defp field_fact(unquote("#{key}=") <> value, field, _line), do: %{field | unquote(key) => value}
  end

  defp field_fact(_other, _field, line), do: no_fact(line)

  defp check(%Message{name: name, fields: fields, line: line}) do
    # Field names become lower-case keys, so two of them must not differ only in case.
    unique(fields, &String.downcase(&1.name), &"field #{&1} of #{name}")
    if fields == [], do: fail(line, "#{name} has no fields")

    if length(fields) > @max_fields,
      do: fail(line, "#{name} has #{length(fields)} fields, more than #{@max_fields}")

    size = Enum.sum_by(fields, &Layout.bytes/1)

    if size > @max_payload,
      do: fail(line, "#{name} has a payload of #{size} bytes, more than #{@max_payload}")
  end

  ## Shared

  defp status(thing, words, line) do
    Enum.reduce(words, thing, fn
      "wip", thing -> %{thing | wip: true}
      "bitmask", %{bitmask: false} = thing -> %{thing | bitmask: true}
      "deprecated=" <> since, thing -> %{thing | deprecated: {since, ""}}
      "replaced_by=" <> by, %{deprecated: {since, ""}} = thing -> %{thing | deprecated: {since, by}}
      _other, _thing -> no_fact(line)
    end)
  end

  defp pair(word, line) do
    case :binary.split(word, "=") do
      [key, value] -> {key, value}
      _other -> no_fact(line)
    end
  end

  defp name(name, what, line) do
    if name?(name),
      do: name,
      else: fail(line, "#{what} name #{inspect(name)}: expected letters, digits and _, at most 64")
  end

  defp name?(<<first, rest::binary>>) when first in ?A..?Z or first in ?a..?z,
    do: byte_size(rest) < 64 and word?(rest)

  defp name?(_other), do: false

  defp word?(<<c, rest::binary>>) when c in ?A..?Z or c in ?a..?z or c in ?0..?9 or c == ?_, do: word?(rest)
  defp word?(rest), do: rest == ""

  defp integer(text, max, line, what) do
    case Integer.parse(text) do
      {integer, ""} when integer in 0..max//1 -> integer
      _other -> fail(line, "#{what} is #{inspect(text)}, expected an integer from 0 to #{max}")
    end
  end

  defp unique(items, key, describe, line \\ & &1.line) do
    Enum.reduce(items, %{}, fn item, seen ->
      key = key.(item)

      if is_map_key(seen, key),
        do: fail(line.(item), "#{describe.(key)} is defined twice (first in line #{seen[key]})"),
        else: Map.put(seen, key, line.(item))
    end)
  end

  @spec no_fact(pos_integer()) :: no_return()
  defp no_fact(line), do: fail(line, "not a line of facts")

  @spec fail(pos_integer(), String.t()) :: no_return()
  defp fail(line, reason), do: throw({:definition, line, reason})
end
