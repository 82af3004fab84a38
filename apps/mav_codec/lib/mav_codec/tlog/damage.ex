defmodule MavCodec.Tlog.Damage do
  @moduledoc """
  Bytes of a tlog that are not a record and were skipped.

    * `kind` - `:damaged`: records follow; `:cut_off`: the file ends here, in the middle of a record (the recorder was
      killed, the disk was full); `:untimed`: records with impossible times (`MavCodec.Tlog.Decoder`); `:raw`: the file is not a tlog
    * `offset` - of the first byte in the file; `bytes` - how many
  """

  @enforce_keys [:kind, :offset, :bytes]
  defstruct @enforce_keys

  @type kind :: :damaged | :cut_off | :untimed | :raw
  @type t :: %__MODULE__{kind: kind(), offset: non_neg_integer(), bytes: pos_integer()}

  @doc "A description in one line."
  @spec format(t()) :: String.t()
  def format(%__MODULE__{kind: :damaged} = damage),
    do: "#{damage.bytes} bytes at offset #{damage.offset} are not a record and were skipped"

  def format(%__MODULE__{kind: :cut_off} = damage),
    do:
      "the file ends in the middle of a record: the last #{damage.bytes} bytes, from offset #{damage.offset}, were skipped"

  def format(%__MODULE__{kind: :untimed} = damage),
    do:
      "#{damage.bytes} bytes at offset #{damage.offset} have times after 2100 and were skipped: a tlog has microseconds since 1970, not nanoseconds"

  def format(%__MODULE__{kind: :raw}), do: "this is a raw MAVLink log, not a tlog: its frames have no times"
end
