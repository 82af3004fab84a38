defmodule MavCodec.Frame.Encoder do
  @moduledoc """
  Encodes messages for one link with sequence numbers: one count per source {system, component}, from 0, wrapping after
  255 (R7). A value: each encoded frame returns the next encoder.

      encoder = MavCodec.Frame.Encoder.new(system: 237, component: 191)
      {bytes, encoder} = MavCodec.Frame.Encoder.encode(encoder, %MavCodec.Messages.Heartbeat{type: 18})

  The encoder keeps a count for every source it has seen, so use it only for your own sources.
  """

  import Bitwise

  alias MavCodec.Message

  @enforce_keys [:options]
  defstruct options: [], sequences: %{}

  @type t :: %__MODULE__{
          options: [MavCodec.encode_option()],
          sequences: %{optional({non_neg_integer(), 0..255}) => 0..255}
        }

  @doc "An encoder; `options` are the defaults for each frame, those of `MavCodec.encode/2` without `:seq`."
  @spec new([MavCodec.encode_option()]) :: t()
  def new(options \\ []), do: %__MODULE__{options: Keyword.delete(options, :seq)}

  @doc "The frame of a message with the next sequence number. Raises as `MavCodec.encode/2` does."
  @spec encode(t(), Message.t(), [MavCodec.encode_option()]) :: {binary(), t()}
  def encode(%__MODULE__{} = encoder, message, options \\ []) do
    options = Keyword.merge(encoder.options, options)
    source = {Keyword.fetch!(options, :system), Keyword.get(options, :component, 1)}
    seq = Map.get(encoder.sequences, source, 0)
    sequences = Map.put(encoder.sequences, source, seq + 1 &&& 255)
    {MavCodec.encode(message, Keyword.put(options, :seq, seq)), %{encoder | sequences: sequences}}
  end
end
