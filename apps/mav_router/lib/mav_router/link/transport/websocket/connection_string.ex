defmodule MavRouter.Link.Transport.WebSocket.ConnectionString do
  @moduledoc """
  The connection strings of WebSockets: `ws://HOST[:PORT][/PATH]` (port 80 unless given) and `wss://…` (TLS, port 443).

  The URL may have a query of its own: options that are not ours are left to the server, and shown to nobody. `wss` takes
  `ca=FILE`: certificate authorities (PEM) instead of the system's.
  """

  alias MavRouter.Link.Transport.Form
  alias MavRouter.Link.Transport.Query

  @doc "See `c:MavRouter.Link.Transport.forms/0`."
  @spec forms() :: [Form.t()]
  def forms do
    for {prefix, example, help} <- [
          {"ws://", "192.168.1.20:8765/", "connect to a WebSocket server"},
          {"wss://", "agent.example.org/mavlink", "the same with TLS (?ca=FILE: its authority)"}
        ] do
      form = Form.address(prefix, example, help, "HOST[:PORT][/PATH]")
      %{form | options: ["ca"], passes_query: true}
    end
  end

  @doc "See `c:MavRouter.Link.Transport.parse/2`."
  @spec parse(String.t(), String.t()) :: {:ok, map} | {:error, String.t()}
  def parse(prefix, rest) do
    {authority, path} = authority(rest)
    tls? = prefix == "wss://"

    with :ok <- no_login(authority),
         :ok <- path(path),
         {:ok, fields} <- Form.parse_address(with_port(authority, tls?), false) do
      {:ok, Map.merge(fields, %{path: path, tls: tls?})}
    end
  end

  @doc "See `c:MavRouter.Link.Transport.option/3`."
  @spec option(String.t(), String.t(), String.t()) :: {:ok, atom, term} | {:error, Query.reasons()}
  def option("wss://", "ca", file) when file != "", do: {:ok, :ca, file}

  def option(_prefix, "ca", _file) do
    {:error,
     reason: ~s("ca" is not an option without TLS and a file),
     expected: "wss://HOST?ca=FILE",
     example: "wss://agent.example.org/mavlink?ca=/etc/ca.pem"}
  end

  defp authority(rest) do
    case String.split(rest, ~r{(?=[/?])}, parts: 2) do
      [authority] -> {authority, "/"}
      [authority, "?" <> _ = query] -> {authority, "/" <> query}
      [authority, path] -> {authority, path}
    end
  end

  defp no_login(authority) do
    if authority =~ "@", do: {:error, "a login is not possible in it"}, else: :ok
  end

  defp path(path) do
    cond do
      path =~ "#" -> {:error, "a WebSocket's URL has no fragment (#)"}
      path =~ ~r/\A[!-~]*\z/ -> :ok
      true -> {:error, "its path has characters that are written with % in a URL"}
    end
  end

  defp with_port(authority, tls?) do
    if authority == "" or authority =~ ~r/:[^\]]*\z/,
      do: authority,
      else: authority <> if(tls?, do: ":443", else: ":80")
  end
end
