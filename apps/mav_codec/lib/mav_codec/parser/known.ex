defmodule MavCodec.Parser.Known do
  @moduledoc """
  The message ids that a parser's dialects know: CRC_EXTRA, and the payload's length in MAVLink 1.

  Ids below 65,536, which includes all official ones, are in pages of 256 that are made once for a choice of dialects. For
  other ids the dialects are asked. An id has a list of values if dialects disagree about the message (the frame keeps the
  one that matched), and `nil` if no dialect knows it.
  """

  import Bitwise

  @direct 0x10000

  @enforce_keys [:pages, :lengths, :others]
  defstruct @enforce_keys

  @type extra :: 0..255 | [0..255] | nil

  @typedoc """
    * `pages` - by the id's upper byte, then its lower one
    * `lengths` - of the payload without extensions, by id below 256; `nil` if unknown or if dialects disagree
    * `others` - the dialects that may have ids above the pages
  """
  @type t :: %__MODULE__{pages: tuple(), lengths: tuple(), others: [module()]}

  @doc "The table of `dialects`: modules with the behaviour `MavCodec.Dialect`."
  @spec new([module()]) :: t()
  def new(dialects) do
    # A link has a parser for each peer, so the table is made once. The checksum is that of the compiled module.
    key = {__MODULE__, for(dialect <- dialects, do: {dialect, dialect.module_info(:md5)})}

    with nil <- :persistent_term.get(key, nil) do
      known = make(dialects)
      :persistent_term.put(key, known)
      known
    end
  end

  @doc "How many ids, from 0, are in `pages`."
  @spec direct_size() :: pos_integer()
  def direct_size, do: @direct

  @doc "The value or values of message `id`, or `nil`."
  @spec extra(t(), 0..0xFFFFFF) :: extra()
  def extra(%__MODULE__{pages: pages}, id) when id < @direct, do: elem(elem(pages, id >>> 8), id &&& 0xFF)
  def extra(%__MODULE__{others: []}, _id), do: nil
  def extra(%__MODULE__{others: others}, id), do: ask(others, id)

  defp make(dialects) do
    empty = Tuple.duplicate(nil, 256)

    pages =
      for page <- 0..(div(@direct, 256) - 1) do
        extras = List.to_tuple(for low <- 0..255, do: ask(dialects, page <<< 8 ||| low))
        if extras == empty, do: empty, else: extras
      end

    %__MODULE__{
      pages: List.to_tuple(pages),
      lengths: List.to_tuple(for id <- 0..255, do: base_length(dialects, id)),
      others: Enum.filter(dialects, &above_the_pages?/1)
    }
  end

  defp ask(dialects, id) do
    case dialects |> Enum.flat_map(&List.wrap(&1.crc_extra(id))) |> Enum.uniq() do
      [] -> nil
      [extra] -> extra
      extras -> extras
    end
  end

  defp base_length(dialects, id) do
    lengths =
      for dialect <- dialects, dialect.crc_extra(id) != nil, uniq: true, do: base_length_in(dialect, id)

    if match?([_], lengths), do: hd(lengths)
  end

  defp base_length_in(dialect, id) do
    if function_exported?(dialect, :length, 1), do: elem(dialect.length(id), 0)
  end

  defp above_the_pages?(dialect),
    do: not function_exported?(dialect, :ids, 0) or Enum.any?(dialect.ids(), &(&1 >= @direct))
end
