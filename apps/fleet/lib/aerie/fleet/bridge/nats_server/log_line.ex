defmodule Aerie.Fleet.Bridge.NatsServer.LogLine do
  @moduledoc "Reads a line of nats-server's log. Pure."

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
end
