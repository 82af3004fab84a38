defmodule Aerie.CLI.Status.Access do
  @moduledoc """
  The interfaces of a gateway that are open: for each one, who can reach it and what they may do there. Pure: from snapshots of links and
  clients and from the configuration.
  """

  alias MavRouter.Link.Spec
  alias Aerie.Control.Policy
  alias MavRouter.Endpoints.Access

  # Clients that no entry of `policy.clients` names: on this machine, and on a link with `gcs: allow`.
  @unlisted %{role: :operator, permissions: []}

  @typedoc "`wide`: other machines may do more here than look on"
  @type interface :: %{address: String.t(), who: String.t(), wide: boolean}

  @doc """
  Lists the interfaces: links (`commands` maps a link's id to its `gcs` setting), clients, and the servers of the configuration (`config`
  nil: no servers). `listed` are the clients of the policy in force.
  """
  @spec list([map], %{String.t() => :auto | :allow | :deny}, [map], Aerie.Config.t() | nil, [Policy.client()]) ::
          [
            interface
          ]
  def list(links, commands, clients, config, listed \\ []) do
    Enum.map(links, &link(&1, Map.get(commands, &1.id, :auto), listed)) ++
      Enum.map(clients, &client(&1, listed)) ++ servers(config, listed)
  end

  defp link(%{spec: %{recorded: true}} = link, _gcs, _listed),
    do: interface(address(link), "a recording: no commands", false)

  defp link(link, gcs, listed) do
    who = who(link)
    local? = local?(link)
    source = source(listed, link.id)
    commands? = source.role != :viewer

    case gcs do
      :allow when commands? ->
        interface(
          address(link),
          "#{who}: vehicles, and commands to vehicles (gcs: allow; #{named(source)})",
          not local?
        )

      :auto when commands? and local? ->
        interface(address(link), "#{who}: vehicles, and commands to vehicles (#{named(source)})", false)

      :auto when commands? and link.spec.server ->
        interface(
          address(link),
          "#{who}: vehicles; commands from this machine only (#{named(source)})",
          false
        )

      _closed ->
        interface(address(link), "#{who}: vehicles; no commands", false)
    end
  end

  defp client(client, listed) do
    router = client.spec.options[:router] || []
    who = who(client)
    found = entry(listed, client.id)

    cond do
      router[:role] == :read_only ->
        interface(address(client), "#{who}: look on (read_only)", false)

      found != nil or local?(client) ->
        source = found || @unlisted
        interface(address(client), "#{who}: #{may(source)}", source.role != :viewer and not local?(client))

      # Without an entry only this machine commands.
      client.spec.server ->
        words = "#{who}: look on (viewer); programs of this machine: #{may(@unlisted)}"
        interface(address(client), words, false)

      true ->
        interface(address(client), "#{who}: look on (viewer)", false)
    end
  end

  # An entry of `policy.clients` by the id, or the one for all others.
  defp entry(listed, id), do: Enum.find(listed, &(&1.id == id)) || Enum.find(listed, &(&1.id == nil))
  defp source(listed, id), do: entry(listed, id) || @unlisted

  defp may(%{role: :viewer}), do: "look on (viewer)"
  defp may(%{role: :admin} = source), do: "look on, command and maintain vehicles (#{named(source)})"
  defp may(source), do: "look on and command vehicles (#{named(source)})"

  # Missing permissions of a role are listed by name.
  defp named(%{role: role, permissions: permissions}), do: Enum.join([role | permissions], ", ")

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

  defp local?(link), do: loopback?(link[:local]) or loopback?(link[:peer] || Spec.place(link.spec))
  defp loopback?(place), do: Access.loopback?(place)

  defp servers(nil, _listed), do: []

  defp servers(config, listed) do
    http =
      if config.http.enabled,
        do: [interface("http://#{place(config.http)}", rest(config.api), false) | console(config)],
        else: []

    ws = if config.websocket.enabled, do: [websocket(config, listed)], else: []

    sockets =
      if config.sockets.enabled,
        do: [
          interface(
            "mavlink.sock",
            "users whom its file permissions admit: #{may(source(listed, nil))}",
            false
          )
        ],
        else: []

    http ++ ws ++ sockets ++ nats(config)
  end

  defp nats(%{nats: %{mode: :embedded}} = config) do
    unsigned =
      case config.policy.unsigned do
        nil -> "commands with a signature of policy.sources only"
        role -> "commands without a signature as #{role} (policy.unsigned)"
      end

    [
      interface(
        "nats (embedded)",
        "anyone with its login: read, and change what is stored; #{unsigned}",
        config.policy.unsigned not in [nil, :viewer]
      )
    ]
  end

  defp nats(_other), do: []

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

  defp keys?(api), do: api[:key] != nil or api[:keys_file] != nil

  # Without keys /api is for this machine, whatever the address, and nobody there is an admin
  # (Aerie.Access.Changes.Rights).
  defp rest(api) do
    if keys?(api),
      do: "anyone with a key: by its role, look on, command vehicles, and change what /api changes",
      else:
        "programs of this machine: look on, and save recordings; no commands, no changes of links, clients and rules"
  end

  # A key without a role, and no key, are judged like a client that connects by UDP or TCP.
  defp websocket(%{websocket: listener, api: api}, listed) do
    address = place(listener)
    source = source(listed, nil)

    cond do
      keys?(api) ->
        interface("ws://#{address}", "anyone with a key: by its role, look on and command vehicles", false)

      loopback?(address) ->
        interface("ws://#{address}", "programs of this machine: #{may(source)}", false)

      true ->
        interface("ws://#{address}", "anyone who reaches it: #{may(source)}", source.role != :viewer)
    end
  end

  defp interface(address, who, wide), do: %{address: address, who: who, wide: wide}
end
