defmodule MavRouter.Endpoints.Output.Batch do
  @moduledoc """
  Frames that go out together, in the forms that endpoints take. Each form is made once, when it is first needed.
  """

  alias MavRouter.Endpoints.Queue.TrafficClass
  alias MavCodec.Frame

  # Fits into an Ethernet frame with IPv6 and a tunnel or two, and into mavlink-router's buffer (1,120).
  @datagram 1_024
  # As many datagrams as every Linux cuts out of one write.
  @segments 64

  @enforce_keys [:frames, :n]
  defstruct [:frames, :n, :datagrams, :sized, :runs]

  @type t :: %__MODULE__{
          frames: [Frame.t()],
          n: pos_integer,
          datagrams: [binary] | nil,
          sized: [{size :: pos_integer, [binary], pos_integer}] | nil,
          runs: [{TrafficClass.class(), [binary], pos_integer}] | nil
        }

  @doc "Frames, at least one, in order."
  @spec new([Frame.t()]) :: t
  def new([%Frame{bytes: bytes}] = frames),
    do: %__MODULE__{frames: frames, n: 1, datagrams: [bytes]}

  def new(frames), do: %__MODULE__{frames: frames, n: length(frames)}

  @doc "The largest datagram of several frames, in bytes."
  @spec datagram() :: pos_integer
  def datagram, do: @datagram

  @doc "Fills in datagrams: as many whole frames in each as fit."
  @spec packed(t) :: t
  def packed(%__MODULE__{datagrams: nil} = batch), do: %{batch | datagrams: pack(batch.frames, [], 0, [])}
  def packed(batch), do: batch

  defp pack([], [], _size, done), do: Enum.reverse(done)
  defp pack([], open, _size, done), do: Enum.reverse([datagram(open) | done])

  defp pack([%Frame{bytes: bytes} | rest] = frames, open, size, done) do
    case size + byte_size(bytes) do
      more when more <= @datagram or open == [] -> pack(rest, [bytes | open], more, done)
      _full -> pack(frames, [], 0, [datagram(open) | done])
    end
  end

  defp datagram([one]), do: one
  defp datagram(many), do: many |> :lists.reverse() |> :erlang.iolist_to_binary()

  @doc "Fills in the runs of frames of one size, of at most #{@segments} frames each."
  @spec sized(t) :: t
  def sized(%__MODULE__{sized: nil} = batch), do: %{batch | sized: sizes(batch.frames, [])}
  def sized(batch), do: batch

  defp sizes([], done), do: :lists.reverse(done)
  defp sizes([%Frame{bytes: bytes} | rest], done), do: sizes(rest, byte_size(bytes), [bytes], 1, done)

  defp sizes([%Frame{bytes: bytes} | rest], size, run, n, done)
       when byte_size(bytes) == size and n < @segments,
       do: sizes(rest, size, [bytes | run], n + 1, done)

  defp sizes(frames, size, run, n, done), do: sizes(frames, [{size, :lists.reverse(run), n} | done])

  @doc "Fills in the runs of one class."
  @spec classed(t) :: t
  def classed(%__MODULE__{runs: nil} = batch), do: %{batch | runs: TrafficClass.runs(batch.frames)}
  def classed(batch), do: batch
end
