defmodule Aerie.Bridge.Readiness do
  @moduledoc "Whether NATS stores events, and if not, why. Pure."

  @doc "Why NATS does not store events, from the state of the bridge's parts: the first cause, which explains the others. Nil if it does."
  @spec problem(%{server: map(), connection: map(), streams: map(), outbox: map()}) :: String.t() | nil
  def problem(parts) do
    server(parts.server) || connection(parts.connection) || streams(parts.connection, parts.streams) ||
      parts.outbox[:stalled]
  end

  defp server(%{status: {:failed, text}}), do: "the NATS server cannot start: #{text}"
  defp server(%{fault: text}) when is_binary(text), do: "the NATS server cannot store: #{text}"
  defp server(_none_or_well), do: nil

  defp connection(%{status: :up}), do: nil
  defp connection(_down), do: "not connected to NATS"

  defp streams(%{streams: :ok}, _streams), do: nil

  defp streams(_connection, streams) do
    broken = for {name, {:error, text}} <- Map.get(streams, :report, %{}), do: "stream #{name}: #{text}"
    if broken == [], do: "the streams are not there yet", else: Enum.join(broken, "; ")
  end
end
