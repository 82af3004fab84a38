defmodule Aerie.Router.Plan do
  @moduledoc """
  All endpoints with their owners' rules, as one value that each forwarding process keeps for itself: forwarding looks no
  endpoint up. When endpoints change only those are read again (`refresh/2`), so that what one costs does not grow with
  the number of the others.
  """

  alias Aerie.Router.Endpoint
  alias Aerie.Router.Endpoints
  alias Aerie.Router.Filter
  alias Aerie.Router.Gate
  alias Aerie.Router.Owner
  alias Aerie.Router.RateLimit
  alias Aerie.Router.Renumber
  alias Aerie.Router.Tables
  alias Aerie.Router.Tally

  defmodule Way do
    @moduledoc """
    One endpoint with the rules of its owner. `plain`: every frame passes. `recorded`: the gateway, for a way to vehicles
    that is written to past its link's process. `pid`: the process of the link or client. `sign`: `Aerie.Router.Owner`.
    `commands`: what comes from it may command vehicles (`Aerie.Router.Gate`); `guarded`: what is just being forwarded may not.
    """

    @enforce_keys [:key, :owner, :side, :networks]
    defstruct [
                :key,
                :owner,
                :side,
                :networks,
                :out,
                :tally,
                :waiting,
                :group,
                :in,
                :filter,
                :limits,
                :renumber,
                :heard_vehicle,
                :recorded,
                :pid,
                :gateway,
                :text
              ] ++
                [
                  plain: true,
                  commands: false,
                  guarded: false,
                  auto: false,
                  carry: %{},
                  role: :full,
                  sniffer: false,
                  sign: false,
                  coalesce: true,
                  listens: true,
                  broadcasts: true,
                  high_latency: false
                ]

    @type t :: %__MODULE__{
            key: Endpoint.key(),
            owner: String.t(),
            side: :vehicle | :client,
            networks: [String.t()],
            out: Endpoint.out(),
            tally: Tally.t(),
            waiting: :atomics.atomics_ref() | nil,
            group: String.t() | nil,
            in: Filter.t(),
            filter: Filter.t(),
            limits: RateLimit.t(),
            renumber: Renumber.t(),
            heard_vehicle: boolean | nil,
            recorded: Aerie.Names.gateway() | nil,
            gateway: Aerie.Names.gateway() | nil,
            text: String.t() | nil,
            plain: boolean,
            commands: boolean,
            guarded: boolean,
            auto: boolean,
            carry: map,
            role: :full | :read_only,
            sniffer: boolean,
            sign: boolean,
            pid: pid | nil,
            coalesce: boolean,
            listens: boolean,
            broadcasts: boolean,
            high_latency: boolean
          }
  end

  @enforce_keys [:generation, :own, :between, :networks]
  defstruct [:generation, :own, :between, :networks, audience: 0, ways: %{}, listeners: %{}, vehicles: %{}]

  # So many vehicles' ways of a network hear each other's heartbeats, see `Aerie.Router.Talker`.
  @choir 32

  @typedoc """
  - `own`: our own ids; `between`: what vehicles hear of each other, as `router.between_vehicles` says; `networks`: all
  - `listeners`: the ways that are no vehicle's: clients, sniffers, vehicles' other parts; `vehicles`: the others, by network
  - `audience`: moves when vehicles' frames may go to others than before; that one more vehicle of many came does not count
  """
  @type t :: %__MODULE__{
          generation: non_neg_integer,
          own: {non_neg_integer, 0..255} | nil,
          between: :all | :auto | :heartbeats | :none,
          networks: [String.t()],
          audience: non_neg_integer,
          ways: %{Endpoint.key() => Way.t()},
          listeners: %{Endpoint.key() => Way.t()},
          vehicles: %{String.t() => %{Endpoint.key() => Way.t()}}
        }

  @doc "How many vehicles' ways of one network hear each other's heartbeats at most."
  @spec choir() :: pos_integer
  def choir, do: @choir

  @doc "Reads the tables. Who sees all networks sees those that there are now; a new one moves the generation."
  @spec read(Tables.t()) :: t
  def read(tables) do
    # First the number, so that what changes meanwhile is read again.
    generation = Tables.generation(tables)
    owners = Map.new(:ets.tab2list(tables.owners))

    plan = %__MODULE__{
      generation: generation,
      own: Tables.setting(tables, :own, nil),
      between: Tables.setting(tables, :between_vehicles, :auto),
      networks: networks(tables, owners)
    }

    for endpoint <- Endpoints.list(tables), owner = owners[elem(endpoint.key, 0)], reduce: plan do
      plan -> add(plan, way(endpoint, owner, plan.networks))
    end
  end

  @doc "The plan as of now: as it is, with the endpoints that changed, or read anew."
  @spec refresh(t, Tables.t()) :: t
  def refresh(%__MODULE__{generation: before} = plan, tables) do
    case Tables.generation(tables) do
      ^before -> plan
      now -> refresh(plan, tables, Tables.changes(tables, before, now), now)
    end
  end

  defp refresh(plan, tables, :all, _now), do: %{read(tables) | audience: plan.audience + 1}

  defp refresh(plan, tables, keys, now) do
    keys |> Enum.reduce(plan, &endpoint(&2, tables, &1)) |> Map.put(:generation, now)
  end

  defp endpoint(plan, tables, {owner, _peer} = key) do
    before = plan.ways[key]

    with %Endpoint{} = endpoint <- Endpoints.get(tables, key),
         %Owner{} = owner <- Endpoints.owner(tables, owner) do
      way = way(endpoint, owner, plan.networks)
      plan |> remove(before) |> add(way) |> heard(before, way)
    else
      nil -> plan |> remove(before) |> heard(before, nil)
    end
  end

  defp add(plan, %Way{key: key} = way) do
    plan = put_in(plan.ways[key], way)

    cond do
      vehicle?(way) -> %{plan | vehicles: Enum.reduce(way.networks, plan.vehicles, &put_vehicle(&2, &1, way))}
      way.broadcasts or way.sniffer -> put_in(plan.listeners[key], way)
      true -> plan
    end
  end

  defp put_vehicle(vehicles, network, way),
    do: Map.update(vehicles, network, %{way.key => way}, &Map.put(&1, way.key, way))

  defp remove(plan, nil), do: plan

  defp remove(plan, %Way{key: key} = way) do
    vehicles =
      if vehicle?(way),
        do: Enum.reduce(way.networks, plan.vehicles, &delete(&2, &1, key)),
        else: plan.vehicles

    %{plan | ways: Map.delete(plan.ways, key), listeners: Map.delete(plan.listeners, key), vehicles: vehicles}
  end

  defp delete(vehicles, network, key) do
    case Map.delete(vehicles[network], key) do
      none when none == %{} -> Map.delete(vehicles, network)
      others -> %{vehicles | network => others}
    end
  end

  @doc "Whether a way is a vehicle's, of which others of its kind hear little."
  @spec vehicle?(Way.t()) :: boolean
  def vehicle?(way), do: way.side == :vehicle and way.heard_vehicle == true and not way.sniffer

  # One vehicle of so many that they do not hear each other anyway.
  defp heard(%{between: between} = plan, before, way) do
    same? =
      between in [:auto, :none] and Enum.all?([before, way], &(&1 == nil or deaf?(&1) or crowd?(plan, &1)))

    if same?, do: plan, else: %{plan | audience: plan.audience + 1}
  end

  defp deaf?(way), do: not way.broadcasts and not way.sniffer

  defp crowd?(plan, way) do
    vehicle?(way) and Enum.all?(way.networks, &(map_size(Map.get(plan.vehicles, &1, %{})) > @choir))
  end

  # The gateway's own first, then in the order in which links to them came: one that comes later hides nothing of an
  # earlier one.
  defp networks(tables, owners) do
    own = Tables.setting(tables, :network, "main")

    theirs =
      for {_id, %Owner{side: :vehicle, networks: names}} <- owners,
          is_list(names),
          name <- names,
          name != own,
          uniq: true,
          do: name

    [own | Enum.sort_by(theirs, &{Tables.setting(tables, {:network, &1}, :last), &1})]
  end

  @doc "An endpoint with its owner's rules; `networks` are all that there are."
  @spec way(Endpoint.t(), Owner.t(), [String.t()]) :: Way.t()
  def way(%Endpoint{} = endpoint, %Owner{} = owner, networks) do
    high_latency = high_latency?(endpoint, owner)

    %Way{
      key: endpoint.key,
      owner: owner.id,
      side: endpoint.side || owner.side,
      networks: if(owner.networks == :all, do: networks, else: owner.networks),
      out: endpoint.out,
      tally: endpoint.tally,
      waiting: endpoint.waiting,
      group: owner.group,
      in: owner.in,
      filter: owner.out,
      limits: owner.limits,
      renumber: owner.renumber,
      heard_vehicle: endpoint.heard_vehicle,
      recorded: if(owner.side == :vehicle and match?({:udp, _, _}, endpoint.out), do: endpoint.gateway),
      auto: endpoint.side != nil and owner.side == :vehicle,
      plain: owner.out == nil and owner.limits == nil and owner.renumber == nil and not high_latency,
      high_latency: high_latency,
      carry: owner.carry,
      role: owner.role,
      sniffer: owner.sniffer,
      sign: owner.sign,
      pid: endpoint.pid,
      gateway: endpoint.gateway,
      text: endpoint.text,
      commands: Gate.open?(endpoint, owner),
      coalesce: owner.coalesce,
      listens: endpoint.listens,
      broadcasts: owner.broadcasts and (endpoint.listens or endpoint.heard_vehicle == true)
    }
  end

  # Who lists the messages that may go there has thought of it.
  defp high_latency?(endpoint, owner) do
    (endpoint.high_latency or owner.high_latency) and
      Map.get(owner.options[:out] || %{}, :allow_messages, []) in [nil, []]
  end

  @doc "The way of a source that has no endpoint: who delivers frames without being one."
  @spec stranger(String.t(), term, String.t()) :: Way.t()
  def stranger(owner, peer, network) do
    %Way{
      key: {owner, peer},
      owner: owner,
      side: :vehicle,
      networks: [network],
      tally: Tally.new(),
      heard_vehicle: false
    }
  end
end
