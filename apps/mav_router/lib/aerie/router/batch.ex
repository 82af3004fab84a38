defmodule Aerie.Router.Batch do
  @moduledoc """
  Frames that go out together, and the forms in which endpoints take them, each made once, when the first needs it.
  """

  alias Aerie.Router.Classify
  alias MavCodec.Frame

  # What fits into one Ethernet frame with IPv6 and a tunnel or two around it, and into mavlink-router's buffer (1,120).
  @datagram 1_024

  @enforce_keys [:frames, :n]
  defstruct [:frames, :n, :bytes, :datagrams, :runs]

  @type t :: %__MODULE__{
          frames: [Frame.t()],
          n: pos_integer,
          bytes: non_neg_integer | nil,
          datagrams: [binary] | nil,
          runs: [{Classify.class(), [binary], pos_integer}] | nil
        }

  @doc "Frames, at least one, in order."
  @spec new([Frame.t()]) :: t
  def new([%Frame{bytes: bytes}] = frames),
    do: %__MODULE__{frames: frames, n: 1, bytes: byte_size(bytes), datagrams: [bytes]}

  def new(frames), do: %__MODULE__{frames: frames, n: length(frames)}

  @doc "Fills in the sum of bytes."
  @spec sized(t) :: t
  def sized(%__MODULE__{bytes: nil} = batch),
    do: %{batch | bytes: Enum.reduce(batch.frames, 0, &(byte_size(&1.bytes) + &2))}

  def sized(batch), do: batch

  @doc "The most bytes of several frames in one datagram."
  @spec datagram() :: pos_integer
  def datagram, do: @datagram

  @doc "Fills in datagrams: as many whole frames in each as fit."
  @spec packed(t) :: t
  def packed(%__MODULE__{datagrams: nil} = batch), do: %{batch | datagrams: pack(batch.frames, [], 0, [])}
  def packed(batch), do: batch

  defp pack([], [], _size, done), do: Enum.reverse(done)
  defp pack([], open, _size, done), do: Enum.reverse([seal(open) | done])

  defp pack([%Frame{bytes: bytes} | rest] = frames, open, size, done) do
    case size + byte_size(bytes) do
      more when more <= @datagram or open == [] -> pack(rest, [bytes | open], more, done)
      _full -> pack(frames, [], 0, [seal(open) | done])
    end
  end

  defp seal([one]), do: one
  defp seal(many), do: many |> :lists.reverse() |> :erlang.iolist_to_binary()

  @doc "Fills in the runs of one class."
  @spec classed(t) :: t
  def classed(%__MODULE__{runs: nil} = batch), do: %{batch | runs: Classify.runs(batch.frames)}
  def classed(batch), do: batch
end
