defmodule Aerie.Vehicle.Session.Core.Texts do
  @moduledoc """
  The STATUSTEXTs of a vehicle that are not complete yet, those that came before its autopilot was known, and those that may come again.
  A pure value.
  """

  alias Protocols.StatusText
  alias MavCodec.Frame

  # How long after the first link's copy of a text a second link's copy may come.
  @copy_us 5_000_000
  # Within this time, the same text by the same link with the same sequence number is a duplicate.
  @duplicate_us 1_000_000
  # Texts from before the first heartbeat (`MavRouter.Forward.Cache.EarlyTexts` holds as many).
  @max_early 16

  defstruct open: StatusText.new(), early: [], recent: %{}

  @type t :: %__MODULE__{
          open: StatusText.t(),
          early: [{link :: term(), Frame.t()}],
          recent: %{term() => {link :: term(), integer()}}
        }

  @doc "Keeps a text until it is known which component is the autopilot."
  @spec hold(t(), link :: term(), Frame.t()) :: t()
  def hold(texts, link, frame), do: %{texts | early: Enum.take(texts.early ++ [{link, frame}], @max_early)}

  @doc "Those that were kept, with their links."
  @spec release(t()) :: {[{link :: term(), Frame.t()}], t()}
  def release(texts), do: {texts.early, %{texts | early: []}}

  @doc "A STATUSTEXT: the texts that are complete now (X2)."
  @spec push(t(), link :: term(), Frame.t(), struct()) :: {t(), [StatusText.text()]}
  def push(texts, link, frame, message) do
    case first_copy(texts, link, frame) do
      {true, texts} ->
        {open, done} = StatusText.push(texts.open, frame.component, message, frame.at)
        {%{texts | open: open}, done}

      {false, texts} ->
        {texts, []}
    end
  end

  # A second link brings the same frame again, or the network the same datagram: same number, same content. (The number
  # alone would not do, R7: it repeats after 256 frames.)
  defp first_copy(texts, link, frame) do
    key = {frame.component, frame.seq, frame.payload}

    case texts.recent do
      %{^key => {other, at}} when other != link and frame.at - at < @copy_us ->
        {false, texts}

      %{^key => {_same, at}} when frame.at - at < @duplicate_us ->
        {false, texts}

      recent ->
        recent =
          if map_size(recent) < 64,
            do: recent,
            else: Map.filter(recent, fn {_, {_, at}} -> frame.at - at < @copy_us end)

        recent = if map_size(recent) < 256, do: recent, else: %{}
        {true, %{texts | recent: Map.put(recent, key, {link, frame.at})}}
    end
  end

  @doc "Gives up on texts whose missing chunks are overdue at `now`."
  @spec expire(t(), integer()) :: {t(), [StatusText.text()]}
  def expire(texts, now) do
    {open, done} = StatusText.expire(texts.open, now)
    {%{texts | open: open}, done}
  end

  @doc "Gives up on all missing chunks at once, and on recognising copies: time begins again."
  @spec finish(t(), integer()) :: {t(), [StatusText.text()]}
  def finish(texts, now) do
    {open, done} = StatusText.finish(texts.open, now)
    {%{texts | open: open, recent: %{}}, done}
  end

  @doc "When `expire/2` has to be called next; nil for never."
  @spec deadline(t()) :: integer() | nil
  def deadline(texts), do: StatusText.deadline(texts.open)
end
