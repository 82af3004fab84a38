defmodule Aerie.CLI.Status.View do
  @moduledoc """
  One snapshot of a gateway for display: vehicles, links, NATS, HTTP. It is collected from the read model, and rendered
  by `Aerie.CLI.Status.Table` (a terminal, `aerie status`, `Aerie.Shell`) or `Aerie.CLI.Status.Lines` (a pipe). No vehicle's process is
  called for it.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet
  alias Aerie.Vehicle.Events.Journal

  defstruct [
    :now,
    :started,
    :nats,
    :nats_login,
    :identity,
    :http,
    :console,
    published: 0,
    pending: 0,
    vehicles: [],
    links: [],
    clients: [],
    interfaces: [],
    warnings: [],
    notes: []
  ]

  @typedoc """
  * `now`, `started` - unix microseconds
  * `vehicles` - snapshots of `Aerie.Fleet`; `links` - of `Aerie.Base.Store`; `clients` - `MavRouter.Client.endpoints/1`
  * `nats` - `Aerie.Fleet.Bridge.info/1`; `nats_login` - the address with its login, for a terminal but never for a log
  * `identity` - `MavRouter.Router.identity/1`
  * `published` - messages handed to NATS so far; `pending` - events in memory that NATS has not confirmed
  * `http` - address of the HTTP server, or nil
  * `console` - the address that signs in to the console, for a terminal but never for a log
  * `interfaces` - the open interfaces, and who may use each
  * `warnings` - the configuration's warnings
  * `notes` - the latest events, newest first, as text
  """
  @type t :: %__MODULE__{
          now: integer(),
          started: integer(),
          vehicles: [map()],
          links: [map()],
          clients: [map()],
          nats: map() | nil,
          nats_login: String.t() | nil,
          identity: map() | nil,
          http: String.t() | nil,
          console: String.t() | nil,
          published: non_neg_integer(),
          pending: non_neg_integer(),
          interfaces: [Aerie.CLI.Status.Access.interface()],
          warnings: [String.t()],
          notes: [String.t()]
        }

  @doc "The read model of a gateway; `more` are further fields."
  @spec collect(Names.gateway(), keyword()) :: t()
  def collect(gateway, more \\ []) do
    now = System.os_time(:microsecond)

    struct!(
      %__MODULE__{
        now: now,
        started: now,
        vehicles: gateway |> Fleet.vehicles() |> Enum.sort_by(& &1.id),
        links: gateway |> Store.links() |> Enum.sort_by(& &1.id),
        clients: MavRouter.Client.endpoints(gateway),
        nats: Fleet.Bridge.info(gateway),
        pending: Journal.pending_size(gateway),
        identity: MavRouter.Router.identity(gateway)
      },
      more
    )
  end

  @doc "Datagrams and frames that came by a link or an endpoint for clients, and were dropped because they came too fast."
  @spec dropped_in(map()) :: number()
  def dropped_in(%{counters: counters}),
    do: for(name <- [:kernel_dropped, :shed, :overload], do: Map.get(counters, name, 0)) |> Enum.sum()
end
