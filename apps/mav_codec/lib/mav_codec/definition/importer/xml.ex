defmodule MavCodec.Definition.Importer.XML do
  @moduledoc """
  Reads a definition file's XML, with OTP's SAX parser, into elements with line numbers.

  Nothing of a file becomes an atom, and no other file is read. What no definition file needs is refused: a document type
  declaration (and with it custom entities), another encoding than UTF-8, files over 4 MB, nesting deeper than 16.
  """

  @max_bytes 4 * 1024 * 1024
  @max_depth 16
  # What may follow the root element.
  @nothing ~r/\A(?:\s|<!--.*?-->|<\?.*?\?>)*\z/s

  @typedoc "Name, attributes without a namespace in order, children in order, the line where the start tag ends."
  @type element ::
          {:element, name :: String.t(), [{String.t(), String.t()}], [element() | text()],
           line :: pos_integer()}
  @type text :: {:text, String.t(), line :: pos_integer()}

  @doc "Reads a document and returns its root element, or the line and the reason of an error."
  @spec parse(binary()) :: {:ok, element()} | {:error, pos_integer() | nil, String.t()}
  def parse(bytes) when byte_size(bytes) > @max_bytes, do: {:error, nil, "larger than #{@max_bytes} bytes"}

  def parse(bytes) do
    cond do
      not text?(bytes) -> {:error, bad_line(bytes), "not UTF-8"}
      encoding = encoding(bytes) -> {:error, 1, "encoding #{encoding}: not UTF-8"}
      String.trim(bytes) == "" -> {:error, 1, "no element"}
      true -> read(bytes)
    end
  end

  @doc "All text directly inside an element, trimmed."
  @spec text(element()) :: String.t()
  def text({:element, _name, _attributes, children, _line}),
    do: String.trim(for {:text, text, _line} <- children, into: "", do: text)

  # A zero byte would make the parser read UTF-16.
  defp text?(bytes), do: String.valid?(bytes) and not String.contains?(bytes, <<0>>)

  defp bad_line(bytes) do
    lines = :binary.split(bytes, "\n", [:global])
    Enum.find_index(lines, &(not text?(&1))) + 1
  end

  defp encoding(bytes) do
    with [_, name] <- Regex.run(~r/\A\x{FEFF}?<\?xml[^>]*?encoding\s*=\s*["']([^"']*)["']/u, bytes),
         false <- String.downcase(name) in ["utf-8", "us-ascii"],
         do: name,
         else: (_utf8 -> nil)
  end

  defp read(bytes) do
    options = [
      :disallow_entities,
      :skip_external_dtd,
      external_entities: :none,
      event_fun: &event/3,
      event_state: [[]]
    ]

    case :xmerl_sax_parser.stream(bytes, options) do
      {:ok, [[root]], rest} -> if rest =~ @nothing, do: {:ok, root}, else: after_root(bytes, rest)
      {:refused, {_path, _file, line}, reason, _tags, _state} -> {:error, line, reason}
      {:fatal_error, {_path, _file, line}, reason, tags, _state} -> {:error, line, reason(reason, tags)}
      # The parser's own crash.
      _crash -> {:error, nil, "not XML"}
    end
  end

  defp after_root(bytes, rest) do
    before = binary_part(bytes, 0, byte_size(bytes) - byte_size(String.trim_leading(rest)))
    {:error, length(String.split(before, "\n")), "text after the root element"}
  end

  defp reason(~c"EndTag:" ++ _other, [tag | _tags]), do: "expected </#{tag}>"
  # What the parser says when it needs more bytes.
  defp reason(~c"Continuation function undefined", [tag | _tags]), do: "<#{tag}> is not closed"
  defp reason(~c"Continuation function undefined", []), do: "the file ends in the middle"

  # It may quote bytes that cannot be shown.
  defp reason(reason, _tags),
    do: if(List.ascii_printable?(reason), do: "not XML: #{String.trim("#{reason}")}", else: "not XML")

  # The state: the children so far of each open element, innermost first, between them the elements' starts.
  defp event({:startElement, _uri, _local, name, attributes}, {_path, _file, line}, state) do
    if length(state) > 2 * @max_depth, do: throw({:refused, "elements nested deeper than #{@max_depth}"})
    attributes = for {_uri, [], key, value} <- attributes, do: {to_string(key), to_string(value)}
    [[], {:element, qualified(name), attributes, [], line} | state]
  end

  defp event({:endElement, _uri, _local, _name}, _at, [children, start, siblings | state]),
    do: [[put_elem(start, 3, Enum.reverse(children)) | siblings] | state]

  defp event({kind, text}, {_path, _file, line}, [children | state])
       when kind in [:characters, :ignorableWhitespace],
       do: [[{:text, to_string(text), line - Enum.count(text, &(&1 == ?\n))} | children] | state]

  defp event({:startDTD, _name, _public, _system}, _at, _state),
    do: throw({:refused, "a document type declaration is not accepted"})

  defp event(_other, _at, state), do: state

  defp qualified({[], name}), do: to_string(name)
  defp qualified({prefix, name}), do: "#{prefix}:#{name}"
end
