defmodule Aerie.Bridge.Problem do
  @moduledoc "What keeps events from being stored by NATS, in words; nil when nothing does. Pure."

  @doc "From what is known of the bridge's parts; the first that explains the others."
  @spec text(%{server: map(), connection: map(), streams: map(), outbox: map()}) :: String.t() | nil
  def text(parts) do
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
