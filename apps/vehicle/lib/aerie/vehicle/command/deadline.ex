defmodule Aerie.Vehicle.Command.Deadline do
  @moduledoc """
  The times of a command, and the rules about them:

    * a time is ISO 8601 with an offset (`2026-11-22T09:00:00.5Z`), or unix seconds as a number
    * a command is issued now unless it says otherwise, at most 10 minutes ago and at most 5 seconds ahead of our clock
    * its deadline is 10 seconds after it was issued unless it says otherwise, and at most 5 minutes from now

  A deadline that has passed is not an error here: such a command is answered with `expired`.
  """

  alias Aerie.Vehicle.Command.Error

  @second 1_000_000
  @default 10 * @second
  @ahead 5 * @second
  @age 600 * @second
  @most 300 * @second

  @doc "When the command was issued, in unix microseconds."
  @spec issued_at(term(), now :: integer()) :: {:ok, integer()} | {:error, Error.t()}
  def issued_at(nil, now), do: {:ok, now}

  def issued_at(given, now) do
    with {:ok, at} <- read("issued_at", given) do
      if at >= now - @age and at <= now + @ahead,
        do: {:ok, at},
        else: {:error, Error.new("issued_at", "a time at most 10 minutes ago and 5 seconds ahead", given)}
    end
  end

  @doc "Until when it may be sent, in unix microseconds."
  @spec deadline(term(), issued_at :: integer(), now :: integer()) :: {:ok, integer()} | {:error, Error.t()}
  def deadline(nil, issued_at, _now), do: {:ok, issued_at + @default}

  def deadline(given, _issued_at, now) do
    with {:ok, at} <- read("deadline", given) do
      if at <= now + @most,
        do: {:ok, at},
        else: {:error, Error.new("deadline", "a time at most 5 minutes from now", given)}
    end
  end

  @doc "A time as text, to the microsecond."
  @spec text(integer()) :: String.t()
  def text(us), do: us |> DateTime.from_unix!(:microsecond) |> DateTime.to_iso8601()

  defp read(key, text) when is_binary(text) and byte_size(text) <= 64 do
    case DateTime.from_iso8601(text) do
      {:ok, time, _offset} -> {:ok, DateTime.to_unix(time, :microsecond)}
      {:error, _reason} -> wrong(key, text)
    end
  end

  # The range keeps milliseconds from being taken for seconds.
  defp read(_key, seconds) when is_number(seconds) and seconds > 0 and seconds < 1.0e11,
    do: {:ok, round(seconds * @second)}

  defp read(key, other), do: wrong(key, other)

  defp wrong(key, given),
    do: {:error, Error.new(key, "a time such as 2026-11-22T09:00:00Z, or unix seconds", given)}
end
