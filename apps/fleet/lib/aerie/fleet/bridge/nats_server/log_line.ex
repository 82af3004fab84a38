defmodule Aerie.Fleet.Bridge.NatsServer.LogLine do
  @quiet_ms 60_000

  @moduledoc """
  Reads a line of nats-server's log. Pure.

  Lines that only repeat themselves, as while a hub is away, are left out: of those that differ in numbers alone, one in
  #{div(@quiet_ms, 1000)} s is written, and it says how many were not.
  """

  # It has few kinds of lines.
  @most 100

  @typedoc "When a line of each kind was written last, and how many were left out since."
  @type seen :: %{String.t() => {written_ms :: integer(), left_out :: non_neg_integer()}}

  @typedoc """
  * `{:listening, port}` - the server accepts connections on this port
  * `:ready` - it is up, with JetStream
  * `:port_taken` - another program has the port
  * `{:leaf, nil}` - the connection to the hub is there; `{:leaf, text}` - why it is not
  * `{:write_error, text}` - a stream could not be written; from then on the server stores nothing in it
  """
  @type fact ::
          {:listening, :inet.port_number()}
          | :ready
          | :port_taken
          | {:leaf, String.t() | nil}
          | {:write_error, String.t()}
          | nil

  @write_error ~r/critical write error: |failed to store a msg on stream .*?: |out of .* resources, will be DISABLED/i

  @leaf_error ~r/Leafnode Error '?(.*?)'?\z|Error trying to connect as leafnode to remote server .*?: (.*)\z/

  @doc """
  The level for the logger, the text without process id and time, and what the gateway needs to know of it.

      iex> Aerie.Fleet.Bridge.NatsServer.LogLine.parse("[7] 2026/11/20 22:22:41.702000 [INF] Server is ready")
      {:debug, "Server is ready", :ready}
  """
  @spec parse(String.t()) :: {Logger.level(), String.t(), fact()}
  def parse(line) do
    line = String.replace_invalid(line)

    case Regex.run(~r/\A\[\d+\] \S+ \S+ \[([A-Z]{3})\] (.*)\z/s, line) do
      # Only the owner can read its configuration.
      [_, "WRN", "Plaintext passwords detected" <> _ = text] -> {:debug, text, nil}
      [_, level, text] -> {level(level), text, fact(text)}
      # Before its log is set up: mistakes in its configuration or arguments.
      nil -> {:warning, line, fact(line)}
    end
  end

  # The gateway's own log says what matters of the server's information.
  defp level(level) when level in ["INF", "DBG", "TRC"], do: :debug
  defp level("WRN"), do: :warning
  defp level(_error_or_fatal), do: :error

  defp fact("Server is ready" <> _), do: :ready

  defp fact("Listening for client connections on " <> place) do
    with [_, port] <- Regex.run(~r/:(\d{1,5})\z/, String.trim(place)),
         do: {:listening, String.to_integer(port)}
  end

  defp fact(text) do
    cond do
      text =~ "address already in use" -> :port_taken
      text =~ @write_error -> {:write_error, cause(text)}
      text =~ "Leafnode connection created" -> {:leaf, nil}
      error = Regex.run(@leaf_error, text) -> {:leaf, List.last(error)}
      true -> nil
    end
  end

  # `write /a/long/path: no space left on device`: the cause is at the end.
  defp cause(text), do: text |> String.split(": ") |> List.last()

  @doc "What to write of a line's text: nil for nothing, or how many before it were left out. `seen` begins as `%{}`."
  @spec observe(seen(), String.t(), now_ms :: integer()) :: {nil | non_neg_integer(), seen()}
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
