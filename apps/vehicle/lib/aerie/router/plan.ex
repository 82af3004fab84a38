defmodule Aerie.Router.Plan do
  @moduledoc """
  All endpoints with their owners' rules, as one value that each forwarding process keeps for itself for as long as
  nothing changes: forwarding looks no endpoint up.
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
            broadcasts: boolean,
            high_latency: boolean
          }
  end

  @enforce_keys [:generation, :ways]
  defstruct [:generation, :ways, :own, between: :auto]

  @typedoc "`own`: our own ids; `between`: what vehicles hear of each other, as `router.between_vehicles` says"
  @type t :: %__MODULE__{
          generation: non_neg_integer,
          ways: %{Endpoint.key() => Way.t()},
          own: {non_neg_integer, 0..255} | nil,
          between: :all | :auto | :heartbeats | :none
        }

  @doc "Reads the tables. Who sees all networks sees those that there are now; a new one moves the generation."
  @spec read(Tables.t()) :: t
  def read(tables) do
    # First the number, so that what changes meanwhile is read again.
    generation = Tables.generation(tables)
    owners = Map.new(:ets.tab2list(tables.owners))
    networks = networks(tables, owners)

    ways =
      for endpoint <- Endpoints.list(tables), owner = owners[elem(endpoint.key, 0)], into: %{} do
        {endpoint.key, way(endpoint, owner, networks)}
      end

    %__MODULE__{
      generation: generation,
      ways: ways,
      own: Tables.setting(tables, :own, nil),
      between: Tables.setting(tables, :between_vehicles, :auto)
    }
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
      broadcasts: owner.broadcasts
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
