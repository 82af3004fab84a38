defmodule Aerie.Incident.Span do
  @moduledoc """
  The time that an incident covers, in unix microseconds. Pure.

  A time is RFC 3339 (`2026-11-28T20:15:00Z`, with any offset), `HH:MM` or `HH:MM:SS` in UTC, the latest such time (for
  the beginning: the latest before the end), or relative to now: `-90s`, `-10m`, `-2h`, `-1d`, `now`.
  """

  @enforce_keys [:from, :to]
  defstruct [:from, :to]

  @type t :: %__MODULE__{from: integer(), to: integer()}

  @second 1_000_000
  @day 86_400 * @second
  @default 15 * 60 * @second
  @longest 7 * @day
  @units %{"s" => 1, "m" => 60, "h" => 3_600, "d" => 86_400}
  @expected "expected RFC 3339 (2026-11-28T20:15:00Z), HH:MM (UTC) or a time before now such as -10m"

  @doc "The span of two texts; nil for `to` is now, nil for `from` fifteen minutes before `to`. The error says which text is wrong."
  @spec parse(String.t() | nil, String.t() | nil, now :: integer()) :: {:ok, t()} | {:error, String.t()}
  def parse(from, to, now) do
    with {:ok, to} <- time("--to", to || "now", now, now),
         {:ok, from} <- if(from, do: time("--from", from, now, min(now, to - 1)), else: {:ok, to - @default}) do
      cond do
        from >= to -> {:error, "--from #{text(from)} is not before --to #{text(to)}"}
        to - from > @longest -> {:error, "#{text(from)} to #{text(to)} is more than seven days"}
        from > now -> {:error, "--from #{text(from)} is in the future"}
        true -> {:ok, %__MODULE__{from: from, to: min(to, now)}}
      end
    end
  end

  @doc "Whether a time is within the span."
  @spec within?(t(), integer() | nil) :: boolean()
  def within?(_span, nil), do: false
  def within?(%__MODULE__{from: from, to: to}, at), do: at >= from and at <= to

  @doc "A time as a text with seconds."
  @spec text(integer()) :: String.t()
  def text(us), do: us |> DateTime.from_unix!(:microsecond) |> Calendar.strftime("%Y-%m-%dT%H:%M:%SZ")

  @doc "A time of a record (ISO 8601) in unix microseconds; nil for anything else."
  @spec read(term()) :: integer() | nil
  def read(text) when is_binary(text) do
    case DateTime.from_iso8601(text) do
      {:ok, time, _offset} -> DateTime.to_unix(time, :microsecond)
      {:error, _reason} -> nil
    end
  end

  def read(_other), do: nil

  defp time(_option, "now", now, _latest), do: {:ok, now}

  defp time(option, text, now, latest) do
    cond do
      match = Regex.run(~r/\A-(\d{1,6})([smhd])\z/, text) ->
        [_all, number, unit] = match
        {:ok, now - String.to_integer(number) * @units[unit] * @second}

      text =~ ~r/\A\d{1,2}:\d{2}(:\d{2})?\z/ ->
        clock(option, text, latest)

      at = read(text) ->
        range(option, text, at)

      true ->
        {:error, "#{option}: '#{text}': #{@expected}"}
    end
  end

  defp clock(option, text, latest) do
    padded =
      String.pad_leading(if(length(String.split(text, ":")) == 2, do: text <> ":00", else: text), 8, "0")

    case Time.from_iso8601(padded) do
      {:ok, time} ->
        {seconds, _us} = Time.to_seconds_after_midnight(time)
        at = latest - Integer.mod(latest, @day) + seconds * @second
        {:ok, if(at > latest, do: at - @day, else: at)}

      {:error, _reason} ->
        {:error, "#{option}: '#{text}': #{@expected}"}
    end
  end

  # What recordings may have.
  defp range(_option, _text, at) when at >= 0 and at < 4_102_444_800 * @second, do: {:ok, at}
  defp range(option, text, _at), do: {:error, "#{option}: '#{text}' is not between 1970 and 2100"}
end
