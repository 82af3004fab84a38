defmodule Aerie.Fleet.Bridge.NatsServer.Repeats do
  @quiet_ms 60_000

  @moduledoc """
  Leaves out lines of nats-server's log that only repeat themselves, as while a hub is away: of those that differ in numbers alone, one in
  #{div(@quiet_ms, 1000)} s is written, and it says how many were not. Pure.
  """

  # It has few kinds of lines.
  @most 100

  @opaque t :: %{String.t() => {written_ms :: integer(), left_out :: non_neg_integer()}}

  @doc "No lines yet."
  @spec new() :: t()
  def new, do: %{}

  @doc "What to write of a line without its time: nil for nothing, or how many before it were left out."
  @spec observe(t(), String.t(), now_ms :: integer()) :: {nil | non_neg_integer(), t()}
  def observe(seen, text, now) do
    kind = String.replace(text, ~r/\d+/, "")

    case seen do
      %{^kind => {at, left_out}} when now - at < @quiet_ms -> {nil, %{seen | kind => {at, left_out + 1}}}
      %{^kind => {_at, left_out}} -> {left_out, %{seen | kind => {now, 0}}}
      _new when map_size(seen) >= @most -> {0, %{kind => {now, 0}}}
      _new -> {0, Map.put(seen, kind, {now, 0})}
    end
  end
end
