defmodule MavCodec.Definition.Parser do
  @moduledoc """
  Reads a definition file in MAVLink's XML and checks everything that does not depend on its includes.

  Unknown elements inside messages, enums and entries are errors (a misspelt `<field>` would silently change the wire
  format); unknown attributes are ignored.

  A `char[]` is text unless it has `display="bytes"`. MAVLink has no such attribute: of its own messages, those in
  `@bytes` are meant so.
  """

  alias MavCodec.Definition.{Document, Error, Layout, XML}
  alias MavCodec.Definition.Document.{Entry, Enumeration, Field, Message}

  @max_id 0xFFFFFF
  @max_fields 64
  @max_payload 255
  @max_value 0xFFFF_FFFF_FFFF_FFFF
  @name ~r/\A[A-Za-z][A-Za-z0-9_]{0,63}\z/

  @types %{
    "char" => :char,
    "int8" => :int8,
    "uint8" => :uint8,
    "int16" => :int16,
    "uint16" => :uint16,
    "int32" => :int32,
    "uint32" => :uint32,
    "int64" => :int64,
    "uint64" => :uint64,
    "float" => :float,
    "double" => :double
  }

  # A number of `param_type` in the first of its bytes, or text (P8).
  @bytes for message <- ~w(PARAM_EXT_VALUE PARAM_EXT_SET PARAM_EXT_ACK), do: {message, "param_value"}

  @doc "Reads the XML in `bytes`; `file` is the name for error messages and in the facts."
  @spec parse(binary(), String.t()) :: {:ok, Document.t()} | {:error, Error.t()}
  def parse(bytes, file) do
    case XML.parse(bytes) do
      {:ok, root} -> {:ok, document(root, file)}
      {:error, line, reason} -> {:error, %Error{file: file, line: line, reason: reason}}
    end
  catch
    {:definition, line, reason} -> {:error, %Error{file: file, line: line, reason: reason}}
  end

  defp document({:element, "mavlink", _attributes, children, _line}, file) do
    document =
      children
      |> elements("mavlink", ~w(include version dialect enums messages))
      |> Enum.reduce(%Document{file: file}, &section/2)

    document = %{
      document
      | includes: Enum.reverse(document.includes),
        enums: document.enums |> Enum.reverse() |> merge_enums(),
        messages: Enum.reverse(document.messages)
    }

    unique(document.messages, & &1.id, &"message id #{&1}")
    unique(document.messages, & &1.name, &"message name #{&1}")
    constants(document)
  end

  defp document({:element, name, _attributes, _children, line}, _file),
    do: fail(line, "the root element is <#{name}>, expected <mavlink>")

  defp section({:element, "include", _, _, line} = element, document) do
    case XML.text(element) do
      "" -> fail(line, "empty <include>")
      name -> %{document | includes: [{name, line} | document.includes]}
    end
  end

  defp section({:element, "version", _, _, line} = element, document),
    do: %{document | version: integer(XML.text(element), 255, line, "version")}

  defp section({:element, "dialect", _, _, line} = element, document),
    do: %{document | dialect: integer(XML.text(element), 255, line, "dialect")}

  defp section({:element, "enums", _, children, _}, document) do
    enums = children |> elements("enums", ["enum"]) |> Enum.map(&enumeration/1)
    %{document | enums: Enum.reverse(enums, document.enums)}
  end

  defp section({:element, "messages", _, children, _}, document) do
    messages = children |> elements("messages", ["message"]) |> Enum.map(&message(&1, document.file))
    %{document | messages: Enum.reverse(messages, document.messages)}
  end

  ## Enums

  defp enumeration({:element, "enum", attributes, children, line}) do
    name = name(attributes, "enum", line)
    parts = elements(children, "enum #{name}", ~w(description deprecated superseded wip entry))

    {entries, _highest} =
      parts
      |> Enum.filter(&match?({:element, "entry", _, _, _}, &1))
      |> Enum.map_reduce(0, &entry/2)

    unique(entries, & &1.name, &"entry #{&1} of enum #{name}")
    unique(entries, & &1.value, &"value #{&1} of enum #{name}")

    %Enumeration{
      name: name,
      line: line,
      bitmask: boolean(attributes, "bitmask", line),
      entries: entries,
      deprecated: deprecated(parts),
      wip: wip?(parts)
    }
  end

  # As in pymavlink: an entry without a value gets the highest value of its enum so far plus one.
  defp entry({:element, "entry", attributes, children, line}, highest) do
    name = name(attributes, "entry", line)
    parts = elements(children, "entry #{name}", ~w(description deprecated superseded wip param))

    value =
      case attribute(attributes, "value") do
        nil -> highest + 1
        text -> integer(text, @max_value, line, "value of #{name}")
      end

    params = for {:element, "param", attributes, _, line} <- parts, do: param(attributes, line)
    unique(params, &elem(&1, 0), &"parameter #{&1} of #{name}", fn _param -> line end)

    facts =
      for key <- ~w(hasLocation isDestination missionOnly),
          value = attribute(attributes, key),
          do: {key, value}

    entry = %Entry{
      name: name,
      value: value,
      line: line,
      params: params,
      facts: facts,
      deprecated: deprecated(parts),
      wip: wip?(parts)
    }

    {entry, max(highest, value)}
  end

  @param_keys ~w(label units enum minValue maxValue increment default reserved multiplier)

  defp param(attributes, line) do
    index = attributes |> required("index", "param", line) |> integer(7, line, "index")
    if index == 0, do: fail(line, "index is 0, expected 1 to 7")
    {index, for(key <- @param_keys, value = attribute(attributes, key), value != "", do: {key, value})}
  end

  # An enum in two pieces in one file is merged like two in two files.
  defp merge_enums(enums) do
    enums
    |> Enum.map(& &1.name)
    |> Enum.uniq()
    |> Enum.map(fn name ->
      [first | _] = pieces = Enum.filter(enums, &(&1.name == name))
      entries = Enum.flat_map(pieces, & &1.entries)
      unique(entries, & &1.name, &"entry #{&1} of enum #{name}")
      unique(entries, & &1.value, &"value #{&1} of enum #{name}")
      %{first | bitmask: Enum.any?(pieces, & &1.bitmask), entries: entries}
    end)
  end

  ## Messages

  defp message({:element, "message", attributes, children, line}, file) do
    name = name(attributes, "message", line)
    id = attributes |> required("id", "message #{name}", line) |> integer(@max_id, line, "id of #{name}")
    parts = elements(children, "message #{name}", ~w(description deprecated superseded wip field extensions))

    {fields, _extension?} =
      Enum.flat_map_reduce(parts, false, fn
        {:element, "extensions", _, _, _}, _extension? ->
          {[], true}

        {:element, "field", attributes, _, line}, extension? ->
          {[attributes |> field(line, extension?) |> bytes(name, attributes)], extension?}

        _other, extension? ->
          {[], extension?}
      end)

    message = %Message{
      id: id,
      name: name,
      line: line,
      file: file,
      fields: fields,
      deprecated: deprecated(parts),
      wip: wip?(parts)
    }

    check_message(message)
    message
  end

  defp check_message(%Message{name: name, fields: fields, line: line} = message) do
    # Field names become lower-case keys, so two of them must not differ only in case.
    unique(fields, &String.downcase(&1.name), &"field #{&1} of #{name}")
    if fields == [], do: fail(line, "#{name} has no fields")

    if length(fields) > @max_fields,
      do: fail(line, "#{name} has #{length(fields)} fields, more than #{@max_fields}")

    case Layout.of(message).max do
      size when size > @max_payload ->
        fail(line, "#{name} has a payload of #{size} bytes, more than #{@max_payload}")

      _size ->
        :ok
    end
  end

  defp field(attributes, line, extension?) do
    name = name(attributes, "field", line)
    {type, length, constant} = attributes |> required("type", "field #{name}", line) |> type(name, line)

    %Field{
      name: name,
      type: type,
      length: length,
      constant: constant,
      line: line,
      extension: extension?,
      enum: attribute(attributes, "enum"),
      units: units(attribute(attributes, "units")),
      invalid: attribute(attributes, "invalid"),
      multiplier: attribute(attributes, "multiplier"),
      min: attribute(attributes, "minValue"),
      max: attribute(attributes, "maxValue"),
      increment: attribute(attributes, "increment"),
      default: attribute(attributes, "default"),
      format: attribute(attributes, "print_format"),
      bitmask: attribute(attributes, "display") == "bitmask",
      instance: boolean(attributes, "instance", line)
    }
  end

  defp bytes(%{type: :char, length: length} = field, message, attributes) when length != nil do
    if attribute(attributes, "display") == "bytes" or {message, field.name} in @bytes,
      do: %{field | type: :uint8, bytes: true},
      else: field
  end

  defp bytes(field, _message, _attributes), do: field

  defp units(nil), do: nil
  defp units(text), do: text |> String.trim() |> String.replace(~r/\A\[(.*)\]\z/, "\\1")

  defp type("uint8_t_mavlink_version", _name, _line), do: {:uint8, nil, :version}

  defp type(text, name, line) do
    case Regex.run(~r/\A([a-z0-9_]+?)(?:_t)?(?:\[([0-9]{1,5})\])?\z/, text) do
      [_, "array", length] -> {:int8, array_length(length, name, line), nil}
      [_, base] when is_map_key(@types, base) -> {@types[base], nil, nil}
      [_, base, length] when is_map_key(@types, base) -> {@types[base], array_length(length, name, line), nil}
      _other -> fail(line, "field #{name} has the unknown type #{inspect(text)}")
    end
  end

  defp array_length(text, name, line) do
    case String.to_integer(text) do
      length when length in 1..255 -> length
      length -> fail(line, "field #{name} is an array of #{length}, expected 1 to 255")
    end
  end

  # The value of a uint8_t_mavlink_version field is the file's <version>, which may stand behind it.
  defp constants(%Document{version: version} = document) do
    messages =
      Enum.map(document.messages, fn message ->
        fields = Enum.map(message.fields, &if(&1.constant, do: %{&1 | constant: version || 3}, else: &1))
        %{message | fields: fields}
      end)

    %{document | messages: messages}
  end

  ## Shared

  defp deprecated(parts) do
    Enum.find_value(parts, fn
      {:element, tag, attributes, _, _} when tag in ["deprecated", "superseded"] ->
        {attribute(attributes, "since") || "", attribute(attributes, "replaced_by") || ""}

      _other ->
        nil
    end)
  end

  defp wip?(parts), do: Enum.any?(parts, &match?({:element, "wip", _, _, _}, &1))

  defp elements(children, where, known) do
    Enum.filter(children, fn
      {:element, name, _, _, line} ->
        name in known or fail(line, "<#{name}> inside of #{where}, expected one of #{Enum.join(known, ", ")}")

      {:text, text, line} ->
        if String.trim(text) != "",
          do: fail(line, "text inside of #{where}: #{inspect(String.slice(text, 0, 40))}")

        false
    end)
  end

  defp name(attributes, what, line) do
    name = required(attributes, "name", what, line)

    if name =~ @name,
      do: name,
      else: fail(line, "#{what} name #{inspect(name)}: expected letters, digits and _, at most 64")
  end

  defp attribute(attributes, key) do
    case List.keyfind(attributes, key, 0) do
      {_key, value} -> value
      nil -> nil
    end
  end

  defp required(attributes, key, what, line) do
    case attribute(attributes, key) do
      value when value in [nil, ""] -> fail(line, "#{what} has no attribute #{key}")
      value -> value
    end
  end

  defp boolean(attributes, key, line) do
    case attribute(attributes, key) do
      value when value in [nil, "false", "0"] -> false
      value when value in ["true", "1"] -> true
      value -> fail(line, "#{key}=#{inspect(value)}, expected true or false")
    end
  end

  defp integer(text, max, line, what) do
    case number(String.trim(text)) do
      number when number in 0..max//1 -> number
      _other -> fail(line, "#{what} is #{inspect(text)}, expected an integer from 0 to #{max}")
    end
  end

  # Decimal, hexadecimal, binary, and the powers and shifts that bitmasks are sometimes written with.
  defp number(text) do
    case Regex.run(
           ~r/\A(?:(0[xX])([0-9A-Fa-f]{1,16})|(0[bB])([01]{1,64})|(2\*\*|1<<)([0-9]{1,2})|([0-9]{1,20}))\z/,
           text
         ) do
      [_, _, hex] -> String.to_integer(hex, 16)
      [_, _, _, _, binary] -> String.to_integer(binary, 2)
      [_, _, _, _, _, _, power] -> Integer.pow(2, String.to_integer(power))
      [_, _, _, _, _, _, _, decimal] -> String.to_integer(decimal)
      nil -> nil
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

  @spec fail(pos_integer(), String.t()) :: no_return()
  defp fail(line, reason), do: throw({:definition, line, reason})
end
