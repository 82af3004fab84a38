defmodule Aerie.Bridge.Server.Revival do
  @moduledoc """
  When a server that runs but stores nothing is started again. Pure; times in milliseconds.

  nats-server keeps the first error of a write for ever: with room on the disk again it still answers no publisher, and only a
  new start cures it. A new start is no use while the disk is full, and none but the first helps where something else is wrong,
  so the pauses between them grow from ten seconds to ten minutes.
  """

  @first_pause_ms 10_000
  @max_pause_ms 600_000
  # Less than this is no room: the next message could be the one that fails.
  @room 1_048_576

  defstruct fault: nil, tries: 0, not_before: nil

  @typedoc "`fault`: why it stores nothing, in words, or nil; `tries`: new starts lately."
  @type t :: %__MODULE__{fault: String.t() | nil, tries: non_neg_integer(), not_before: integer() | nil}

  @doc "A server without a fault."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "The server stores nothing. The first reason is kept: the others come of it."
  @spec fault(t(), String.t()) :: t()
  def fault(%{fault: nil} = revival, text), do: %{revival | fault: text}
  def fault(revival, _text), do: revival

  @doc "It was started, by whomever."
  @spec started(t()) :: t()
  def started(revival), do: %{revival | fault: nil}

  @doc "Whether it is to be started again now, with so much free on its disk."
  @spec look(t(), integer(), {:ok, non_neg_integer()} | :unknown) :: {:restart | :wait, t()}
  def look(%{fault: nil} = revival, _now, _free), do: {:wait, revival}
  def look(revival, _now, {:ok, free}) when free < @room, do: {:wait, revival}

  def look(%{not_before: nil} = revival, now, _free), do: restart(revival, now)
  def look(%{not_before: at} = revival, now, _free) when now < at, do: {:wait, revival}

  # It worked for long: this is another misfortune.
  def look(%{not_before: at} = revival, now, _free) when now - at > @max_pause_ms,
    do: restart(%{revival | tries: 0}, now)

  def look(revival, now, _free), do: restart(revival, now)

  defp restart(revival, now) do
    pause = min(@max_pause_ms, @first_pause_ms * Integer.pow(2, min(revival.tries, 10)))
    {:restart, %{revival | tries: revival.tries + 1, not_before: now + pause}}
  end
end
