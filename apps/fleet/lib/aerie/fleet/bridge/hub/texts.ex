defmodule Aerie.Fleet.Bridge.Hub.Texts do
  @moduledoc "The configuration files of a hub's servers and gateways, and of its vehicles. Pure."

  alias Aerie.Fleet.Bridge.Hub.Quota

  @typedoc "`client`, `leaf` and `route`."
  @type ports :: %{String.t() => :inet.port_number()}

  @doc "`server.conf` of one of the hub's servers: its name, its ports, and with several servers the cluster."
  @spec server(String.t(), [String.t()], String.t(), ports()) :: String.t()
  def server(host, hosts, environment, ports) do
    """
    # Written by bin/nats-setup.
    server_name: #{JSON.encode!(host)}
    port: #{ports["client"]}
    leafnodes {
      port: #{ports["leaf"]}
      tls { cert_file: "server.pem", key_file: "server.key", timeout: 5 }
    }
    """ <> cluster(hosts, environment, ports)
  end

  defp cluster([_one], _environment, _ports), do: ""

  # Servers of a cluster trust each other by certificates of the fleet's authority.
  defp cluster(hosts, environment, ports) do
    routes = Enum.map_join(hosts, ", ", &JSON.encode!("nats-route://#{address(&1)}:#{ports["route"]}"))

    """
    cluster {
      name: #{JSON.encode!("fleet-" <> environment)}
      port: #{ports["route"]}
      routes: [#{routes}]
      tls { cert_file: "server.pem", key_file: "server.key", ca_file: "ca.pem", verify: true, timeout: 5 }
    }
    """
  end

  # A server's addresses, each with a port.
  defp urls(hosts, port), do: for(host <- hosts, do: "tls://#{address(host)}:#{port}")

  defp address(host), do: if(String.contains?(host, ":"), do: "[#{host}]", else: host)

  @doc "`gateway.yaml` of a hub's gateway. `keys`: from which those are derived that seal desired states."
  @spec hub(String.t(), [String.t()], ports(), Quota.t(), %{key: String.t(), former: String.t() | nil}) ::
          String.t()
  def hub(environment, hosts, ports, room, keys) do
    """
    # The gateway of the hub: files beside this one.
    environment: #{environment}
    nats:
      url: #{JSON.encode!(urls(hosts, ports["client"]))}
      nkey_seed_file: gateway.nk
      tls:
        ca_file: ca.pem
      streams:
        replicas: #{if length(hosts) >= 3, do: 3, else: 1}
        # Room for whatever each vehicle can fill, so that none takes another one's.
        events_per_vehicle: true
        event_max_mb: #{room.event_mb}
        state_max_mb: #{room.state_mb}
    shadow:
      key: #{JSON.encode!(keys.key)}
      #{if keys.former, do: "former_key: #{JSON.encode!(keys.former)}"}
      buckets:
        desired_max_mb: #{room.desired_mb}
        reported_max_mb: #{room.reported_mb}
    # It shows and commands the vehicles of the fleet, and signs by the key that they list in policy.sources.
    remote:
      enabled: true
      nkey_seed_file: gateway.nk
    """
  end

  @doc "`gateway.yaml` of the gateway aboard a vehicle. `hubs`: names and public nkeys of those who may command it."
  @spec vehicle(String.t(), String.t(), [String.t()], ports(), String.t(), [{String.t(), String.t()}]) ::
          String.t()
  def vehicle(environment, id, hosts, ports, key, hubs) do
    """
    # The gateway aboard #{id}: files beside this one.
    vehicle_id: #{id}
    environment: #{environment}
    nats:
      leaf:
        url: #{JSON.encode!(urls(hosts, ports["leaf"]))}
        nkey_seed_file: leaf.nk
        tls:
          ca_file: ca.pem
    shadow:
      vehicle_key: #{JSON.encode!(key)}
    policy:
      # What each hub may do aboard, by commands and by desired states: role admin also lets it set parameters.
      sources:
    #{Enum.map_join(hubs, "\n", fn {name, nkey} -> "    - {name: #{name}, nkey: #{nkey}, role: operator}" end)}
    """
  end
end
