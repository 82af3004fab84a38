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
  alias Aerie.Fleet.Missions.Comparison
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

  @doc "Begins an operation on many vehicles (`Aerie.Fleet.Operations.begin/4`), as all that follows in its changes."
  @spec begin_operation(Names.gateway(), map(), Operations.source(), via :: String.t()) :: Operations.answer()
  defdelegate begin_operation(gateway, request, source, via), to: Operations, as: :begin

  @doc "Pauses, continues, stops or aborts an operation; the last by `hold`, `rtl` or `land`."
  @spec change_operation(
          Names.gateway(),
          String.t(),
          :pause | :continue | :stop | {:abort, String.t()},
          Operations.source(),
          String.t()
        ) :: Operations.answer()
  defdelegate change_operation(gateway, id, change, source, via), to: Operations, as: :change

  @doc "Ends all flights that are in somebody's charge or in nobody's (`Aerie.Fleet.Operations.abort_all/4`)."
  @spec abort_all(Names.gateway(), type :: String.t(), Operations.source(), via :: String.t()) ::
          Operations.answer()
  defdelegate abort_all(gateway, type, source, via), to: Operations

  @doc "An operation with what became of each vehicle."
  @spec operation(Names.gateway(), String.t()) :: Operations.answer()
  defdelegate operation(gateway, id), to: Operations, as: :get
  @doc "All operations that are known, the latest first, without their vehicles."
  @spec recent_operations(Names.gateway()) :: [map()]
  defdelegate recent_operations(gateway), to: Operations, as: :list

  @doc "A refusal of an operation in words."
  @spec refusal(Operations.refusal()) :: String.t()
  defdelegate refusal(refusal), to: Operations, as: :text

  @doc "The vehicles in the air as they were a second ago at most, each with the name of its holder; nil for nobody."
  @spec airborne(Names.gateway()) :: [{String.t(), String.t() | nil}]
  defdelegate airborne(gateway), to: Operations, as: :airborne_lately

  @doc "Operations that somebody should see: not over, waiting for somebody, or over for less than `shown_s`."
  @spec open_operations(Names.gateway(), shown_s :: non_neg_integer()) :: [map()]
  defdelegate open_operations(gateway, shown_s), to: Operations, as: :open

  @doc "A vehicle of a take-off sequence: to `height`, and `above_m` up before the next one begins."
  @spec take_off(Snapshot.t(), height :: number(), above_m :: number(), anyway? :: boolean()) :: map()
  defdelegate take_off(snapshot, height, above_m, anyway? \\ false), to: Operations

  @doc "How high a vehicle surely gets that goes to a height (m): what others may wait for."
  @spec surely_above_m(number()) :: number()
  defdelegate surely_above_m(height), to: Operations

  @doc "A vehicle that returns with others (`Aerie.Fleet.Operations.return_home/3`)."
  @spec return_home(String.t(), height :: number() | nil, other :: String.t() | nil) :: map()
  defdelegate return_home(id, height, other), to: Operations

  @doc "A vehicle that lands at the place of a `goto`, or why it cannot (`Aerie.Fleet.Operations.land_at/2`)."
  @spec land_at(Snapshot.t(), goto :: map()) :: {:ok, map()} | {:error, String.t()}
  defdelegate land_at(snapshot, goto), to: Operations

  @doc "Why a vehicle cannot land at a place now; nil if nothing speaks against it."
  @spec cannot_land_at(Snapshot.t()) :: String.t() | nil
  defdelegate cannot_land_at(snapshot), to: Operations

  @doc "A plan as the vehicle flies it before which `n` others go, each so far beside the one before."
  @spec offset_plan(Comparison.plan(), non_neg_integer(), Comparison.offset()) ::
          {:ok, Comparison.plan()} | {:error, String.t()}
  defdelegate offset_plan(plan, n, offset), to: Comparison, as: :offset

  @doc "Which file's name is for which vehicle, by its id or a tag, or why none, and the names for none of them."
  @spec assign_plans([String.t()], [{String.t(), tags :: [String.t()]}]) ::
          {%{String.t() => {:ok, String.t()} | {:error, String.t()}}, spare :: [String.t()]}
  defdelegate assign_plans(names, vehicles), to: Comparison, as: :assign

  @doc "How near vehicles come to each other by their plans (`Aerie.Fleet.Missions.Comparison.of/3`)."
  @spec compare_plans(Names.gateway(), [{String.t(), Comparison.plan()}], interval_s :: number()) ::
          Comparison.t()
  defdelegate compare_plans(gateway, plans, interval_s), to: Comparison, as: :of

  @doc "Nearer to each other than so many metres vehicles should not come."
  @spec least_separation_m() :: float()
  defdelegate least_separation_m, to: Comparison, as: :limit_m

  @doc "The height to which a vehicle climbs by itself before it returns: 0 for none, nil if it is not known."
  @spec own_return_m(Names.gateway(), String.t()) :: number() | nil
  defdelegate own_return_m(gateway, id), to: Operations

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
    for shared <- [
          Command.Schema.shared(),
          Aerie.Control.Operations.shared(),
          Operations.Schema.shared(),
          Shadow.Document.Schema.shared()
        ],
        named <- shared,
        into: %{
          "command" => Command.Schema.any(),
          "result" => Command.Schema.result(),
          "reported" => Shadow.Document.Schema.reported()
        },
        do: named
  end
end
