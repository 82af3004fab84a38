defmodule MavCodec.Definition.XML do
  @moduledoc """
  A small strict XML reader for definition files, with line numbers.

  It reads elements, attributes, text, CDATA, comments, processing instructions, the five predefined entities and numeric
  character references. It refuses what no definition file needs: a document type declaration (and with it custom
  entities), another encoding than UTF-8, files over 4 MB, nesting deeper than 16.
  """

  @max_bytes 4 * 1024 * 1024
  @max_depth 16
  @space ~c" \t\r\n"

  @typedoc "Name, attributes in order, children in order, line of the start tag."
  @type element ::
          {:element, name :: String.t(), [{String.t(), String.t()}], [element() | text()],
           line :: pos_integer()}
  @type text :: {:text, String.t(), line :: pos_integer()}

  @doc "Reads a document and returns its root element, or the line and the reason of an error."
  @spec parse(binary()) :: {:ok, element()} | {:error, pos_integer() | nil, String.t()}
  def parse(bytes) when byte_size(bytes) > @max_bytes, do: {:error, nil, "larger than #{@max_bytes} bytes"}

  def parse(bytes) do
    bytes = String.replace_prefix(bytes, "\uFEFF", "")

    if String.valid?(bytes) do
      {rest, line} = misc(bytes, 1, true)
      {root, rest, line} = root(rest, line)
      {rest, line} = misc(rest, line, false)
      if rest == "", do: {:ok, root}, else: fail(line, "text after the root element")
    else
      fail(invalid_line(bytes), "not UTF-8")
    end
  catch
    {:xml, line, reason} -> {:error, line, reason}
  end

  @doc "All text directly inside an element, trimmed."
  @spec text(element()) :: String.t()
  def text({:element, _name, _attributes, children, _line}) do
    children
    |> Enum.map_join(fn
      {:text, text, _line} -> text
      _element -> ""
    end)
    |> String.trim()
  end

  defp root("<" <> rest, line), do: element(rest, line, 1)
  defp root("", line), do: fail(line, "no element")
  defp root(_rest, line), do: fail(line, "text outside of the root element")

  # Parts that may come before and after the root element.
  defp misc(<<c, rest::binary>>, line, start?) when c in @space, do: misc(rest, next(c, line), start?)
  defp misc("<!--" <> rest, line, _start?), do: rest |> skip("-->", line, "comment") |> misc_on()

  defp misc("<!DOCTYPE" <> _rest, line, _start?),
    do: fail(line, "a document type declaration is not accepted")

  defp misc("<?xml" <> rest, line, true) do
    {declaration, rest, next_line} = take(rest, "?>", line, "XML declaration")

    case Regex.run(~r/encoding\s*=\s*["']([^"']*)["']/, declaration) do
      [_, name] ->
        if String.downcase(name) not in ["utf-8", "us-ascii"], do: fail(line, "encoding #{name}: not UTF-8")

      nil ->
        :ok
    end

    misc(rest, next_line, false)
  end

  defp misc("<?" <> rest, line, _start?), do: rest |> skip("?>", line, "processing instruction") |> misc_on()
  defp misc(rest, line, _start?), do: {rest, line}

  defp misc_on({rest, line}), do: misc(rest, line, false)

  defp element(_rest, line, depth) when depth > @max_depth,
    do: fail(line, "elements nested deeper than #{@max_depth}")

  defp element(rest, line, depth) do
    {name, rest} = name(rest, line)
    {attributes, closed?, rest, next_line} = attributes(rest, line, [])

    if closed? do
      {{:element, name, attributes, [], line}, rest, next_line}
    else
      {children, rest, end_line} = content(rest, next_line, name, line, depth, [])
      {{:element, name, attributes, children, line}, rest, end_line}
    end
  end

  defp content("</" <> rest, line, name, start, _depth, acc) do
    {closing, rest} = name(rest, line)
    if closing != name, do: fail(line, "</#{closing}> closes <#{name}> of line #{start}")

    case space(rest, line) do
      {">" <> rest, line} -> {Enum.reverse(acc), rest, line}
      {_rest, line} -> fail(line, "</#{closing}: expected >")
    end
  end

  defp content("<!--" <> rest, line, name, start, depth, acc) do
    {rest, line} = skip(rest, "-->", line, "comment")
    content(rest, line, name, start, depth, acc)
  end

  defp content("<![CDATA[" <> rest, line, name, start, depth, acc) do
    {text, rest, next_line} = take(rest, "]]>", line, "CDATA section")
    content(rest, next_line, name, start, depth, [{:text, text, line} | acc])
  end

  defp content("<!" <> _rest, line, _name, _start, _depth, _acc),
    do: fail(line, "a declaration is not accepted here")

  defp content("<?" <> rest, line, name, start, depth, acc) do
    {rest, line} = skip(rest, "?>", line, "processing instruction")
    content(rest, line, name, start, depth, acc)
  end

  defp content("<" <> rest, line, name, start, depth, acc) do
    {child, rest, line} = element(rest, line, depth + 1)
    content(rest, line, name, start, depth, [child | acc])
  end

  defp content("", line, name, start, _depth, _acc),
    do: fail(line, "<#{name}> of line #{start} is not closed")

  defp content(rest, line, name, start, depth, acc) do
    {text, rest} =
      case :binary.match(rest, "<") do
        {at, 1} -> split(rest, at)
        :nomatch -> {rest, ""}
      end

    content(rest, line + newlines(text), name, start, depth, [{:text, unescape(text, line), line} | acc])
  end

  defp attributes(rest, line, acc) do
    case space(rest, line) do
      {">" <> rest, line} ->
        {Enum.reverse(acc), false, rest, line}

      {"/>" <> rest, line} ->
        {Enum.reverse(acc), true, rest, line}

      {"", line} ->
        fail(line, "the tag is not closed")

      {^rest, line} when acc != [] ->
        fail(line, "expected a space or > after an attribute")

      {rest, line} ->
        {name, rest} = name(rest, line)
        if List.keymember?(acc, name, 0), do: fail(line, "attribute #{name} given twice")
        {value, rest, line} = value(rest, name, line)
        attributes(rest, line, [{name, value} | acc])
    end
  end

  defp value(rest, name, line) do
    with {"=" <> rest, line} <- space(rest, line),
         {<<quote, rest::binary>>, line} when quote in [?", ?'] <- space(rest, line) do
      {value, rest, next_line} = take(rest, <<quote>>, line, "value of #{name}")
      if String.contains?(value, "<"), do: fail(line, "< in the value of #{name}")
      {unescape(value, line), rest, next_line}
    else
      {_rest, line} -> fail(line, ~s(attribute #{name} has no value: expected #{name}="..."))
    end
  end

  defp name(<<c, _::binary>> = rest, line) when c in ?a..?z or c in ?A..?Z or c == ?_ do
    case Regex.run(~r/\A[A-Za-z_][A-Za-z0-9_.:-]{0,63}/, rest) do
      [name] -> {name, binary_part(rest, byte_size(name), byte_size(rest) - byte_size(name))}
      nil -> fail(line, "expected a name")
    end
  end

  defp name(_rest, line), do: fail(line, "expected a name")

  defp space(<<c, rest::binary>>, line) when c in @space, do: space(rest, next(c, line))
  defp space(rest, line), do: {rest, line}

  defp next(?\n, line), do: line + 1
  defp next(_other, line), do: line

  defp skip(rest, stop, line, what) do
    {_text, rest, line} = take(rest, stop, line, what)
    {rest, line}
  end

  defp take(rest, stop, line, what) do
    case :binary.match(rest, stop) do
      {at, size} ->
        {text, _} = split(rest, at)
        {text, binary_part(rest, at + size, byte_size(rest) - at - size), line + newlines(text)}

      :nomatch ->
        fail(line, "the #{what} does not end")
    end
  end

  defp split(bytes, at), do: {binary_part(bytes, 0, at), binary_part(bytes, at, byte_size(bytes) - at)}

  defp newlines(text), do: text |> :binary.matches("\n") |> length()

  defp unescape(text, line) do
    case :binary.split(text, "&") do
      [text] ->
        text

      [before, rest] ->
        line = line + newlines(before)

        case Regex.run(~r/\A([A-Za-z]{1,8}|#[0-9]{1,7}|#x[0-9A-Fa-f]{1,6});(.*)\z/s, rest) do
          [_, entity, rest] -> before <> entity(entity, line) <> unescape(rest, line)
          nil -> fail(line, "& that begins no entity (write &amp;)")
        end
    end
  end

  defp entity("amp", _line), do: "&"
  defp entity("lt", _line), do: "<"
  defp entity("gt", _line), do: ">"
  defp entity("quot", _line), do: "\""
  defp entity("apos", _line), do: "'"
  defp entity("#x" <> digits, line), do: character(String.to_integer(digits, 16), line)
  defp entity("#" <> digits, line), do: character(String.to_integer(digits), line)
  defp entity(name, line), do: fail(line, "unknown entity &#{name};")

  defp character(code, _line) when code in [?\t, ?\n, ?\r] or code in 0x20..0xD7FF or code in 0xE000..0xFFFD,
    do: <<code::utf8>>

  defp character(code, _line) when code in 0x10000..0x10FFFF, do: <<code::utf8>>
  defp character(code, line), do: fail(line, "character #{code} does not exist in XML")

  defp invalid_line(bytes) do
    bytes
    |> :binary.split("\n", [:global])
    |> Enum.find_index(&(not String.valid?(&1)))
    |> Kernel.||(0)
    |> Kernel.+(1)
  end

  @spec fail(pos_integer(), String.t()) :: no_return()
  defp fail(line, reason), do: throw({:xml, line, reason})
end
