defmodule MavCodec.Definition.Importer.Parser do
  @moduledoc """
  Turns a definition file in MAVLink's XML into facts (`MavCodec.Definition.Facts`), in the order of the XML.

  Unknown elements inside messages, enums and entries are errors (a misspelt `<field>` would silently change the wire
  format); unknown attributes are ignored. What the facts must be is checked by their reader.

  A `char[]` is text unless it has `display="bytes"`. MAVLink has no such attribute: of its own messages, those in
  `@bytes` are meant so.
  """

  alias MavCodec.Definition.{Document, Error, Facts}
  alias MavCodec.Definition.Importer.XML

  @types ~w(char int8 uint8 int16 uint16 int32 uint32 int64 uint64 float double)

  # A number of `param_type` in the first of its bytes, or text (P8).
  @bytes for message <- ~w(PARAM_EXT_VALUE PARAM_EXT_SET PARAM_EXT_ACK), do: {message, "param_value"}

  # Attributes and the names of their facts.
  @entry_facts for key <- ~w(hasLocation isDestination missionOnly), do: {key, key}
  @param_facts for key <- ~w(label units enum minValue maxValue increment default reserved multiplier),
                   do: {key, key}
  @field_facts [{"minValue", "min"}, {"maxValue", "max"}, {"print_format", "format"}] ++
                 for(key <- ~w(enum units invalid multiplier increment default), do: {key, key})
  @field_order ~w(enum units invalid multiplier min max increment default format)

  @doc "Reads the XML in `bytes`; `file` is the name for error messages and in the facts."
  @spec parse(binary(), String.t()) :: {:ok, Document.t()} | {:error, Error.t()}
  def parse(bytes, file), do: with({:ok, facts} <- facts(bytes, file), do: Facts.document(facts, file))

  @doc "The facts of the XML in `bytes`."
  @spec facts(binary(), String.t()) :: {:ok, [Facts.fact()]} | {:error, Error.t()}
  def facts(bytes, file) do
    case XML.parse(bytes) do
      {:ok, root} -> {:ok, document(root, file)}
      {:error, line, reason} -> {:error, %Error{file: file, line: line, reason: reason}}
    end
  catch
    {:definition, line, reason} -> {:error, %Error{file: file, line: line, reason: reason}}
  end

  defp document({:element, "mavlink", _attributes, children, _line}, file) do
    parts = elements(children, "mavlink", ~w(include version dialect enums messages))
    version = last(parts, "version")
    enums = for enum <- inside(parts, "enums", "enum"), do: enumeration(enum)
    # The value of a uint8_t_mavlink_version field is the file's <version>, which may stand behind it.
    number = with {_line, _depth, ["version", number]} <- version, do: number
    messages = for message <- inside(parts, "messages", "message"), do: message(message, number || "3")
    head = for fact <- [version, last(parts, "dialect")], fact != nil, do: fact
    List.flatten([{1, 0, ["file", file]}, head, includes(parts), merged(enums), messages])
  end

  defp document({:element, name, _attributes, _children, line}, _file),
    do: fail(line, "the root element is <#{name}>, expected <mavlink>")

  defp includes(parts) do
    for {:element, "include", _, _, line} = element <- parts do
      case XML.text(element) do
        "" -> fail(line, "empty <include>")
        name -> {line, 0, ["include", name]}
      end
    end
  end

  defp last(parts, name) do
    Enum.reduce(parts, nil, fn
      {:element, ^name, _, _, line} = element, _before ->
        {line, 0, [name, element |> XML.text() |> decimal()]}

      _other, before ->
        before
    end)
  end

  defp inside(parts, section, name) do
    for {:element, ^section, _, children, _} <- parts,
        element <- elements(children, section, [name]),
        do: element
  end

  ## Enums

  defp enumeration({:element, "enum", attributes, children, line}) do
    name = required(attributes, "name", "enum", line)
    parts = elements(children, "enum #{name}", ~w(description deprecated superseded wip entry))

    {entries, _highest} =
      parts
      |> Enum.filter(&match?({:element, "entry", _, _, _}, &1))
      |> Enum.map_reduce(0, &entry/2)

    {name, boolean(attributes, "bitmask", line), line, status(parts), entries}
  end

  # An enum in two pieces in one file is merged like two in two files.
  defp merged(enums) do
    for name <- enums |> Enum.map(&elem(&1, 0)) |> Enum.uniq() do
      [{_name, _bitmask?, line, status, _entries} | _] = pieces = Enum.filter(enums, &(elem(&1, 0) == name))
      bitmask = if Enum.any?(pieces, &elem(&1, 1)), do: ["bitmask"], else: []
      [{line, 0, ["enum", name] ++ bitmask ++ status} | Enum.map(pieces, &elem(&1, 4))]
    end
  end

  # As in pymavlink: an entry without a value gets the highest value of its enum so far plus one.
  defp entry({:element, "entry", attributes, children, line}, highest) do
    name = required(attributes, "name", "entry", line)
    parts = elements(children, "entry #{name}", ~w(description deprecated superseded wip param))

    value = decimal(attribute(attributes, "value") || "#{highest + 1}")
    highest = with {number, ""} <- Integer.parse(value), do: max(highest, number), else: (_other -> highest)
    fact = {line, 1, [name, value] ++ pairs(attributes, @entry_facts) ++ status(parts)}
    {[fact | for({:element, "param", attributes, _, line} <- parts, do: param(attributes, line))], highest}
  end

  defp param(attributes, line) do
    index = required(attributes, "index", "param", line)
    given = Enum.reject(attributes, fn {_key, value} -> value == "" end)
    {line, 2, ["param", decimal(index)] ++ pairs(given, @param_facts)}
  end

  ## Messages

  defp message({:element, "message", attributes, children, line}, version) do
    name = required(attributes, "name", "message", line)
    id = attributes |> required("id", "message #{name}", line) |> decimal()
    parts = elements(children, "message #{name}", ~w(description deprecated superseded wip field extensions))

    fields =
      for {:element, tag, attributes, _, line} when tag in ["field", "extensions"] <- parts do
        if tag == "field", do: field(attributes, name, version, line), else: {line, 1, ["extensions"]}
      end

    [{line, 0, ["message", id, name | status(parts)]} | fields]
  end

  defp field(attributes, message, version, line) do
    name = required(attributes, "name", "field", line)
    {type, constant} = attributes |> required("type", "field #{name}", line) |> type(version)
    given = for {key, value} <- attributes, do: {key, if(key == "units", do: units(value), else: value)}
    facts = pairs(given, for(fact <- @field_order, do: List.keyfind(@field_facts, fact, 1)))
    display = attribute(attributes, "display")

    bytes? = String.starts_with?(type, "char[") and (display == "bytes" or {message, name} in @bytes)
    flags = [instance: boolean(attributes, "instance", line), bitmask: display == "bitmask", bytes: bytes?]
    {line, 1, [type, name] ++ facts ++ constant ++ for({flag, true} <- flags, do: Atom.to_string(flag))}
  end

  defp units(text), do: text |> String.trim() |> String.replace(~r/\A\[(.*)\]\z/, "\\1")

  # As facts have it; anything else as it is, for the reader to refuse.
  defp type("uint8_t_mavlink_version", version), do: {"uint8_t", ["constant=" <> version]}

  defp type(text, _version) do
    case Regex.run(~r/\A([a-z0-9_]+?)(?:_t)?(\[[0-9]{1,5}\])?\z/, text) do
      [_, "array", length] -> {"int8_t" <> length, []}
      [_, base | length] when base in ~w(char float double) -> {IO.iodata_to_binary([base | length]), []}
      [_, base | length] when base in @types -> {IO.iodata_to_binary([base, "_t" | length]), []}
      _other -> {text, []}
    end
  end

  ## Shared

  defp status(parts) do
    deprecated =
      Enum.find_value(parts, [], fn
        {:element, tag, attributes, _, _} when tag in ["deprecated", "superseded"] ->
          ["deprecated=" <> value(attributes, "since"), "replaced_by=" <> value(attributes, "replaced_by")]

        _other ->
          nil
      end)

    if Enum.any?(parts, &match?({:element, "wip", _, _, _}, &1)), do: deprecated ++ ["wip"], else: deprecated
  end

  defp pairs(attributes, facts) do
    for {key, fact} <- facts, attribute(attributes, key), do: fact <> "=" <> value(attributes, key)
  end

  defp value(attributes, key),
    do: (attribute(attributes, key) || "") |> String.trim() |> String.replace(~r/\s+/, " ")

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

  defp attribute(attributes, key), do: with({_key, value} <- List.keyfind(attributes, key, 0), do: value)

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

  # An integer in the ways that definitions write it (decimal, hexadecimal, binary, and the powers and shifts that
  # bitmasks are sometimes written with) as facts have it; anything else as it is, for the reader to refuse.
  defp decimal(text) do
    text = String.trim(text)

    case Regex.run(
           ~r/\A(?:(0[xX])([0-9A-Fa-f]{1,16})|(0[bB])([01]{1,64})|(2\*\*|1<<)([0-9]{1,2})|([0-9]{1,20}))\z/,
           text
         ) do
      [_, _, hex] -> "#{String.to_integer(hex, 16)}"
      [_, _, _, _, binary] -> "#{String.to_integer(binary, 2)}"
      [_, _, _, _, _, _, power] -> "#{Integer.pow(2, String.to_integer(power))}"
      [_, _, _, _, _, _, _, decimal] -> "#{String.to_integer(decimal)}"
      nil -> text
    end
  end

  @spec fail(pos_integer(), String.t()) :: no_return()
  defp fail(line, reason), do: throw({:definition, line, reason})
end
