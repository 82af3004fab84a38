defmodule Aerie.Control.Transfers.InOrder do
  @moduledoc """
  The pieces of a reading, which come in any order and each byte once, in the order of their bytes. Pure. What comes early waits: as much as the
  machine that reads goes ahead of a gap.
  """

  @enforce_keys [:next]
  defstruct [:next, early: %{}]

  @type t :: %__MODULE__{next: non_neg_integer(), early: %{non_neg_integer() => binary()}}

  @doc "Nothing has come; the first byte is that at `offset`."
  @spec new(offset :: non_neg_integer()) :: t()
  def new(offset), do: %__MODULE__{next: offset}

  @doc "A piece, and what goes on without a gap now."
  @spec put(t(), non_neg_integer(), binary()) :: {[binary()], t()}
  def put(%{next: next} = order, next, bytes) do
    {early, rest} = Map.pop(order.early, next + byte_size(bytes))
    order = %{order | next: next + byte_size(bytes), early: rest}

    if early do
      {more, order} = put(order, order.next, early)
      {[bytes | more], order}
    else
      {[bytes], order}
    end
  end

  def put(order, offset, bytes), do: {[], put_in(order.early[offset], bytes)}
end
