defmodule Aerie.CLI.Status.Access do
  @moduledoc """
  The interfaces of a gateway that are open: for each one, who can reach it and what they may do there. Pure: from snapshots of links and
  clients and from the configuration.
  """

  alias Aerie.Link.Spec
  alias Aerie.Router.Access

  @typedoc "`wide`: other machines may do more here than look on"
  @type interface :: %{address: String.t(), who: String.t(), wide: boolean}

  @doc """
  Lists the interfaces: links (`commands` maps a link's id to its `gcs` setting), clients, and the servers of the
  configuration (`config` nil: no servers).
  """
  @spec list([map], %{String.t() => :auto | :allow | :deny}, [map], Aerie.Config.t() | nil) :: [interface]
  def list(links, commands, clients, config) do
    Enum.map(links, &link(&1, Map.get(commands, &1.id, :auto))) ++
      Enum.map(clients, &client/1) ++ servers(config)
  end

  defp link(%{spec: %{recorded: true}} = link, _gcs),
    do: interface(address(link), "a recording: no commands", false)

  defp link(link, gcs) do
    who = who(link)
    local? = local?(link)

    case gcs do
      :allow ->
        interface(address(link), "#{who}: vehicles, and commands to vehicles (gcs: allow)", not local?)

      :auto when local? ->
        interface(address(link), "#{who}: vehicles, and commands to vehicles", false)

      :auto when link.spec.server ->
        interface(address(link), "#{who}: vehicles; commands from this machine only", false)

      _closed ->
        interface(address(link), "#{who}: vehicles; no commands", false)
    end
  end

  defp client(client) do
    router = client.spec.options[:router] || []
    may = if router[:role] == :read_only, do: "look on", else: "look on and command vehicles"
    interface(address(client), "#{who(client)}: #{may}", router[:role] != :read_only and not local?(client))
  end

  # A server shows the port that it really got.
  defp address(%{spec: %{server: true}, local: local} = link) when is_binary(local),
    do: "#{link.url |> String.split(":") |> hd()}:#{local} (#{link.id})"

  defp address(link), do: "#{link.url} (#{link.id})"

  defp who(link) do
    cond do
      local?(link) -> "programs of this machine"
      link.spec.server -> "anyone who reaches it"
      true -> "the other end"
    end
  end

  defp local?(link),
    do: Access.loopback?(link[:local]) or Access.loopback?(link[:peer] || Spec.place(link.spec))

  defp servers(nil), do: []

  defp servers(config) do
    http =
      if config.http.enabled,
        do: [
          server("http", config.http, config.api, "look on, and change what /api changes") | console(config)
        ],
        else: []

    ws =
      if config.websocket.enabled,
        do: [server("ws", config.websocket, config.api, "look on and command vehicles")],
        else: []

    sockets =
      if config.sockets.enabled,
        do: [
          interface(
            "mavlink.sock",
            "users whom its file permissions admit: look on and command vehicles",
            false
          )
        ],
        else: []

    nats =
      if config.nats.mode == :embedded,
        do: [interface("nats (embedded)", "anyone with its login: read, and change what is stored", false)],
        else: []

    http ++ ws ++ sockets ++ nats
  end

  defp console(%{console: %{enabled: true}, http: http}),
    do: [
      interface(
        "http://#{place(http)} console",
        "users who sign in: look on and command vehicles, by their role",
        false
      )
    ]

  defp console(_off), do: []

  defp place(%{address: address, port: port}),
    do: if(String.contains?(address, ":"), do: "[#{address}]:#{port}", else: "#{address}:#{port}")

  defp server(scheme, listener, api, may) do
    keys? = api[:key] != nil or api[:keys_file] != nil
    address = place(listener)

    who =
      cond do
        keys? -> "anyone with a key"
        # Without keys /api is for this machine, whatever the address (FleetWeb.API.Access).
        scheme == "http" or Access.loopback?(address) -> "programs of this machine"
        true -> "anyone who reaches it"
      end

    wide? = not keys? and scheme != "http" and not Access.loopback?(address)
    interface("#{scheme}://#{address}", "#{who}: #{may}", wide?)
  end

  defp interface(address, who, wide), do: %{address: address, who: who, wide: wide}
end
