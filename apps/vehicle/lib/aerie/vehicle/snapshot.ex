defmodule Aerie.Vehicle.Snapshot do
  @moduledoc """
  A vehicle as it was at a moment: what its session writes to `Aerie.Base.Store`, and what everybody else reads of it.

    * `:id` - its public id; `:key` - network and system id
    * `:component`, `:mavlink_version` - of its autopilot; `:type` - MAV_TYPE; `:vehicle_type` - copter, plane, rover …
    * `:last_heard` - unix microseconds; `:time_boot_ms` - the vehicle's clock then
    * `:links` - ids of the links that hear it, the latest first
    * `:groups` - the groups of its state (`Aerie.Vehicle.State.Groups`) by name
    * `:collision`, `:streams`, `:clock`, `:gcs`, `:reports`, `:high_latency`, `:params` - what the session's services
      show
    * `:signing` - `MavRouter.Signing.vehicle/2`; `:recording` - `MavRouter.Recorder.summary/2`
    * `:memory` - what only a session needs that goes on after a crash

  These are filled in above the session:

    * `:via` - the gateway by which the vehicle is reached; nil: a link of this one. `:gateways` - the others that
      report it
    * `:heard_here?` - that the gateway in `:via` holds the vehicle, although this one hears it as well
  """

  alias Aerie.Base.Geo.Earth
  alias Aerie.Vehicle.Protocol.Kind
  alias Aerie.Vehicle.Snapshot.{Arming, Fields, Readiness}
  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.State.Group

  # At most 32 keys with __struct__: the BEAM keeps a larger map as a tree.
  defstruct [
    :id,
    :key,
    :network,
    :system_id,
    :component,
    :mavlink_version,
    :autopilot,
    :vehicle_type,
    :type,
    :firmware,
    :uid,
    :capabilities,
    :status,
    :last_heard,
    :time_boot_ms,
    :collision,
    :streams,
    :clock,
    :gcs,
    :reports,
    :high_latency,
    :signing,
    :recording,
    :via,
    heard_here?: false,
    gateways: [],
    links: [],
    groups: %{},
    params: %{},
    memory: %{}
  ]

  @type t :: %__MODULE__{
          id: String.t() | nil,
          key: Aerie.Base.Store.vehicle_key() | nil,
          network: String.t() | nil,
          system_id: non_neg_integer() | nil,
          component: 1..255 | nil,
          mavlink_version: 1 | 2 | nil,
          autopilot: Aerie.Vehicle.Firmware.name() | nil,
          vehicle_type: String.t() | nil,
          type: non_neg_integer() | nil,
          firmware: String.t() | nil,
          uid: String.t() | nil,
          capabilities: non_neg_integer() | nil,
          status: :online | :stale | :lost | nil,
          last_heard: integer() | nil,
          time_boot_ms: non_neg_integer() | nil,
          collision: map() | nil,
          streams: %{non_neg_integer() => map()} | nil,
          clock: map() | nil,
          gcs: map() | nil,
          reports: map() | nil,
          high_latency: map() | nil,
          signing: map() | nil,
          recording: map() | nil,
          via: String.t() | nil,
          heard_here?: boolean(),
          gateways: [String.t()],
          links: [term()],
          groups: %{atom() => map()},
          params: %{String.t() => number()},
          memory: map()
        }

  @doc "The data of a group; empty if the group was never heard."
  @spec data(t(), atom()) :: map()
  def data(%{groups: groups}, group) do
    case groups do
      %{^group => %{data: data}} -> data
      _unheard -> %{}
    end
  end

  @doc "The groups of the state with a title and their fields, in the order of the documentation."
  @spec groups() :: [{atom(), String.t(), [Group.field()]}]
  defdelegate groups, to: State.Fields, as: :all

  @doc "What is shown of a vehicle in a form."
  @spec fields(Fields.form()) :: [Aerie.Base.Json.Object.t()]
  defdelegate fields(form), to: Fields, as: :of

  @doc "A vehicle in a form. What is not known is null; a value that no longer comes stays, with its age."
  @spec show(t(), Fields.form(), Fields.context()) :: %{atom() => term()}
  defdelegate show(vehicle, form, context), to: Fields

  @type readiness :: Readiness.t()

  @doc "What prevents it from arming, by its snapshot and its latest events."
  @spec arming(t(), [Aerie.Vehicle.Event.t()], now :: integer()) :: Arming.t()
  defdelegate arming(vehicle, events, now), to: Arming, as: :of

  @doc "A sensor's name for people: `3d_gyro` is `3D gyro`."
  @spec sensor(String.t()) :: String.t()
  defdelegate sensor(name), to: Arming

  @doc "Whether it is ready to take off, point by point, by its snapshot and what is known beside it."
  @spec readiness(t(), Readiness.beside()) :: Readiness.t()
  defdelegate readiness(vehicle, beside), to: Readiness, as: :of

  @doc "What is shown of that."
  @spec readiness_fields() :: [Aerie.Base.Json.Object.t()]
  defdelegate readiness_fields, to: Readiness.Points, as: :fields

  @doc "The metres over the ground from the vehicle to a place in degrees; nil if one of both is not known."
  @spec distance(t(), {lat :: number(), lon :: number()} | nil) :: float() | nil
  def distance(vehicle, {lat, lon}) do
    with %{lat: own_lat, lon: own_lon} when is_number(own_lat) and is_number(own_lon) <-
           data(vehicle, :position),
         do: Earth.distance(Earth.point(own_lat, own_lon), Earth.point(lat, lon)),
         else: (_unknown -> nil)
  end

  def distance(_vehicle, nil), do: nil

  @doc "Whether it takes off and lands."
  @spec flies?(t()) :: boolean()
  def flies?(%{vehicle_type: kind}), do: Kind.flies?(kind)

  @doc """
  Microseconds since the vehicle was last heard, at `now` (unix microseconds); nil if it never was. `links` are the
  gateway's link snapshots.
  """
  @spec silent_us(t(), links :: [map()], now :: integer()) :: non_neg_integer() | nil
  def silent_us(%{last_heard: nil}, _links, _now), do: nil
  def silent_us(%{last_heard: heard} = vehicle, links, now), do: max(now(vehicle, links, now) - heard, 0)

  @doc """
  The time (unix microseconds) that the ages of a vehicle's state refer to: `now`, or for a vehicle that is heard only
  from recordings the last frame that was played.
  """
  @spec now(t(), links :: [map()], now :: integer()) :: integer()
  def now(%{links: ids}, links, now) do
    own = for link <- links, link.id in ids, do: link

    if own != [] and Enum.all?(own, &match?(%{spec: %{recorded: true}}, &1)),
      do: own |> Enum.map(&(&1.last_heard || 0)) |> Enum.max(),
      else: now
  end
end
