defmodule AerieCLI.Status.View do
  @moduledoc """
  What one look at a gateway shows: vehicles, links, NATS, HTTP. Collected from the read model, rendered by
  `AerieCLI.Status.Table` (a terminal) and `AerieCLI.Status.Lines` (a pipe); neither asks any process of a vehicle.
  """

  defstruct [
    :now,
    :started,
    :nats,
    :nats_login,
    :identity,
    :http,
    published: 0,
    pending: 0,
    vehicles: [],
    links: [],
    clients: [],
    faces: [],
    notes: []
  ]

  @typedoc """
  * `now`, `started` - unix microseconds
  * `vehicles`, `links` - snapshots of `Aerie.Fleet.Store`; `clients` - `Aerie.Router.clients/1`
  * `nats` - `Aerie.Bridge.info/1`; `nats_login` - the address with its login, for a terminal and not for a log
  * `identity` - `Aerie.Router.identity/1`
  * `published` - messages given to NATS so far; `pending` - events in memory that NATS has not confirmed
  * `http` - address of the HTTP server, or nil
  * `faces` - what is open to whom
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
          published: non_neg_integer(),
          pending: non_neg_integer(),
          faces: [AerieCLI.Status.Faces.face()],
          notes: [String.t()]
        }

  @doc "Whether a vehicle's snapshot is armed, or nil when that is not known."
  @spec armed(map()) :: boolean() | nil
  def armed(vehicle), do: field(vehicle, :mode, :armed)

  @doc "A field of a state group, or nil when the group or the field is not known."
  @spec field(map(), atom(), atom()) :: term()
  def field(vehicle, group, key) do
    case vehicle do
      %{groups: %{^group => %{data: %{^key => value}}}} -> value
      _other -> nil
    end
  end
end
