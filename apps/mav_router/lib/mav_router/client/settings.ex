defmodule MavRouter.Client.Settings do
  @moduledoc """
  From the keys of the configuration (`clients`, see `config/gateway.example.yaml`) to a client's connection and the
  rules of its endpoints (`MavRouter.Endpoints.Owner.RuleKeys`). Everything is checked here: the file,
  `MavRouter.Client.add/3` and HTTP give the same errors.
  """
  use Aerie.Base.Settings

  import Aerie.Base.Settings.Rules

  alias Aerie.Base.Error
  alias MavRouter.Identity
  alias MavRouter.Link
  alias MavRouter.Link.{Spec, Transport}
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Endpoints.Owner.RuleKeys
  alias MavRouter.Endpoints.Queue.ClassQueue
  alias Aerie.Base.Settings.Types

  part :link, MavRouter.Link.Settings

  section ""

  setting :clients,
          {:list, {:section, client_fields()}},
          """
          Endpoints for ground stations and other programs: udpin, udpout, udpbcast:ADDRESS:PORT, tcpin, tcp, or a
          DEVICE. Default: TCP on 127.0.0.1, port 5790 or the next free one; [] for none. A ground station that calls a
          link (UDP 14550) becomes a client automatically, as long as no autopilot is heard from there.
          """,
          example:
            ~S([{id: field-laptop, url: "udpout:192.168.1.20:14550", rate_limits: {ATTITUDE: 4}, ) <>
              "filter_out: {block_messages: [RAW_IMU]}}]"

  section "limits"

  setting :max_clients, {:integer, 1, 10_000}, "Client endpoints.", default: 64

  defp client_fields do
    [
      field(:id, Types.token(), "Name of the client; its connection string if left out."),
      field(:url, Link.Settings.url(), "Connection string.", required: true),
      field(
        :networks,
        {:one_or_list, Types.token()},
        "Networks that it sees, all if left out. If two have the same system id, it sees that of the network " <>
          "named first.",
        default: [],
        filled: true
      ),
      field(
        :id_offsets,
        {:map, {:integer, 0, 238}},
        """
        Offsets that are added to the system ids of a network for this client, so that it sees vehicles with the same
        id on several networks. This changes frames; not possible for networks with signing keys.
        """,
        default: %{},
        example: "{north: 10, south: 20}"
      ),
      field(:label, :string, "Label for people."),
      field(:enabled, :boolean, "Open it.", default: true),
      field(:role, {:enum, [:full, :read_only]}, "read_only: nothing that it sends is forwarded.",
        default: struct(Owner).role
      ),
      field(:sniffer, :boolean, "It also gets frames that are addressed to others.", default: false),
      field(
        :served,
        :boolean,
        "The gateway gives it parameters and plans while they are known to be the vehicle's, instead of having the " <>
          "vehicle read once for each client.",
        default: struct(Owner).served
      ),
      field(
        :sign,
        :boolean,
        "Its unsigned frames are accepted, and signed for vehicles that require it (UNSAFE unless only you reach it).",
        default: false
      ),
      field(
        :coalesce,
        :boolean,
        "Frames share a datagram when many wait; false for a peer that reads only the first one (mavp2p).",
        default: struct(Owner).coalesce
      ),
      field(:queue_frames, {:integer, 1, 100_000}, "Frames that wait for a client that does not keep up.",
        default: ClassQueue.new().max_frames
      ),
      field(:queue_kb, {:integer, 1, 65_536}, "… and kilobytes.",
        default: div(ClassQueue.new().max_bytes, 1024)
      ),
      field(
        :transfer_kb,
        {:integer, 64, 1_048_576},
        "Kilobytes of requested data (logs, files, parameters, missions) that wait besides, for each of its peers.",
        default: div(ClassQueue.new().requested.max_bytes, 1024)
      )
    ] ++ RuleKeys.fields()
  end

  @doc "Without `clients` there is one, on the first free port."
  @impl Aerie.Base.Settings
  def derive(settings), do: %{settings | clients: settings.clients || :default}

  @name ~r/\A[A-Za-z0-9_.-]{1,64}\z/
  @most_networks 16

  @doc "Whether a map has only keys that a client can have."
  @spec known(map) :: :ok | {:error, Error.t()}
  def known(client) do
    known = [:url, :id, :label, :networks, :from] ++ RuleKeys.changeable()

    case Map.keys(client) -- known do
      [] ->
        :ok

      [key | _] ->
        Error.new({:invalid, "#{inspect(key)} is an unknown key; known are #{Enum.join(known, ", ")}"})
    end
  end

  @doc """
  The specification of a client's link, with the rules in its options. The error is words. Keys:

  - `:url` - the connection string, required
  - `:id` - default: the connection string without its options
  - `:networks` - names of networks that it sees, the preferred one first; default all, also those that are added later
  - `:network` - the gateway's own network
  - `:from` - `:remote` if somebody on another machine asks, who must not name devices and files of this one; `:local`
  - `:label` and the rules (`MavRouter.Endpoints.Owner.RuleKeys.owner_options/1`)
  """
  @spec client(map) :: {:ok, Spec.t()} | {:error, String.t()}
  def client(%{url: url} = map) do
    networks = List.wrap(map[:networks])

    with :ok <- id(map),
         :ok <- gcs_problem(Spec.said(url), map),
         :ok <- networks(networks),
         {:ok, options} <-
           RuleKeys.owner_options(map |> Map.put(:networks, networks) |> Map.put(:side, :client)),
         {:ok, spec} <-
           spec(
             url,
             map,
             List.first(networks) || map[:network] || Identity.default_network(),
             options
           ),
         {:ok, _owner} <- Owner.new(spec.id, options) do
      {:ok, spec}
    end
  end

  def client(_other), do: {:error, "a client needs a url"}

  defp networks(names) do
    if length(names) <= @most_networks and Enum.all?(names, &name?/1),
      do: :ok,
      else: {:error, "networks must be a list of 1 to #{@most_networks} names"}
  end

  defp id(%{from: :remote, id: id}) when id != nil do
    if name?(id), do: :ok, else: {:error, "id must be at most 64 letters, digits and - _ ."}
  end

  defp id(_client), do: :ok

  # Keys for links would have no effect here, and contradictory keys would hide which one counts.
  defp gcs_problem(%{gcs: _}, _map),
    do: {:error, "url: gcs is an option of links; what a client may do is said by role and policy.clients"}

  defp gcs_problem(%{network: _}, _map),
    do: {:error, "url: network is an option of links; the networks that a client sees are its key networks"}

  defp gcs_problem(%{id: said}, %{id: id}) when id != nil and id != said,
    do: {:error, "id: #{id} contradicts id=#{said} in the url"}

  defp gcs_problem(_said, _map), do: :ok

  defp spec(url, map, network, options) do
    case Spec.parse(url, id: map[:id], network: network, options: [label: map[:label], router: options]) do
      {:ok, spec} -> allowed(spec, map[:from])
      {:error, error} -> {:error, Exception.message(error)}
    end
  end

  defp allowed(%{client: client}, :remote) when client != :remote,
    do: {:error, "url must be one of #{Transport.usage(:remote)} for a client"}

  defp allowed(%{client: nil}, _from), do: {:error, "a recording is a link, not a client"}
  defp allowed(spec, _from), do: {:ok, spec}

  defp name?(name), do: is_binary(name) and name =~ @name

  @impl Aerie.Base.Settings
  def problems(%{links: links, limits: limits, signing: signing} = config) do
    clients = listed(config)
    signed = for %{network: network} <- signing.keys, uniq: true, do: network

    rules =
      for {client, index} <- Enum.with_index(clients),
          {:error, words} <- [client(client)],
          do: problem(["clients", index], "rules that make sense", words)

    # A signature covers the ids.
    offsets =
      for {client, index} <- Enum.with_index(clients),
          {network, offset} <- client.id_offsets,
          offset != 0 and network in signed,
          do: problem(["clients", index, "id_offsets"], "networks without signing keys", "\"#{network}\"")

    several =
      failed([
        {length(clients) > limits.max_clients, ["clients"],
         "at most limits.max_clients (#{limits.max_clients})", "#{length(clients)}"}
      ])

    ids =
      twice(
        Enum.uniq_by(links, & &1.id) ++ clients,
        & &1.id,
        ["clients"],
        "ids that differ, of links and of clients"
      )

    ids ++ rules ++ offsets ++ several
  end

  @impl Aerie.Base.Settings
  def warnings(config) do
    open = open_to_all(listed(config))

    texts([
      {open != [],
       "clients #{Enum.join(open, ", ")}: sign: true for a server that is not on loopback is UNSAFE: " <>
         "commands of everybody who reaches it are signed."}
    ])
  end

  @doc "The clients that a configuration lists; none if it leaves them out."
  @spec listed(map()) :: [map()]
  def listed(%{clients: clients}), do: if(is_list(clients), do: clients, else: [])

  # Servers that other machines can reach.
  defp open_to_all(clients) do
    for %{sign: true, url: url, id: id} <- clients,
        {:ok, %{server: true, host: host}} <- [Spec.parse(url)],
        not is_tuple(host) or not Aerie.Base.Net.Address.loopback?(host),
        do: id
  end
end
