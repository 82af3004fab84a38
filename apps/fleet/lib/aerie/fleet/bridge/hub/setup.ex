defmodule Aerie.Fleet.Bridge.Hub.Setup do
  @moduledoc """
  Writes what a hub and its vehicles need to find and trust each other: `bin/nats-setup`.

      DIR/fleet.json             who is in the fleet (public keys only)
      DIR/ca.key                 the authority's key; keep it where no server is
      DIR/shadow.key             from which the keys are derived that seal desired states; it is in the hub's gateway.yaml
      DIR/hub/                   for the hub: hub.conf, accounts.conf, ca.pem, gateway.nk, gateway.yaml
      DIR/hub/HOST/              for each of its servers: server.conf, server.pem, server.key
      DIR/vehicles/ID/           for a vehicle: leaf.nk, ca.pem, gateway.yaml

  Run again, it keeps the keys that there are, adds vehicles and takes others out. A vehicle's folder may be moved to the vehicle:
  only its public key is needed here.
  """

  alias Aerie.Fleet.Bridge.Hub.{Accounts, Certificates, Quota, VehicleKey}
  alias Aerie.Base.Files.Private
  alias Aerie.Base.Settings.Types

  @template Path.expand("../../../../../../../rel/overlays/nats/hub.conf", __DIR__)
  @external_resource @template
  @hub_conf File.read!(@template)

  @client_port 4222
  @leaf_port 7422
  @route_port 6222

  @typedoc """
  `hosts`: the hub's servers, needed the first time; `new_gateway_key`: the hub's gateways get another key, and the one that they have
  opens nothing any more; `ports` for tests.
  """
  @type wish :: %{
          optional(:environment) => String.t() | nil,
          optional(:hosts) => [String.t()],
          optional(:vehicles) => [String.t()],
          optional(:revoked) => [String.t()],
          optional(:new_gateway_key) => boolean(),
          optional(:ports) => %{
            client: :inet.port_number(),
            leaf: :inet.port_number(),
            route: :inet.port_number()
          }
        }

  @doc "Writes the set into `dir`; what was done, as lines for a person."
  @spec write(Path.t(), wish()) :: {:ok, [String.t()]} | {:error, String.t()}
  def write(dir, wish) do
    with {:ok, known} <- read(dir),
         {:ok, fleet} <- plan(known, wish),
         :ok <- folders(dir, fleet),
         {:ok, fleet, gateway} <- gateway(dir, fleet, wish),
         {:ok, fleet, made} <- vehicles(dir, fleet, wish),
         {:ok, keys, fleet, told} <- shadow_keys(dir, fleet, Map.keys(fleet["vehicles"]) -- made),
         :ok <- Certificates.authority(dir),
         {:ok, servers} <- servers(dir, fleet),
         :ok <- files(dir, fleet, servers, made, keys),
         :ok <- save(dir, fleet) do
      {:ok, gateway ++ lines(dir, made, Map.get(wish, :revoked, [])) ++ told}
    end
  end

  defp read(dir) do
    file = Path.join(dir, "fleet.json")

    case File.read(file) do
      {:ok, text} ->
        case JSON.decode(text) do
          {:ok, %{"environment" => _, "hosts" => [_ | _], "vehicles" => %{}} = fleet} -> {:ok, fleet}
          _other -> {:error, "#{file} is damaged: restore it, or begin in another folder"}
        end

      {:error, :enoent} ->
        {:ok, nil}

      {:error, reason} ->
        {:error, "cannot read #{file}: #{:file.format_error(reason)}"}
    end
  end

  defp plan(known, wish) do
    hosts = Map.get(wish, :hosts, [])
    revoked = Map.get(wish, :revoked, [])
    fleet = known || %{"environment" => wish[:environment] || "prod", "hosts" => hosts, "vehicles" => %{}}
    names = [fleet["environment"] | Map.get(wish, :vehicles, [])]

    cond do
      known == nil and hosts == [] ->
        {:error, "the hub's name is missing: --host hub.example.org (once for each of its servers)"}

      known != nil and wish[:environment] not in [nil, known["environment"]] ->
        {:error,
         "the fleet's environment is #{known["environment"]}: take another folder for #{wish[:environment]}"}

      bad = Enum.find(names, &(Types.parse_token(&1) == :error)) ->
        {:error, "#{inspect(bad)}: a name has at most 64 letters, digits, - and _"}

      bad = Enum.find(hosts, &(not host?(&1))) ->
        {:error, "#{inspect(bad)}: --host is a name such as hub.example.org or an IP address"}

      unknown = Enum.find(revoked, &(not is_map_key(fleet["vehicles"], &1))) ->
        {:error,
         "--revoke #{unknown}: there is no such vehicle (#{Enum.join(Map.keys(fleet["vehicles"]), ", ")})"}

      true ->
        fleet = if hosts == [], do: fleet, else: %{fleet | "hosts" => Enum.uniq(hosts)}

        {:ok,
         %{fleet | "vehicles" => Map.drop(fleet["vehicles"], revoked)} |> Map.put("ports", ports(known, wish))}
    end
  end

  defp ports(known, wish) do
    case {wish[:ports], known} do
      {%{} = ports, _known} -> Map.new(ports, fn {name, port} -> {Atom.to_string(name), port} end)
      {nil, %{"ports" => ports}} -> ports
      {nil, nil} -> %{"client" => @client_port, "leaf" => @leaf_port, "route" => @route_port}
    end
  end

  defp host?(text) do
    match?({:ok, _ip}, :inet.parse_strict_address(String.to_charlist(text))) or
      match?({:ok, _host}, Types.parse_host(text))
  end

  defp folders(dir, fleet) do
    ["", "hub", "vehicles" | Enum.map(fleet["hosts"], &Path.join("hub", &1))]
    |> Enum.map(&Path.join(dir, &1))
    |> all(&with_path(Private.folder(&1), &1))
  end

  defp gateway(dir, fleet, wish) do
    if fleet["gateway"] == nil or wish[:new_gateway_key] == true do
      file = Path.join(dir, "hub/gateway.nk")

      with {:ok, public} <- seed(file),
           do:
             {:ok, Map.put(fleet, "gateway", public),
              ["the key of the hub's gateways is new: #{file}" | known(fleet, public)]}
    else
      {:ok, fleet, []}
    end
  end

  # Vehicles that have their files already.
  defp known(%{"vehicles" => vehicles}, _public) when vehicles == %{}, do: []

  defp known(_fleet, public),
    do: [
      "each vehicle lists it: the nkey of hub in policy.sources of its gateway.yaml is #{public} from now on"
    ]

  # Sets of before each vehicle had a key of its own have one for all. The hub reads by it what was sealed till then.
  defp shadow_keys(dir, %{"sealing" => "vehicle"} = fleet, _without) do
    with {:ok, key} <- key(Path.join(dir, "shadow.key")),
         {:ok, former} <- kept(Path.join(dir, "shadow-former.key")),
         do: {:ok, %{key: key, former: former}, fleet, []}
  end

  defp shadow_keys(dir, fleet, without) do
    former = Path.join(dir, "shadow-former.key")

    with :ok <- moved(Path.join(dir, "shadow.key"), former),
         {:ok, keys, fleet, []} <- shadow_keys(dir, Map.put(fleet, "sealing", "vehicle"), []),
         :ok <- all(without, &own_key(dir, fleet["environment"], &1, keys.key)) do
      told =
        for id <- without,
            do:
              "#{id}: shadow.vehicle_key in its gateway.yaml is what #{Path.join([dir, "vehicles", id, "shadow.key"])} has, in the " <>
                "place of shadow.key, which opened the desired states of all vehicles"

      {:ok, keys, fleet, told}
    end
  end

  defp moved(file, former) do
    case File.rename(file, former) do
      {:error, :enoent} -> :ok
      result -> with_path(result, former)
    end
  end

  defp own_key(dir, environment, id, common) do
    file = Path.join([dir, "vehicles", id, "shadow.key"])

    with :ok <- with_path(Private.folder(Path.dirname(file)), file),
         do: with_path(Private.write(file, VehicleKey.derive(common, environment, id) <> "\n"), file)
  end

  defp key(file) do
    with {:ok, nil} <- kept(file),
         key = Base.encode16(:crypto.strong_rand_bytes(32), case: :lower),
         :ok <- with_path(Private.write(file, key <> "\n"), file),
         do: {:ok, key}
  end

  defp kept(file) do
    case File.read(file) do
      {:ok, text} -> {:ok, String.trim(text)}
      {:error, :enoent} -> {:ok, nil}
      {:error, reason} -> {:error, "cannot read #{file}: #{:file.format_error(reason)}"}
    end
  end

  defp seed(file) do
    key = Nkey.generate(:user)
    with :ok <- with_path(Private.write(file, Nkey.seed(key) <> "\n"), file), do: {:ok, key.public}
  end

  defp vehicles(dir, fleet, wish) do
    new = Enum.uniq(Map.get(wish, :vehicles, [])) -- Map.keys(fleet["vehicles"])

    Enum.reduce_while(new, {:ok, fleet, new}, fn id, {:ok, fleet, new} ->
      folder = Path.join([dir, "vehicles", id])

      with :ok <- with_path(Private.folder(folder), folder),
           {:ok, public} <- seed(Path.join(folder, "leaf.nk")) do
        {:cont, {:ok, put_in(fleet["vehicles"][id], public), new}}
      else
        error -> {:halt, error}
      end
    end)
  end

  # Certificates of servers that have none yet.
  defp servers(dir, fleet) do
    folders = for host <- fleet["hosts"], do: {host, Path.join([dir, "hub", host])}

    without =
      for {host, folder} <- folders, not File.exists?(Path.join(folder, "server.pem")), do: {host, folder}

    with :ok <- all(without, fn {host, folder} -> Certificates.server(dir, folder, [host]) end),
         do: {:ok, folders}
  end

  defp files(dir, fleet, servers, made, keys) do
    %{"environment" => environment, "hosts" => hosts, "ports" => ports} = fleet
    {:ok, authority} = File.read(Path.join(dir, "ca.pem"))
    accounts = Accounts.render(environment, fleet["gateway"], Enum.sort(fleet["vehicles"]))

    hub = [{"hub/hub.conf", @hub_conf}, {"hub/accounts.conf", accounts}, {"hub/ca.pem", authority}]
    urls = fn port -> for host <- hosts, do: "tls://#{address(host)}:#{port}" end

    gateway =
      {"hub/gateway.yaml",
       hub_yaml(
         environment,
         urls.(ports["client"]),
         length(hosts),
         Quota.of(map_size(fleet["vehicles"])),
         keys
       )}

    own =
      for {host, _folder} <- servers,
          do: {"hub/#{host}/server.conf", server_conf(host, hosts, environment, ports)}

    vehicle =
      for id <- made,
          {name, text} <- [
            {"ca.pem", authority},
            {"gateway.yaml",
             vehicle_yaml(
               environment,
               id,
               urls.(ports["leaf"]),
               VehicleKey.derive(keys.key, environment, id),
               fleet["gateway"]
             )}
          ],
          do: {"vehicles/#{id}/#{name}", text}

    all([gateway | hub] ++ own ++ vehicle, fn {name, text} ->
      with_path(Private.write(Path.join(dir, name), text), name)
    end)
  end

  defp server_conf(host, hosts, environment, ports) do
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

  defp address(host), do: if(String.contains?(host, ":"), do: "[#{host}]", else: host)

  defp hub_yaml(environment, urls, servers, room, keys) do
    """
    # The gateway of the hub: files beside this one.
    environment: #{environment}
    nats:
      url: #{JSON.encode!(urls)}
      nkey_seed_file: gateway.nk
      tls:
        ca_file: ca.pem
      streams:
        replicas: #{if servers >= 3, do: 3, else: 1}
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

  defp vehicle_yaml(environment, id, urls, key, gateway) do
    """
    # The gateway aboard #{id}: files beside this one.
    vehicle_id: #{id}
    environment: #{environment}
    nats:
      leaf:
        url: #{JSON.encode!(urls)}
        nkey_seed_file: leaf.nk
        tls:
          ca_file: ca.pem
    shadow:
      vehicle_key: #{JSON.encode!(key)}
    policy:
      # What the hub may do aboard, by commands and by desired states: role admin lets it set parameters, too.
      sources:
        - {name: hub, nkey: #{gateway}, role: operator}
    """
  end

  defp save(dir, fleet) do
    file = Path.join(dir, "fleet.json")
    with_path(Private.write(file, JSON.encode!(fleet)), file)
  end

  defp lines(dir, made, revoked) do
    for(id <- made, do: "#{id}: copy #{Path.join([dir, "vehicles", id])} to the vehicle") ++
      for(id <- revoked, do: "#{id}: its key opens nothing any more, once the hub has been restarted") ++
      [
        "hub: copy #{Path.join(dir, "hub")}/*.* and the folder of each server's name into one folder there",
        "after a change of accounts.conf: restart nats-server, one server after the other; for a new account a reload is not enough"
      ]
  end

  defp all(list, fun) do
    Enum.reduce_while(list, :ok, fn item, :ok ->
      case fun.(item) do
        :ok -> {:cont, :ok}
        error -> {:halt, error}
      end
    end)
  end

  defp with_path(:ok, _file), do: :ok
  defp with_path({:error, reason}, file), do: {:error, "cannot write #{file}: #{:file.format_error(reason)}"}
end
