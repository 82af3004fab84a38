defmodule Aerie.Fleet.Bridge.NatsServer.Settings do
  @moduledoc "The configuration file of the embedded nats-server, as text. Pure."

  alias Aerie.Fleet.Bridge.Leaf

  @typedoc "`port` 0 lets the server take any free one; it then says which in its log."
  @type t :: %{
          name: String.t(),
          address: String.t(),
          port: :inet.port_number(),
          store_dir: Path.t(),
          max_memory_mb: pos_integer(),
          max_store_mb: pos_integer(),
          token: String.t(),
          domain: String.t() | nil,
          leaf: map(),
          seed: String.t() | nil
        }

  @doc "The text of the file."
  @spec render(t()) :: String.t()
  def render(settings) do
    port = if settings.port == 0, do: -1, else: settings.port

    """
    # Written by Aerie at each start; changes are lost.
    server_name: #{quoted(settings.name)}
    host: #{quoted(settings.address)}
    port: #{port}
    pid_file: #{quoted(Path.join(settings.store_dir, "nats-server.pid"))}
    authorization { token: #{quoted(settings.token)} }
    jetstream {
      store_dir: #{quoted(Path.join(settings.store_dir, "data"))}
      max_memory_store: #{settings.max_memory_mb}MB
      max_file_store: #{settings.max_store_mb}MB
      #{if settings.domain, do: "domain: #{quoted(settings.domain)}"}
    }
    """ <> Leaf.Config.render(settings.leaf, settings.seed)
  end

  # nats-server reads escapes in quoted strings as JSON does.
  defp quoted(text), do: JSON.encode!(text)
end
