defmodule MavCodec.Tlog.Damage do
  @moduledoc """
  Bytes of a tlog that are not a record and were skipped.

    * `kind` - `:damaged`: records follow; `:cut_off`: the file ends here, in the middle of a record (the recorder was
      killed, the disk was full)
    * `offset` - of the first byte in the file; `bytes` - how many
  """

  @enforce_keys [:kind, :offset, :bytes]
  defstruct @enforce_keys

  @type t :: %__MODULE__{kind: :damaged | :cut_off, offset: non_neg_integer(), bytes: pos_integer()}

  @doc "A description in one line."
  @spec format(t()) :: String.t()
  def format(%__MODULE__{kind: :damaged} = damage),
    do: "#{damage.bytes} bytes at offset #{damage.offset} are not a record and were skipped"

  def format(%__MODULE__{kind: :cut_off} = damage),
    do:
      "the file ends in the middle of a record: the last #{damage.bytes} bytes, from offset #{damage.offset}, were skipped"
end
