defmodule Aerie.Vehicle.Services.Reports.Sequence do
  @first_us 300_000

  @moduledoc """
  Which EVENT messages of one component have come, and which are missing (X3). A pure value.

  Sequence numbers have 16 bits and wrap. EVENT and CURRENT_EVENT_SEQUENCE both show the latest number. Missing ones are
  requested with REQUEST_EVENT after #{div(@first_us, 1000)} ms (another link may bring them) and twice more. After that they are given up,
  as they are when RESPONSE_EVENT_ERROR says that the component does not keep them any more. Late events are accepted;
  duplicates, by a second link or another program's request, count once.

  A restarted component begins again: CURRENT_EVENT_SEQUENCE says so, or its clock goes back.
  """

  import Bitwise

  alias MavCodec.Message.BootClock

  @again_us 1_000_000
  @tries 3
  @max_missing 64
  @clock_ms 10_000

  defstruct [:latest, :boot_ms, missing: %{}, lost: 0]

  @typedoc "`lost`: how many were given up; `missing`: when each is to be requested next, and how often it was."
  @type t :: %__MODULE__{
          latest: 0..65_535 | nil,
          boot_ms: non_neg_integer() | nil,
          missing: %{(0..65_535) => {due :: integer(), tries :: non_neg_integer()}},
          lost: non_neg_integer()
        }

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "An EVENT with this number came `at` (us). `boot_ms` is its own time."
  @spec event(t(), 0..65_535, non_neg_integer(), integer()) :: {:new | :old, t()}
  def event(%{boot_ms: last} = sequence, number, boot_ms, at)
      when last != nil and boot_ms + @clock_ms < last do
    if BootClock.wrapped?(last, boot_ms),
      do: event(%{sequence | boot_ms: boot_ms}, number, boot_ms, at),
      else: event(%{new() | lost: sequence.lost}, number, boot_ms, at)
  end

  def event(%{latest: nil} = sequence, number, boot_ms, _at),
    do: {:new, %{sequence | latest: number, boot_ms: boot_ms}}

  def event(sequence, number, boot_ms, at) do
    sequence = %{sequence | boot_ms: max(sequence.boot_ms || 0, boot_ms)}

    cond do
      is_map_key(sequence.missing, number) ->
        {:new, %{sequence | missing: Map.delete(sequence.missing, number)}}

      ahead(sequence, number) > 0 ->
        sequence = expect(sequence, ahead(sequence, number) - 1, at)
        {:new, %{sequence | latest: number}}

      true ->
        {:old, sequence}
    end
  end

  @doc "Whether a number is so close to the latest one that it belongs to the same sequence."
  @spec near?(t(), 0..65_535) :: boolean()
  def near?(%{latest: nil}, _number), do: true
  def near?(%{latest: latest}, number), do: (number - latest + @max_missing &&& 0xFFFF) <= 2 * @max_missing

  @doc "CURRENT_EVENT_SEQUENCE came `at`: the last number that was sent. `reset?`: earlier numbers are void."
  @spec current(t(), 0..65_535, boolean(), integer()) :: t()
  def current(%{latest: same} = sequence, same, _reset?, _at), do: sequence

  def current(%{latest: latest} = sequence, number, reset?, _at) when reset? or latest == nil,
    do: %{new() | latest: number, lost: sequence.lost}

  def current(sequence, number, false, at) do
    case ahead(sequence, number) do
      0 -> sequence
      n -> %{expect(sequence, n, at) | latest: number}
    end
  end

  @doc "RESPONSE_EVENT_ERROR: the component does not keep events before `oldest` any more."
  @spec gone(t(), 0..65_535) :: t()
  def gone(%{latest: nil} = sequence, _oldest), do: sequence

  def gone(sequence, oldest) do
    {gone, missing} = Map.split_with(sequence.missing, fn {number, _} -> before?(number, oldest) end)
    %{sequence | missing: missing, lost: sequence.lost + map_size(gone)}
  end

  @doc "The ranges to request at `now`, as first and last numbers."
  @spec expire(t(), integer()) :: {t(), [{0..65_535, 0..65_535}]}
  def expire(%{missing: missing} = sequence, _now) when missing == %{}, do: {sequence, []}

  def expire(sequence, now) do
    {due, later} = Map.split_with(sequence.missing, fn {_number, {due, _tries}} -> due <= now end)
    {given_up, due} = Map.split_with(due, fn {_number, {_due, tries}} -> tries >= @tries end)
    asked = Map.new(due, fn {number, {_due, tries}} -> {number, {now + @again_us, tries + 1}} end)

    {%{sequence | missing: Map.merge(later, asked), lost: sequence.lost + map_size(given_up)},
     asked |> Map.keys() |> ranges(sequence.latest)}
  end

  @doc "Time goes on from `now`, which is not comparable with the time before."
  @spec rebased(t(), integer()) :: t()
  def rebased(sequence, now) do
    %{sequence | missing: Map.new(sequence.missing, fn {number, {_due, tries}} -> {number, {now, tries}} end)}
  end

  @doc "Whether missing events may still come."
  @spec waiting?(t()) :: boolean()
  def waiting?(%{missing: missing}), do: missing != %{}

  # How far a number is ahead of the latest one; 0 if it is not.
  defp ahead(%{latest: latest}, number) do
    distance = number - latest &&& 0xFFFF
    if distance < 0x8000, do: distance, else: 0
  end

  defp before?(number, other), do: (other - number &&& 0xFFFF) in 1..0x7FFF

  # Notes the n numbers after the latest one as missing. If there are too many, the last ones matter.
  defp expect(sequence, n, at) do
    first = max(n - @max_missing, 0) + 1
    numbers = for i <- first..n//1, into: %{}, do: {sequence.latest + i &&& 0xFFFF, {at + @first_us, 0}}
    sequence = %{sequence | missing: Map.merge(sequence.missing, numbers), lost: sequence.lost + first - 1}
    bound(sequence, sequence.latest + n &&& 0xFFFF)
  end

  defp bound(%{missing: missing} = sequence, _latest) when map_size(missing) <= @max_missing, do: sequence

  defp bound(%{missing: missing} = sequence, latest) do
    oldest = missing |> Map.keys() |> Enum.max_by(&(latest - &1 &&& 0xFFFF))
    bound(%{sequence | missing: Map.delete(missing, oldest), lost: sequence.lost + 1}, latest)
  end

  defp ranges(numbers, latest) do
    numbers
    |> Enum.sort_by(&(latest - &1 &&& 0xFFFF), :desc)
    |> Enum.chunk_while(
      nil,
      fn
        number, nil -> {:cont, {number, number}}
        number, {first, last} when (number - last &&& 0xFFFF) == 1 -> {:cont, {first, number}}
        number, range -> {:cont, range, {number, number}}
      end,
      fn
        nil -> {:cont, nil}
        range -> {:cont, range, nil}
      end
    )
  end
end
