defmodule Protocols.StatusText do
  @max_open 16
  @max_chunks 16

  @moduledoc """
  Assembles STATUSTEXT chunks (X2). A pure value.

  A text with id 0 is complete. With another id it comes in chunks of 50 bytes, which may be interleaved with other texts and
  out of order; a chunk shorter than 50 bytes is the last one, and may be as short as a tab. A second after the last chunk
  came, missing ones are given up: the text has `[…]` in their place.

  PX4 ends a text that it also sends as an EVENT with a tab, which is removed and shown as `doubled`.

  At most #{@max_open} texts are incomplete at once, and a text has at most #{@max_chunks} chunks; beyond that the oldest text
  of the source that has most of them is returned incomplete.
  """

  defstruct open: %{}

  @chunk_bytes 50
  @timeout_us 1_000_000
  @gap "[…]"

  @type t :: %__MODULE__{open: %{term() => map()}}
  @type text :: %{severity: 0..255, text: String.t(), at: integer(), source: term(), doubled: boolean()}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Adds a STATUSTEXT of a source, and returns the texts that are complete now, in order."
  @spec push(t(), source :: term(), struct(), integer()) :: {t(), [text()]}
  def push(texts, source, %{id: 0} = message, at),
    do: {texts, [done(source, message.severity, message.text, at)]}

  def push(texts, source, %{id: id, chunk_seq: chunk} = message, at) do
    key = {source, id}
    {texts, before} = reused(texts, key, chunk, message.text, at)

    entry = Map.get(texts.open, key, %{severity: message.severity, chunks: %{}, last: nil, at: at})
    last = if byte_size(message.text) < @chunk_bytes, do: chunk, else: entry.last
    entry = %{entry | chunks: Map.put_new(entry.chunks, chunk, message.text), last: last, at: at}
    texts = %{texts | open: Map.put(texts.open, key, entry)}

    if complete?(entry) or map_size(entry.chunks) >= @max_chunks do
      {texts, whole} = close(texts, key, at)
      {texts, before ++ whole}
    else
      {texts, over} = bound(texts, at)
      {texts, before ++ over}
    end
  end

  @doc "Gives up on texts whose missing chunks are overdue at `now`."
  @spec expire(t(), integer()) :: {t(), [text()]}
  def expire(%{open: open} = texts, _now) when open == %{}, do: {texts, []}

  def expire(texts, now) do
    overdue = for {key, entry} <- texts.open, entry.at + @timeout_us <= now, do: {entry.at + @timeout_us, key}

    Enum.reduce(Enum.sort(overdue), {texts, []}, fn {deadline, key}, {texts, given} ->
      {texts, one} = close(texts, key, deadline)
      {texts, given ++ one}
    end)
  end

  @doc "Gives up on all missing chunks at once."
  @spec finish(t(), integer()) :: {t(), [text()]}
  def finish(texts, now) do
    texts.open
    |> Enum.sort_by(fn {key, entry} -> {entry.at, key} end)
    |> Enum.reduce({texts, []}, fn {key, _entry}, {texts, given} ->
      {texts, one} = close(texts, key, now)
      {texts, given ++ one}
    end)
  end

  @doc "When `expire/2` has to be called next; nil for never."
  @spec deadline(t()) :: integer() | nil
  def deadline(%{open: open}) when open == %{}, do: nil

  def deadline(%{open: open}),
    do: open |> Enum.map(fn {_key, entry} -> entry.at + @timeout_us end) |> Enum.min()

  # The same chunk with another text: the 16-bit id wrapped, or the sender was restarted.
  defp reused(texts, key, chunk, text, at) do
    case texts.open do
      %{^key => %{chunks: %{^chunk => other}}} when other != text -> close(texts, key, at)
      _new_or_repeated -> {texts, []}
    end
  end

  defp complete?(%{last: nil}), do: false
  defp complete?(%{last: last, chunks: chunks}), do: Enum.all?(0..last, &is_map_key(chunks, &1))

  defp bound(texts, at) do
    if map_size(texts.open) > @max_open do
      open = Enum.frequencies_by(texts.open, fn {{source, _id}, _entry} -> source end)

      {oldest, _entry} =
        Enum.min_by(texts.open, fn {{source, _} = key, one} -> {-open[source], one.at, key} end)

      close(texts, oldest, at)
    else
      {texts, []}
    end
  end

  defp close(texts, key, at) do
    {entry, open} = Map.pop!(texts.open, key)
    {source, _id} = key
    {%{texts | open: open}, [done(source, entry.severity, join(entry), at)]}
  end

  defp join(%{chunks: chunks, last: last}) do
    numbers = chunks |> Map.keys() |> Enum.sort()

    {parts, expected} =
      Enum.map_reduce(numbers, 0, fn n, expected ->
        {if(n > expected, do: [@gap, chunks[n]], else: chunks[n]), n + 1}
      end)

    # Without the last chunk it is not known how much is missing.
    IO.iodata_to_binary([parts, if(last == nil or last >= expected, do: @gap, else: "")])
  end

  defp done(source, severity, text, at) do
    %{
      severity: severity,
      text: text |> String.replace_invalid() |> String.trim_trailing("\t"),
      at: at,
      source: source,
      doubled: String.ends_with?(text, "\t")
    }
  end
end
