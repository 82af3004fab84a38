defmodule AerieCLI.Status.Faces do
  @moduledoc """
  The ways into a gateway: for each one, who can reach it and what they may do there. Pure: from snapshots of links and
  clients and from the configuration.
  """

  alias Aerie.Link.Spec
  alias Aerie.Router.Gate

  @listening [:udp_server, :tcp_server]

  @typedoc "`wide`: other machines may do more here than look on"
  @type face :: %{address: String.t(), who: String.t(), wide: boolean}

  @doc """
  Lists the ways in: links (`commands` maps a link's id to its `gcs` setting), clients, and the servers of the
  configuration (`config` nil: no servers).
  """
  @spec list([map], %{String.t() => :auto | :allow | :deny}, [map], Aerie.Config.t() | nil) :: [face]
  def list(links, commands, clients, config) do
    Enum.map(links, &link(&1, Map.get(commands, &1.id, :auto))) ++
      Enum.map(clients, &client/1) ++ servers(config)
  end

  defp link(%{kind: :replay} = link, _gcs), do: face(address(link), "a recording: no commands", false)

  defp link(link, gcs) do
    who = who(link)
    local? = local?(link)

    case gcs do
      :allow ->
        face(address(link), "#{who}: vehicles, and commands to vehicles (gcs: allow)", not local?)

      :auto when local? ->
        face(address(link), "#{who}: vehicles, and commands to vehicles", false)

      :auto when link.kind in @listening ->
        face(address(link), "#{who}: vehicles; commands from this machine only", false)

      _closed ->
        face(address(link), "#{who}: vehicles; no commands", false)
    end
  end

  defp client(client) do
    router = client.spec.options[:router] || []
    may = if router[:role] == :read_only, do: "look on", else: "look on and command vehicles"
    face(address(client), "#{who(client)}: #{may}", router[:role] != :read_only and not local?(client))
  end

  # A server shows the port that it really got.
  defp address(%{kind: kind, local: local} = link) when kind in @listening and is_binary(local),
    do: "#{link.url |> String.split(":") |> hd()}:#{local} (#{link.id})"

  defp address(link), do: "#{link.url} (#{link.id})"

  defp who(%{kind: kind} = link) do
    cond do
      local?(link) -> "programs of this machine"
      kind in @listening -> "anyone who reaches it"
      true -> "the other end"
    end
  end

  defp local?(%{kind: :serial}), do: false
  defp local?(link), do: Gate.loopback?(link[:local]) or Gate.loopback?(link[:peer] || Spec.place(link.spec))

  defp servers(nil), do: []

  defp servers(config) do
    http =
      if config.http.enabled,
        do: [server("http", config.http, config.api, "look on, and change what /api changes")],
        else: []

    ws =
      if config.websocket.enabled,
        do: [server("ws", config.websocket, config.api, "look on and command vehicles")],
        else: []

    sockets =
      if config.sockets.enabled,
        do: [
          face(
            "mavlink.sock",
            "whoever its file permissions let in: look on and command vehicles",
            false
          )
        ],
        else: []

    nats =
      if config.nats.mode == :embedded,
        do: [face("nats (embedded)", "anyone with its login: read, and change what is stored", false)],
        else: []

    http ++ ws ++ sockets ++ nats
  end

  defp server(scheme, %{address: address, port: port}, api, may) do
    keys? = api[:key] != nil or api[:keys_file] != nil
    address = if String.contains?(address, ":"), do: "[#{address}]:#{port}", else: "#{address}:#{port}"

    who =
      cond do
        keys? -> "anyone with a key"
        Gate.loopback?(address) -> "programs of this machine"
        true -> "anyone who reaches it"
      end

    face("#{scheme}://#{address}", "#{who}: #{may}", not keys? and not Gate.loopback?(address))
  end

  defp face(address, who, wide), do: %{address: address, who: who, wide: wide}
end
