defmodule MavCodec.Parser.Known do
  @moduledoc """
  CRC_EXTRA by message id for the dialects of one parser.

  Ids below 512, which is nearly all traffic, are looked up in a tuple made once; the others are asked of the dialects.
  An id has a list of values when dialects disagree about the message (the frame keeps the one that matched), and `nil`
  when no dialect knows it.
  """

  @direct 512

  @enforce_keys [:direct, :dialects]
  defstruct @enforce_keys

  @type extra :: 0..255 | [0..255] | nil
  @type t :: %__MODULE__{direct: tuple(), dialects: [module()]}

  @doc "The table of `dialects`: modules with `crc_extra/1` (behaviour `MavCodec.Dialect`)."
  @spec new([module()]) :: t()
  def new(dialects) do
    direct = for id <- 0..(@direct - 1), do: ask(dialects, id)
    %__MODULE__{direct: List.to_tuple(direct), dialects: dialects}
  end

  @doc "How many ids, from 0, are in the tuple `direct`."
  @spec direct_size() :: pos_integer()
  def direct_size, do: @direct

  @doc "The value or values of message `id`, or `nil`."
  @spec extra(t(), 0..0xFFFFFF) :: extra()
  def extra(%__MODULE__{direct: direct}, id) when id < @direct, do: elem(direct, id)
  def extra(%__MODULE__{dialects: dialects}, id), do: ask(dialects, id)

  defp ask(dialects, id) do
    case dialects |> Enum.flat_map(&List.wrap(&1.crc_extra(id))) |> Enum.uniq() do
      [] -> nil
      [extra] -> extra
      extras -> extras
    end
  end
end
