defmodule Aerie.Config.Resolve do
  @moduledoc """
  Handles what concerns several keys: derived values, contradictions, and warnings. Pure.

  The rules of one part are beside its keys (`c:Aerie.Base.Settings.problems/1`); the rules here concern the keys of several
  parts.
  """

  import Aerie.Base.Settings.Rules

  alias Aerie.Config
  alias Aerie.Fleet.Bridge
  alias MavRouter.Identity
  alias Aerie.Config.{Keys, Names}
  alias MavRouter.Link.Spec
  alias Aerie.Base.Settings.Schema

  @doc "Fills in the derived values; returns the remaining problems."
  @spec run(Config.t()) :: {Config.t(), [Schema.problem()]}
  def run(%Config{} = config) do
    contradictions = contradictions(config.links) ++ Bridge.Settings.contradictions(config.nats, config.given)

    config =
      config
      |> identity()
      |> vehicles()
      |> keys()
      |> links()
      |> clients()
      |> sampling()
      |> nats()

    {names, doubts} = Names.check(config)
    problems = Enum.flat_map(Keys.parts(), & &1.problems(config)) ++ ports(config) ++ names ++ contradictions
    warnings = Enum.flat_map(Keys.parts(), & &1.warnings(config))
    {%{config | warnings: config.warnings ++ warnings ++ doubts}, problems}
  end

  defp identity(%{mavlink: mavlink} = config) do
    known = Identity.Settings.from(config)

    warnings =
      if mavlink.component_id == known.component_id,
        do: [],
        else: [
          "mavlink.component_id is #{mavlink.component_id}, which is the autopilot's own: this gateway is component " <>
            "#{known.component_id} (on-board computer)."
        ]

    mavlink = Map.merge(mavlink, Map.take(known, [:system_id, :component_id, :heartbeat_type]))
    %{config | mavlink: mavlink, warnings: config.warnings ++ warnings}
  end

  defp vehicles(config) do
    own =
      if config.vehicle_id != nil and config.mavlink.system_id != :auto,
        do: [%{id: config.vehicle_id, network: config.network, system_id: config.mavlink.system_id}],
        else: []

    listed = Enum.map(config.vehicles, &%{&1 | network: &1.network || config.network})
    %{config | vehicles: own ++ (listed -- own)}
  end

  defp keys(config) do
    put_in(config.signing.keys, Enum.map(config.signing.keys, &%{&1 | network: &1.network || config.network}))
  end

  defp links(config) do
    listed = Enum.map(config.links, &link(config, &1, true))
    %{config | links: listed ++ local_link(config, listed)}
  end

  # The address of the first design's gateway.yaml is an additional link. The default one exists only if no other link is configured.
  defp local_link(config, listed) do
    case {config.mavlink.local_addr, listed} do
      {:off, _} -> []
      {nil, [_ | _]} -> []
      {nil, []} -> [local(config, {"0.0.0.0", 14_550}, false)]
      {address, _} -> [local(config, address, true)]
    end
  end

  defp local(config, {host, port}, given) do
    host = if String.contains?(host, ":"), do: "[#{host}]", else: host
    keys = %{id: "udp", url: "udpin:#{host}:#{port}", network: nil, label: nil, enabled: true, secure: false}
    link(config, keys, given)
  end

  defp contradictions(links) do
    for {link, index} <- Enum.with_index(links), {key, words} <- Spec.contradictions(link) do
      problem(
        ["links", index, Atom.to_string(key)],
        "the same in the key and in the url, or one of them",
        words
      )
    end
  end

  # A connection string may contain its id and network (`udpin::14550?network=field`).
  defp link(config, link, given) do
    names_network? = String.contains?(link.url, ["?network=", "&network="])
    network = link.network || if(names_network?, do: nil, else: config.network)
    {:ok, spec} = Spec.parse(link.url, id: link.id, network: network)
    secure = link.secure || spec.options[:secure] == true
    Map.merge(link, %{id: spec.id, network: spec.network, secure: secure, given: given, spec: spec})
  end

  defp clients(%{clients: nil} = config), do: %{config | clients: :default}

  defp clients(config) do
    clients =
      for client <- config.clients do
        {:ok, spec} = Spec.parse(client.url, id: client.id)
        %{client | id: spec.id}
      end

    %{config | clients: clients}
  end

  defp sampling(%{sampling: sampling} = config) do
    threshold =
      with number when number != nil <- sampling.battery_change_threshold, do: %{"remaining" => number}

    groups =
      sampling.groups
      |> short(config, "position.hz", [:position, :hz], sampling.position_hz)
      |> short(config, "attitude.hz", [:attitude, :hz], sampling.attitude_hz)
      |> short(config, "battery.threshold", [:battery, :threshold], threshold)

    %{config | sampling: %{sampling | groups: groups}}
  end

  defp short(groups, config, key, path, value) do
    if value == nil or Config.given?(config, "sampling.groups." <> key),
      do: groups,
      else: put_in(groups, path, value)
  end

  # TLS and logins other than a token are for the servers at nats.url. In one file with mode embedded they are a contradiction, which
  # is an error. But `--nats embedded` with the configuration of a real gateway means the embedded server without them, and a replay
  # (`Aerie.CLI.Start.Plan`) one without the hub.
  defp nats(config) do
    %{nats: nats} = Bridge.Settings.from(config)
    told? = nats.mode != :embedded or config.given["nats.mode"] != "command line"
    nats = if told?, do: nats, else: Bridge.Settings.embedded(nats)
    hub? = config.given["nats.leaf.url"] != "command line" or nats.leaf.url != []
    %{config | nats: if(hub?, do: nats, else: Bridge.Settings.without_hub(nats))}
  end

  defp ports(%{http: http, nats: nats}) do
    failed([
      {http.port == nats.port and nats.mode == :embedded and http.enabled and http.port != 0,
       ["http", "port"], "another port than nats.port", "#{http.port}"}
    ])
  end
end
