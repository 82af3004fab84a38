defmodule Aerie.Bridge.Server.LogLine do
  @moduledoc "What a line of nats-server's log says. Pure."

  @typedoc """
  * `{:listening, port}` - it takes connections on this port
  * `:ready` - it is up, JetStream included
  * `:port_taken` - somebody else has the port
  * `{:write_error, text}` - a stream could not be written; from then on the server stores nothing in it
  """
  @type fact ::
          {:listening, :inet.port_number()} | :ready | :port_taken | {:write_error, String.t()} | nil

  @write_error ~r/critical write error: |failed to store a msg on stream .*?: |out of .* resources, will be DISABLED/i

  @doc """
  Level for the logger, text without process id and time, and what the gateway needs to know.

      iex> Aerie.Bridge.Server.LogLine.parse("[7] 2026/11/20 22:22:41.702000 [INF] Server is ready")
      {:debug, "Server is ready", :ready}
  """
  @spec parse(String.t()) :: {Logger.level(), String.t(), fact()}
  def parse(line) do
    line = String.replace_invalid(line)

    case Regex.run(~r/\A\[\d+\] \S+ \S+ \[([A-Z]{3})\] (.*)\z/s, line) do
      # Its configuration is readable by its owner alone.
      [_, "WRN", "Plaintext passwords detected" <> _ = text] -> {:debug, text, nil}
      [_, level, text] -> {level(level), text, fact(text)}
      # What it writes before it has a log: mistakes in its configuration or arguments.
      nil -> {:warning, line, fact(line)}
    end
  end

  # Its information is about itself; the gateway's own log says what matters of that.
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
      true -> nil
    end
  end

  # `write /a/long/path: no space left on device`: what is wrong stands at the end.
  defp cause(text), do: text |> String.split(": ") |> List.last()
end
