defprotocol Phoenix.HTML.Safe do
  @moduledoc "How a value is written into HTML: escaped iodata."

  @doc "The value as escaped iodata."
  @spec to_iodata(t()) :: iodata()
  def to_iodata(value)
end

defimpl Phoenix.HTML.Safe, for: BitString do
  def to_iodata(text) when is_binary(text), do: Phoenix.HTML.Escape.text(text)
end

defimpl Phoenix.HTML.Safe, for: Atom do
  def to_iodata(nil), do: ""
  def to_iodata(atom), do: atom |> Atom.to_string() |> Phoenix.HTML.Escape.text()
end

defimpl Phoenix.HTML.Safe, for: Integer do
  defdelegate to_iodata(number), to: Integer, as: :to_string
end

defimpl Phoenix.HTML.Safe, for: Float do
  defdelegate to_iodata(number), to: Float, as: :to_string
end

defimpl Phoenix.HTML.Safe, for: List do
  def to_iodata(list), do: walk(list)

  defp walk([]), do: []
  defp walk([head | tail]), do: [item(head) | walk(tail)]
  # iodata may end with text.
  defp walk(tail), do: item(tail)

  # A character list is text, unless it has numbers that are not characters.
  defp item(number) when number in 0..0x10FFFF, do: Phoenix.HTML.Escape.text(<<number::utf8>>)
  defp item(text) when is_binary(text), do: Phoenix.HTML.Escape.text(text)
  defp item(list) when is_list(list), do: walk(list)
  defp item({:safe, data}), do: data

  defp item(other),
    do:
      raise(
        ArgumentError,
        "lists in templates may hold text, characters and safe values, got: #{inspect(other)}"
      )
end

defimpl Phoenix.HTML.Safe, for: Tuple do
  def to_iodata({:safe, data}), do: data
  def to_iodata(value), do: raise(Protocol.UndefinedError, protocol: @protocol, value: value)
end

defimpl Phoenix.HTML.Safe, for: [Date, Time, NaiveDateTime, Version] do
  def to_iodata(value), do: to_string(value)
end

defimpl Phoenix.HTML.Safe, for: [DateTime, URI] do
  # The name of a time zone and a URI may contain markup characters.
  def to_iodata(value), do: value |> to_string() |> Phoenix.HTML.Escape.text()
end
