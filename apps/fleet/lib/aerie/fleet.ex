defmodule Aerie.Fleet do
  @moduledoc """
  All vehicles that this gateway knows of, in one model: those on its own links, and those that other gateways hear
  (`Aerie.Fleet.Remote.Table`). A vehicle that is heard both ways is one vehicle.

  A snapshot is that of `Aerie.Base.Store` with `:via` and `:gateways`; a group that another gateway reported has the
  key `:via` as well, the name of that gateway.

  This gateway's links count until they have lost the vehicle; then another gateway does, if that hears it. If two
  report a group, the one on the vehicle's way counts unless it is ten seconds older.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet.{Operations, Shadow}
  alias Aerie.Fleet.Remote.Table
  alias Aerie.Vehicle.{Command, Event, Snapshot}
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Vehicle.State.Fields

  @older_us 10_000_000

  @doc "All vehicles, those on this gateway's links first."
  @spec vehicles(Names.gateway()) :: [Snapshot.t()]
  def vehicles(gateway) do
    local = Store.vehicles(gateway)
    remote = Table.vehicles(gateway, now())
    known = MapSet.new(local, & &1.id)

    Enum.map(local, &merge(&1, remote[&1.id])) ++
      for({id, vehicle} <- Enum.sort(remote), id not in known, do: vehicle)
  end

  @doc "One vehicle by its id; nil if no gateway knows it."
  @spec vehicle(Names.gateway(), String.t()) :: Snapshot.t() | nil
  def vehicle(gateway, id),
    do: merge(Store.vehicle(gateway, id), Table.vehicle(gateway, id, now()))

  @doc "The snapshot of a vehicle that may be heard here (local), there (remote), or both."
  @spec merge(local :: Snapshot.t() | nil, remote :: Snapshot.t() | nil) :: Snapshot.t() | nil
  def merge(nil, remote), do: remote
  def merge(local, nil), do: local

  def merge(%{status: :lost} = local, %{status: status} = remote) when status != :lost,
    do: %{remote | groups: groups(remote.groups, local.groups)}

  def merge(local, remote),
    do: %{local | gateways: remote.gateways, groups: groups(local.groups, remote.groups)}

  defp groups(first, second) do
    Map.merge(first, second, fn _group, one, other ->
      if other.at > one.at + @older_us, do: other, else: one
    end)
  end

  defp now, do: System.os_time(:microsecond)

  @doc "The latest events of a vehicle, or of `:all`, oldest first."
  @spec events(Names.gateway(), String.t() | :all, keyword()) :: [Event.t()]
  defdelegate events(gateway, vehicle, options \\ []), to: Journal, as: :recent

  @doc "An event as NATS and REST have it."
  @spec show_event(Names.gateway(), Event.t()) :: %{String.t() => term()}
  def show_event(gateway, event), do: Fields.event(event, epoch(gateway))

  @doc "An event as people read it."
  @spec describe_event(Event.t()) :: %{severity: 0..7, text: String.t()}
  defdelegate describe_event(event), to: Event.Text, as: :of

  @doc "Which start of the gateway numbers its events: it grows with each."
  @spec epoch(Names.gateway()) :: pos_integer() | nil
  defdelegate epoch(gateway), to: Journal

  @doc "What can be asked for besides commands: of vehicles, their desired state, and operations on many of them."
  @spec operations() :: [Aerie.Control.Operations.Operation.t()]
  def operations,
    do:
      Aerie.Control.Operations.all() ++
        Shadow.Operations.all() ++ Operations.Requests.all()

  @doc "The schemas of commands and their results, and those that the schemas of operations refer to, by their names."
  @spec schemas() :: %{String.t() => map()}
  def schemas do
    envelopes = for type <- Command.Types.all(), do: Command.Schema.envelope(type, type?: true)

    for shared <- [
          Command.Schema.shared(),
          Aerie.Control.Operations.shared(),
          Operations.Schema.shared(),
          Shadow.Document.Schema.shared()
        ],
        named <- shared,
        into: %{
          "command" => %{oneOf: envelopes},
          "result" => Command.Schema.result(),
          "reported" => Shadow.Document.Schema.reported()
        },
        do: named
  end
end
