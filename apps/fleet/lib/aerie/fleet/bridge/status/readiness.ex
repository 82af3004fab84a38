defmodule Aerie.Fleet.Bridge.Status.Readiness do
  @moduledoc "Whether NATS stores events, and if not, why. Pure."

  @doc "Why NATS does not store events, from the state of the bridge's parts: the first cause, which explains the others. Nil if it does."
  @spec problem(%{server: map(), connection: map(), streams: map(), outbox: map()}) :: String.t() | nil
  def problem(parts) do
    server(parts.server) || connection(parts.connection) || streams(parts.connection, parts.streams) ||
      events(parts.server, parts.connection, parts.outbox)
  end

  @doc "Advice about a nats-server that is connected but confirms nothing, as after a failed write."
  @spec mend(String.t()) :: String.t()
  def mend(server),
    do:
      "if the disk of #{server} was full, make room and restart it: after a failed write nats-server stores nothing until then"

  defp server(%{status: {:failed, text}}), do: "the NATS server cannot start: #{text}"
  defp server(%{fault: text}) when is_binary(text), do: "the NATS server cannot store: #{text}"
  defp server(_none_or_well), do: nil

  defp connection(%{status: :up}), do: nil
  defp connection(%{problem: text}) when is_binary(text), do: text
  defp connection(_not_tried_yet), do: "not connected to NATS"

  # The embedded server is restarted by the gateway itself (`Aerie.Fleet.Bridge.NatsServer`).
  defp events(server, connection, %{stalled: text, silent?: true}) when server == %{},
    do: "#{text}: #{mend("nats-server at #{connection[:url]}")}"

  defp events(_server, _connection, outbox), do: outbox[:stalled]

  defp streams(%{streams: :ok}, _streams), do: nil

  defp streams(_connection, streams) do
    broken = for {name, {:error, text}} <- Map.get(streams, :report, %{}), do: "stream #{name}: #{text}"
    if broken == [], do: "the streams are not there yet", else: Enum.join(broken, "; ")
  end
end
