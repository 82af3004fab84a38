defmodule Aerie.Fleet do
  @moduledoc """
  All vehicles that this gateway knows of, in one model: those on its own links, and those that other gateways hear
  (`Aerie.Fleet.Remote.Table`). A vehicle that is heard both ways is one vehicle.

  A snapshot is that of `Aerie.Base.Store` with `:via` and `:gateways`; a group that another gateway reported has the
  key `:via` as well, the name of that gateway.

  This gateway's links count until they have lost the vehicle; then another gateway does, if that hears it. If two
  report a group, the one on the vehicle's way counts unless it is ten seconds older.
  """

  alias Aerie.Base.Names
  alias Aerie.Fleet.{Operations, Shadow, Tracks}
  alias Aerie.Fleet.Operations.Readiness
  alias Aerie.Fleet.Remote.Merge
  alias Aerie.Vehicle.{Command, Event, Snapshot}
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Vehicle.State.Fields

  @doc "All vehicles, those on this gateway's links first."
  @spec vehicles(Names.gateway()) :: [Snapshot.t()]
  defdelegate vehicles(gateway), to: Merge

  @doc "One vehicle by its id; nil if no gateway knows it."
  @spec vehicle(Names.gateway(), String.t()) :: Snapshot.t() | nil
  defdelegate vehicle(gateway, id), to: Merge

  @doc "The snapshot of a vehicle that may be heard here (local), there (remote), or both."
  @spec merge(local :: Snapshot.t() | nil, remote :: Snapshot.t() | nil) :: Snapshot.t() | nil
  defdelegate merge(local, remote), to: Merge

  @doc """
  Whether a vehicle is ready to take off, point by point (`Aerie.Vehicle.Snapshot.Readiness`), as somebody sees it who
  may be in charge of it; nil if no gateway knows it.
  """
  @spec readiness(Names.gateway(), String.t(), viewer :: String.t() | nil | :anybody) :: Readiness.t() | nil
  defdelegate readiness(gateway, id, viewer \\ :anybody), to: Readiness, as: :of

  @doc "The same of vehicles that were read already, by their ids."
  @spec readinesses(Names.gateway(), [Snapshot.t()], viewer :: String.t() | nil | :anybody) ::
          %{String.t() => Readiness.t()}
  defdelegate readinesses(gateway, vehicles, viewer \\ :anybody), to: Readiness, as: :all

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

  @doc "Where vehicles were (`Aerie.Fleet.Tracks.Reader.read/6`). Times are unix microseconds."
  @spec tracks(
          Names.gateway(),
          [String.t()] | :all,
          from :: integer(),
          to :: integer(),
          step_s :: pos_integer(),
          keyword()
        ) ::
          {:ok, Tracks.Reader.answer()} | {:error, String.t()}
  defdelegate tracks(gateway, ids, from, to, step_s, options \\ []), to: Tracks.Reader, as: :read

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
