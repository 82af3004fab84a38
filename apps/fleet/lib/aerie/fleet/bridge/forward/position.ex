defmodule Aerie.Fleet.Bridge.Forward.Position do
  @moduledoc """
  How far the hub has the messages of the local stream. Pure, but for the file, which is replaced as a whole. If the file is lost,
  everything is sent again; the hub drops what it knows by its id within its duplicate window.
  """

  alias Aerie.Fleet.Bridge.Events.Gaps
  alias Aerie.Base.Files.Private

  @max_bytes 1_048_576

  defstruct next: 1, pending: MapSet.new(), born: nil

  @typedoc """
  `next`: the message to read next; `pending`: those that were read and that the hub has not confirmed; `born`: when the stream was
  made, as text, because another one starts its numbers again.
  """
  @type t :: %__MODULE__{next: pos_integer(), pending: MapSet.t(pos_integer()), born: String.t() | nil}

  @doc "A message was read. Those before it that were not are gone from the stream."
  @spec read(t(), pos_integer()) :: t()
  def read(position, seq), do: %{position | next: seq + 1, pending: MapSet.put(position.pending, seq)}

  @doc "The hub has a message."
  @spec confirm(t(), pos_integer()) :: t()
  def confirm(position, seq), do: %{position | pending: MapSet.delete(position.pending, seq)}

  @doc "The hub has all messages up to this one."
  @spec reached(t()) :: non_neg_integer()
  def reached(position), do: position.pending |> Enum.min(fn -> position.next end) |> before()

  defp before(seq) when is_integer(seq) and seq > 0, do: seq - 1

  @doc "Reads again what the hub does not have."
  @spec reset(t()) :: t()
  def reset(position), do: %{position | next: reached(position) + 1, pending: MapSet.new()}

  @doc "The stream was made at `born`; the position in another one is worth nothing."
  @spec of(t(), String.t()) :: t()
  def of(%{born: born} = position, born), do: position
  def of(_position, born), do: %__MODULE__{born: born}

  @doc "Position and the last event of each vehicle that the hub has, from the file."
  @spec load(Path.t()) :: {t(), Gaps.last()}
  def load(file) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(file),
         {:ok, text} <- File.read(file),
         {:ok, %{"next" => next, "born" => born, "last" => %{} = last}} when is_integer(next) and next > 0 <-
           JSON.decode(text) do
      {%__MODULE__{next: next, born: born},
       for(
         {vehicle, [epoch, seq]} when is_integer(epoch) and is_integer(seq) <- last,
         into: %{},
         do: {vehicle, {epoch, seq}}
       )}
    else
      _none_or_damaged -> {%__MODULE__{}, %{}}
    end
  end

  @doc "Replaces the file."
  @spec save(Path.t(), t(), Gaps.last()) :: :ok | {:error, File.posix()}
  def save(file, position, last) do
    last = Map.new(last, fn {vehicle, {epoch, seq}} -> {vehicle, [epoch, seq]} end)
    text = JSON.encode!(%{"next" => reached(position) + 1, "born" => position.born, "last" => last})
    Private.write(file, text)
  end
end
