defmodule Aerie.Fleet.Bridge.Hub.Setup do
  @moduledoc """
  Writes what a hub and its vehicles need to find and trust each other: `aerie nats-setup`.

      DIR/fleet.json             who is in the fleet (public keys only)
      DIR/ca.key                 the authority's key; keep it where no server is
      DIR/shadow.key             from which the keys are derived that seal desired states; it is in the gateway.yaml of the hubs
      DIR/hub/                   for the hub's gateway: gateway.yaml, gateway.nk, ca.pem
      DIR/hub/HOST/              for each of its servers: hub.conf, accounts.conf, server.conf, server.pem, server.key, ca.pem
      DIR/hubs/NAME/             for the gateway of another hub: as for the first one
      DIR/vehicles/ID/           for a vehicle: leaf.nk, ca.pem, gateway.yaml

  Run again, it keeps the keys that there are, adds vehicles and hubs and takes others out. A folder may be moved to where it is used:
  only the public key is needed here.
  """

  alias Aerie.Fleet.Bridge.Hub.{Accounts, Certificates, Members, Quota, Report, Texts, VehicleKey}
  alias Aerie.Base.Files.Private

  @template Path.expand("../../../../../../../rel/overlays/nats/hub.conf", __DIR__)
  @external_resource @template
  @hub_conf File.read!(@template)

  @client_port 4222
  @leaf_port 7422
  @route_port 6222

  @typedoc """
  `hosts`: the servers of the hub, needed the first time, and then all of them if they change; `hubs`: gateways on the same servers that show and
  command the same vehicles; `revoked`: vehicles and hubs that are taken out; `new_keys`: those that get another key (`hub` is the first
  hub's gateway), and the one that they have opens nothing any more; `ports` for tests.
  """
  @type wish :: %{
          optional(:environment) => String.t() | nil,
          optional(:hosts) => [String.t()],
          optional(:vehicles) => [String.t()],
          optional(:hubs) => [String.t()],
          optional(:revoked) => [String.t()],
          optional(:new_keys) => [String.t()],
          optional(:ports) => %{
            client: :inet.port_number(),
            leaf: :inet.port_number(),
            route: :inet.port_number()
          }
        }

  @doc "Writes the set into `dir`; what was done, as lines for a person."
  @spec write(Path.t(), wish()) :: {:ok, [String.t()]} | {:error, String.t()}
  def write(dir, wish) do
    wish = Map.merge(%{environment: nil, hosts: [], vehicles: [], hubs: [], revoked: [], new_keys: []}, wish)

    with {:ok, known} <- read(dir),
         {:ok, fleet} <- Members.plan(known, wish),
         fleet = Map.put(fleet, "ports", ports(known, wish)),
         :ok <- folders(dir, fleet),
         :ok <- Certificates.authority(dir),
         {:ok, servers} <- servers(dir, fleet),
         :ok <- all(dead(known, wish), &removed(seed_file(dir, &1))),
         {:ok, fleet, made} <- keys(dir, fleet),
         changes = Members.changes(known, fleet, made, wish),
         {:ok, keys, fleet, told} <- shadow_keys(dir, fleet, Map.keys(fleet["vehicles"]) -- made),
         :ok <- all(files(dir, fleet, servers, changes, keys), &written/1),
         :ok <- all(~w(hub.conf accounts.conf), &removed(Path.join([dir, "hub", &1]))),
         :ok <- save(dir, fleet),
         do: {:ok, Report.lines(dir, fleet, changes) ++ told}
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

  defp ports(known, wish) do
    case {wish[:ports], known} do
      {%{} = ports, _known} -> Map.new(ports, fn {name, port} -> {Atom.to_string(name), port} end)
      {nil, %{"ports" => ports}} -> ports
      {nil, nil} -> %{"client" => @client_port, "leaf" => @leaf_port, "route" => @route_port}
    end
  end

  defp folders(dir, fleet) do
    ["", "hub", "vehicles" | Enum.map(fleet["hosts"], &Path.join("hub", &1))]
    |> Enum.map(&Path.join(dir, &1))
    |> all(&with_path(Private.folder(&1), &1))
  end

  # A key that was taken out stays out: what is added again by its name gets another one.
  defp dead(nil, _wish), do: []
  defp dead(known, wish), do: for(name <- wish.revoked ++ wish.new_keys, do: Members.place(known, name))

  defp seed_file(dir, :hub), do: Path.join([dir, "hub", "gateway.nk"])
  defp seed_file(dir, {:hub, name}), do: Path.join([dir, "hubs", name, "gateway.nk"])
  defp seed_file(dir, {:vehicle, id}), do: Path.join([dir, "vehicles", id, "leaf.nk"])

  # Keys of those who have none yet; `made` are the names of these.
  defp keys(dir, fleet) do
    Enum.reduce_while(Members.without_key(fleet), {:ok, fleet, []}, fn {name, place}, {:ok, fleet, made} ->
      case seed(seed_file(dir, place)) do
        {:ok, public} -> {:cont, {:ok, Members.put(fleet, place, public), [name | made]}}
        error -> {:halt, error}
      end
    end)
  end

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

  # One that is there is kept, as after fleet.json was lost.
  defp seed(file) do
    with :ok <- with_path(Private.folder(Path.dirname(file)), file), {:ok, text} <- kept(file) do
      case text && Nkey.from_seed(text) do
        nil ->
          new_seed(file)

        {:ok, %{purpose: :user, public: public}} ->
          {:ok, public}

        _damaged ->
          {:error, "#{file} is not the seed of a user's nkey: restore it, or remove it to make another key"}
      end
    end
  end

  defp new_seed(file) do
    key = Nkey.generate(:user)
    with :ok <- with_path(Private.write(file, Nkey.seed(key) <> "\n"), file), do: {:ok, key.public}
  end

  defp removed(file) do
    case File.rm(file) do
      {:error, reason} when reason in [:enoent, :enotdir] -> :ok
      result -> with_path(result, file)
    end
  end

  # Certificates of servers that have none yet.
  defp servers(dir, fleet) do
    folders = for host <- fleet["hosts"], do: {host, Path.join([dir, "hub", host])}

    without =
      for {host, folder} <- folders, not File.exists?(Path.join(folder, "server.pem")), do: {host, folder}

    with :ok <- all(without, fn {host, folder} -> Certificates.server(dir, folder, [host]) end),
         do: {:ok, folders}
  end

  defp files(dir, fleet, servers, changes, keys) do
    %{"environment" => environment, "hosts" => hosts, "ports" => ports} = fleet
    {:ok, authority} = File.read(Path.join(dir, "ca.pem"))
    hubs = Members.hubs(fleet)
    accounts = Accounts.render(environment, Enum.map(hubs, &elem(&1, 1)), Enum.sort(fleet["vehicles"]))
    gateway = Texts.hub(environment, hosts, ports, Quota.of(map_size(fleet["vehicles"])), keys)

    own = fn id -> VehicleKey.derive(keys.key, environment, id) end

    folders =
      for(
        {host, folder} <- servers,
        do:
          {folder,
           [
             {"hub.conf", @hub_conf},
             {"accounts.conf", accounts},
             {"server.conf", Texts.server(host, hosts, environment, ports)}
           ]}
      ) ++
        for({name, _public} <- hubs, do: {hub_folder(dir, name), [{"gateway.yaml", gateway}]}) ++
        for(
          id <- changes.vehicles,
          do:
            {Path.join([dir, "vehicles", id]),
             [{"gateway.yaml", Texts.vehicle(environment, id, hosts, ports, own.(id), hubs)}]}
        )

    for {folder, files} <- folders, {name, text} <- [{"ca.pem", authority} | files], do: {folder, name, text}
  end

  defp hub_folder(dir, name), do: dir |> seed_file(Members.hub_place(name)) |> Path.dirname()

  defp written({folder, name, text}) do
    file = Path.join(folder, name)

    with :ok <- with_path(Private.folder(folder), folder),
         true <- File.read(file) != {:ok, text},
         do: with_path(Private.write(file, text), file),
         else: (
           false -> :ok
           error -> error
         )
  end

  defp save(dir, fleet), do: written({dir, "fleet.json", JSON.encode!(fleet)})

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
