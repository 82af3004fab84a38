defmodule MavRouter.Forward.Table.Path do
  @moduledoc """
  One endpoint with the rules of its owner: all that forwarding needs to know of where frames come from or go to.

  | field | |
  |---|---|
  | `plain` | it has no rules of what goes out: every frame passes |
  | `commands` | its senders count as clients, whose principals decide (`MavRouter.Forward.Gate`) |
  | `local` | only this machine can send by it |
  | `parts` | cameras, gimbals and companions of its vehicles are on it (`MavRouter.Forward.Reach`) |
  | `principal` | who it is, as it proved by a key or by signing in; nil: the policy knows its owner |
  | `auto` | it was found out that it is not of its owner's side: a ground station on a link to vehicles |
  | `recorded` | the gateway, for a path to vehicles whose frames go past its link's process, which would record them |
  | `pid` | the process of the link or client |

  The others are as in `MavRouter.Endpoints.Endpoint` and `MavRouter.Endpoints.Owner`, of which `filter` is `out`.
  """

  alias Aerie.Base.Principal
  alias MavRouter.Endpoints.Access
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Endpoints.Owner.Filter
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Endpoints.Owner.RateLimit
  alias MavRouter.Endpoints.Owner.Renumber

  @enforce_keys [:key, :owner, :side, :networks]
  defstruct [:key, :owner, :side, :networks, :out, :counters, :waiting, :group, :in, :filter, :limits] ++
              [:renumber, :heard_vehicle, :recorded, :pid, :gateway, :text, :principal] ++
              [
                plain: true,
                commands: false,
                local: false,
                parts: false,
                auto: false,
                carry: %{},
                role: :full,
                sniffer: false,
                served: false,
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
          counters: Counters.t(),
          waiting: :atomics.atomics_ref() | nil,
          group: String.t() | nil,
          in: Filter.t(),
          filter: Filter.t(),
          limits: RateLimit.t(),
          renumber: Renumber.t(),
          heard_vehicle: boolean | nil,
          recorded: Aerie.Base.Names.gateway() | nil,
          gateway: Aerie.Base.Names.gateway() | nil,
          text: String.t() | nil,
          plain: boolean,
          principal: Principal.t() | nil,
          commands: boolean,
          local: boolean,
          parts: boolean,
          auto: boolean,
          carry: map,
          role: :full | :read_only,
          sniffer: boolean,
          served: boolean,
          sign: boolean,
          pid: pid | nil,
          coalesce: boolean,
          listens: boolean,
          broadcasts: boolean,
          high_latency: boolean
        }

  @doc "An endpoint with its owner's rules; `networks` are all that there are."
  @spec new(Endpoint.t(), Owner.t(), [String.t()]) :: t
  def new(%Endpoint{} = endpoint, %Owner{} = owner, networks) do
    high_latency = high_latency?(endpoint, owner)

    %__MODULE__{
      key: endpoint.key,
      owner: owner.id,
      side: endpoint.side || owner.side,
      networks: if(owner.networks == :all, do: networks, else: owner.networks),
      out: endpoint.out,
      counters: endpoint.counters,
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
      served: owner.served,
      sign: owner.sign,
      pid: endpoint.pid,
      gateway: endpoint.gateway,
      text: endpoint.text,
      principal: endpoint.principal,
      commands: Access.commands?(endpoint, owner),
      local: Access.local?(endpoint),
      parts: owner.parts,
      coalesce: owner.coalesce,
      listens: endpoint.listens,
      broadcasts: owner.broadcasts and (endpoint.listens or endpoint.heard_vehicle == true)
    }
  end

  # A list of the messages that may go there was made with the link in mind.
  defp high_latency?(endpoint, owner) do
    (endpoint.high_latency or owner.high_latency) and
      Map.get(owner.options[:out] || %{}, :allow_messages, []) in [nil, []]
  end

  @doc "The path of frames that are delivered by a peer which is not an endpoint."
  @spec unregistered(owner :: String.t(), peer :: term, network :: String.t()) :: t
  def unregistered(owner, peer, network) do
    %__MODULE__{
      key: {owner, peer},
      owner: owner,
      side: :vehicle,
      networks: [network],
      counters: Counters.new(),
      heard_vehicle: false
    }
  end

  @doc "Whether it is a vehicle's, which hears little of other vehicles."
  @spec vehicle?(t) :: boolean
  def vehicle?(path), do: path.side == :vehicle and path.heard_vehicle == true and not path.sniffer
end
