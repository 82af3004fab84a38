defmodule MavCodec.Msp.Definition do
  @moduledoc """
  Reads the tables of messages in `priv/msp`, while the codec is compiled.

      @ NAME ID read|write [since=V] [until=V] [sizes=A,B,..|exact=A,B,..] [min=N] [max=N] [each=N] [armed=yes|ask|no]
      [channels] [eeprom] [restart] [never=WHY]
      q FIELD ...     the payload of the request, or: q like NAME, that of the other one's reply
      r FIELD ...     the payload of the reply
      n TEXT          a note

  A field is `name:type[:unit[:scale]][@since][<until]`, a list `name[5] { FIELD ... }` or `name[count] { FIELD ... }` with the
  count in the field of this name, `name[] { FIELD ... }` one to the end, and `? { FIELD ... }` what is there as a whole or not at all.
  A write without `armed` is not for armed vehicles. `MavCodec.Msp.Message` and `MavCodec.Msp.Field` tell what it all means.
  """

  alias MavCodec.Msp.{Field, Message}

  @types ~w(u8 u16 u32 u64 i8 i16 i32 pstr zstr strrest rest)

  @doc "The messages of a table, in its order. An error raises with the number of its line."
  @spec parse!(String.t()) :: [Message.t()]
  def parse!(text) do
    text
    |> String.split("\n")
    |> Enum.with_index(1)
    |> Enum.reduce([], fn {line, number}, messages ->
      try do
        line(String.trim(line), messages)
      rescue
        error -> reraise "line #{number}: #{Exception.message(error)}: #{line}", __STACKTRACE__
      end
    end)
    |> like()
    |> Enum.reverse()
  end

  # The other message may come later.
  defp like(messages) do
    replies = Map.new(messages, &{&1.name, &1.reply})

    Enum.map(messages, fn
      %{request: {:like, name}} = message -> %{message | request: Map.fetch!(replies, name)}
      message -> message
    end)
  end

  defp line("", messages), do: messages
  defp line("#" <> _, messages), do: messages

  defp line("@ " <> rest, messages) do
    {rest, never} = split_reason(rest)
    [name, id, kind | attributes] = String.split(rest)
    kind = kind(kind)
    armed = if kind == :write, do: :no, else: :yes
    message = %Message{name: name, id: number(id), kind: kind, armed: armed, never: never}

    if Enum.any?(messages, &(&1.id == message.id or &1.name == name)), do: raise("it is there twice")
    [Enum.reduce(attributes, message, &attribute/2) | messages]
  end

  defp line("q like " <> name, [message | rest]), do: [%{message | request: {:like, name}} | rest]
  defp line("q " <> fields, [message | rest]), do: [%{message | request: layout(fields)} | rest]
  defp line("r " <> fields, [message | rest]), do: [%{message | reply: layout(fields)} | rest]
  defp line("n " <> text, [message | rest]), do: [%{message | note: text} | rest]
  defp line(_other, _messages), do: raise("expected @, q, r or n")

  # The reason is the rest of the line.
  defp split_reason(rest) do
    case String.split(rest, " never=", parts: 2) do
      [rest] -> {rest, nil}
      [rest, why] -> {rest, why}
    end
  end

  defp kind("read"), do: :read
  defp kind("write"), do: :write

  defp attribute("since=" <> version, message), do: %{message | since: version(version)}
  defp attribute("until=" <> version, message), do: %{message | until: version(version)}
  defp attribute("exact=" <> sizes, message), do: %{attribute("sizes=" <> sizes, message) | exact?: true}

  defp attribute("sizes=" <> sizes, message) do
    sizes = sizes |> String.split(",") |> Enum.map(&String.to_integer/1)
    %{message | sizes: sizes, min: hd(sizes)}
  end

  defp attribute("min=" <> n, message), do: %{message | min: String.to_integer(n)}
  defp attribute("max=" <> n, message), do: %{message | max: String.to_integer(n)}
  defp attribute("each=" <> n, message), do: %{message | each: String.to_integer(n)}
  defp attribute("armed=yes", message), do: %{message | armed: :yes}
  defp attribute("armed=ask", message), do: %{message | armed: :ask}
  defp attribute("armed=no", message), do: %{message | armed: :no}
  defp attribute("channels", message), do: %{message | channels?: true}
  defp attribute("eeprom", message), do: %{message | eeprom?: true}
  defp attribute("restart", message), do: %{message | restart?: true}

  defp layout(text) do
    {layout, []} = text |> String.split() |> fields([])
    layout
  end

  defp fields([], layout), do: {Enum.reverse(layout), []}
  defp fields(["}" | rest], layout), do: {Enum.reverse(layout), rest}

  defp fields(["?", "{" | rest], layout) do
    {inner, rest} = fields(rest, [])
    fields(rest, [{:optional, inner} | layout])
  end

  defp fields([head, "{" | rest], layout) do
    [_, key, count] = Regex.run(~r/\A(\w+)\[(\w*)\]\z/, head)
    {inner, rest} = fields(rest, [])
    fields(rest, [{:list, String.to_atom(key), count(count), inner} | layout])
  end

  defp fields([field | rest], layout), do: fields(rest, [field(field) | layout])

  defp count(""), do: :rest

  defp count(text) do
    case Integer.parse(text) do
      {number, ""} -> number
      _name -> String.to_atom(text)
    end
  end

  @field ~r/\A(?<key>[^:@<]+):(?<type>[a-z]+\d*)(?::(?<unit>[^:@<]+))?(?::(?<scale>[^:@<]+))?(?:@(?<since>[\d.]+))?(?:<(?<until>[\d.]+))?\z/

  defp field(text) do
    %{"key" => key, "type" => type, "unit" => unit, "scale" => scale} =
      parts =
      Regex.named_captures(@field, text) || raise "#{text} is not a field"

    %Field{
      key: String.to_atom(key),
      type: type(type),
      unit: if(unit not in ["", "-"], do: unit),
      scale: scale(scale),
      since: version(parts["since"]),
      until: version(parts["until"])
    }
  end

  defp type(type) when type in @types, do: String.to_atom(type)
  defp type("str" <> bytes), do: {:text, String.to_integer(bytes)}
  defp type("raw" <> bytes), do: {:raw, String.to_integer(bytes)}

  defp scale(""), do: 1
  defp scale("1/" <> n), do: 1 / String.to_integer(n)

  defp scale(text) do
    case Integer.parse(text) do
      {number, ""} -> number
      _float -> text |> Float.parse() |> elem(0)
    end
  end

  defp version(""), do: nil

  defp version(text) do
    [major, minor] = String.split(text, ".")
    {String.to_integer(major), String.to_integer(minor)}
  end

  defp number("0x" <> hex), do: String.to_integer(hex, 16)
  defp number(decimal), do: String.to_integer(decimal)
end
