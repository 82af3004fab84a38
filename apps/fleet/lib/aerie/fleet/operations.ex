defmodule Aerie.Fleet.Operations do
  @moduledoc """
  What is done with many vehicles: one command, one change of the desired state, or for each vehicle steps of its own.
  They go in steps, with what became of each, and can be paused, stopped and aborted.

      {:ok, operation} =
        Aerie.Fleet.Operations.begin(gateway, %{"tag" => "survey", "command" => %{"type" => "rtl"}}, source)

  `docs/fleet.md` describes it for users, `Aerie.Fleet.Operations.Request` the keys. Vehicles of other gateways are
  among them. Answers are maps as JSON has them. Subscribers of `{:notice, :operations}` (`Aerie.Base.PubSub`) get the
  id of an operation that has changed.
  """

  alias Aerie.Vehicle.Command.Error
  alias Aerie.Base.Json
  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet.Remote.Merge
  alias Aerie.Fleet.Shadow
  alias Aerie.Fleet.Operations.{Core, Guard, Request, Sequence, Server}
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{ControlLease, Roles}
  alias Aerie.Vehicle.Snapshot

  @inside Aerie.Control.Policy.Roles.principal(:gateway, "elixir", :admin)

  @type refusal ::
          {:malformed, [Error.t(), ...]}
          | {:role | :busy | :conflict | :unknown | :unavailable, String.t()}

  @lately_ms 900

  @type source :: Roles.source()
  @type answer :: {:ok, map()} | {:error, refusal()}

  @doc "Begins an operation in the name of `source`; the same one again gives how it stands."
  @spec begin(Names.gateway(), term(), Roles.source(), via :: String.t()) ::
          answer()
  def begin(gateway, object, source \\ @inside, via \\ "elixir") do
    with :ok <- permitted(source),
         {:ok, request} <- parsed(Request.parse(object, System.os_time(:microsecond))),
         {:ok, request} <- parsed(possible(request)),
         {:ok, vehicles} <- vehicles(gateway, request.targets),
         # A copy of a request is the operation that is there, whatever its vehicles do now.
         :ok <-
           if(Server.entry(gateway, request.id),
             do: :ok,
             else: Guard.check(gateway, request, vehicles, source)
           ),
         {:ok, entry} <- Server.begin(gateway, object, request, vehicles, source, via),
         do: {:ok, plain(entry)}
  end

  @doc """
  Changes an operation that was begun:

    * `:pause` - none begins until it is continued; what is under way comes to its end
    * `:continue` - goes on with those that have not begun, in the name of `source`, after a pause, a halt or a restart
      of the gateway; what was asked before the first one began is asked of them again
    * `:stop` - none begins any more; what is under way comes to its end
    * `{:abort, type}` - the same, but gives up what is under way, and ends the flights of those that have begun by
      `type` (`hold`, `rtl` or `land`), in an operation of its own: its id is the answer's `then`
  """
  @spec change(
          Names.gateway(),
          String.t(),
          :pause | :continue | :stop | {:abort, String.t()},
          Roles.source(),
          String.t()
        ) ::
          answer()
  def change(gateway, id, change, source \\ @inside, via \\ "elixir")
      when change in [:pause, :continue, :stop] or
             (elem(change, 0) == :abort and elem(change, 1) in ~w(hold rtl land)) do
    with :ok <- permitted(source),
         :ok <- if(change == :continue, do: again(gateway, Server.entry(gateway, id), source), else: :ok),
         {:ok, entry} <- Server.change(gateway, id, change, source, via),
         do: {:ok, plain(entry)}
  end

  defp again(_gateway, nil, _source), do: :ok

  # What was shown was shown before.
  defp again(gateway, entry, source),
    do: Guard.check(gateway, %{entry.request | shown: %{}}, entry.core.waiting, source)

  @doc """
  Aborts all operations that run, and ends the flights of all vehicles in the air that are in the charge of `source`
  or of nobody. Gives the operation that does it.
  """
  @spec abort_all(Names.gateway(), type :: String.t(), Roles.source(), String.t()) ::
          answer()
  def abort_all(gateway, type, source \\ @inside, via \\ "elixir") when type in ~w(hold rtl land) do
    mine = for {id, holder} <- airborne(gateway), holder in [nil, ControlLease.who(source)], do: id

    with :ok <- permitted(source), {:ok, entry} <- Server.abort_all(gateway, mine, type, source, via) do
      if entry,
        do: {:ok, plain(entry)},
        else: {:error, {:conflict, "no vehicle in the air is in your charge or in nobody's"}}
    end
  end

  @doc "Those that are not over, wait for somebody, or were over less than `shown_s` ago, the latest first."
  @spec open(Names.gateway(), shown_s :: non_neg_integer()) :: [map()]
  def open(gateway, shown_s) do
    since = System.os_time(:microsecond) - shown_s * 1_000_000

    for %{core: %{state: state}, done_at: done_at} = entry <- Server.entries(gateway),
        done_at == nil or state in [:halted, :interrupted] or done_at > since,
        do: plain(entry)
  end

  @doc "The vehicles in the air as they are now, each with the name of its holder; nil for nobody."
  @spec airborne(Names.gateway()) :: [{String.t(), String.t() | nil}]
  def airborne(gateway) do
    leases = Policy.control_leases(gateway)

    for %{id: id} = vehicle <- Merge.vehicles(gateway),
        vehicle.status != :lost,
        Snapshot.data(vehicle, :mode)[:in_air] == true,
        do: {id, with(%{holder: holder} <- leases[vehicle.key], do: holder)}
  end

  @doc "The same as they were a second ago at most, for all pages together."
  @spec airborne_lately(Names.gateway()) :: [{String.t(), String.t() | nil}]
  def airborne_lately(gateway) do
    now = System.monotonic_time(:millisecond)

    case Store.recall(gateway, :airborne) do
      {at, vehicles} when now - at < @lately_ms ->
        vehicles

      _old ->
        vehicles = airborne(gateway)
        Store.remember(gateway, :airborne, {now, vehicles})
        vehicles
    end
  end

  @doc "The steps of a take-off for one vehicle of a sequence (`Aerie.Fleet.Operations.Sequence.take_off/4`)."
  @spec take_off(map(), number(), number(), boolean()) :: map()
  defdelegate take_off(snapshot, height, above_m, anyway? \\ false), to: Sequence

  @doc "How high a vehicle surely gets that goes to a height (m)."
  @spec surely_above_m(number()) :: number()
  defdelegate surely_above_m(height), to: Sequence

  @doc "The steps of one that returns with others (`Aerie.Fleet.Operations.Sequence.Returning.steps/3`)."
  @spec return_home(String.t(), number() | nil, String.t() | nil) :: map()
  defdelegate return_home(id, height, other), to: Sequence.Returning, as: :steps

  @doc "The steps of one that lands at a place (`Aerie.Fleet.Operations.Sequence.Landing.steps/2`)."
  @spec land_at(Snapshot.t(), goto :: map()) :: {:ok, map()} | {:error, String.t()}
  defdelegate land_at(snapshot, goto), to: Sequence.Landing, as: :steps

  @doc "Why a vehicle cannot land at a place now; nil if nothing speaks against it."
  @spec cannot_land_at(Snapshot.t()) :: String.t() | nil
  defdelegate cannot_land_at(snapshot), to: Sequence.Landing, as: :refusal

  @doc "The height to which a vehicle climbs by itself before it returns: 0 for none, nil if it is not known."
  @spec own_return_m(Names.gateway(), String.t()) :: number() | nil
  defdelegate own_return_m(gateway, id), to: Sequence.Returning, as: :own_m

  @doc "An operation with what became of each vehicle."
  @spec get(Names.gateway(), String.t()) :: answer()
  def get(gateway, id) do
    case Server.entry(gateway, id) do
      nil -> {:error, {:unknown, "there is no operation #{id}"}}
      entry -> {:ok, plain(entry)}
    end
  end

  @doc "All operations that are known, the latest first, without their vehicles."
  @spec list(Names.gateway()) :: [map()]
  def list(gateway),
    do: for(entry <- Server.entries(gateway), do: Map.drop(plain(entry), ["vehicles", "order"]))

  @doc "A refusal in words."
  @spec text(refusal()) :: String.t()
  def text({:malformed, errors}), do: Enum.join(errors, "; ")
  def text({_kind, text}), do: text

  defp permitted(%{role: :viewer}), do: {:error, {:role, "a viewer changes nothing"}}
  defp permitted(_source), do: :ok

  defp possible(%{what: {:sequence, vehicles}} = request) do
    case Sequence.futile(vehicles) do
      [] -> {:ok, request}
      errors -> {:error, errors}
    end
  end

  defp possible(request), do: {:ok, request}

  defp parsed({:ok, request}), do: {:ok, request}
  defp parsed({:error, errors}), do: {:error, {:malformed, errors}}

  defp vehicles(_gateway, {:vehicles, ids}), do: {:ok, ids}

  defp vehicles(gateway, {:tag, tag}) do
    found = for {id, tags} <- Shadow.tags(gateway), tag in tags, do: id

    cond do
      found == [] ->
        {:error, {:malformed, [Error.new("tag", "one that a vehicle has", tag)]}}

      length(found) > Request.max_vehicles() ->
        {:error, {:malformed, [Error.new("tag", "one of at most #{Request.max_vehicles()} vehicles", tag)]}}

      true ->
        {:ok, Enum.sort(found)}
    end
  end

  defp plain(%{core: core, request: request} = entry) do
    waiting = for id <- core.waiting, do: {id, %{"state" => "waiting"}}
    under_way = for id <- core.under_way, do: {id, %{"state" => "under_way", "step" => entry.doing[id]}}

    done =
      for {id, result} <- core.results,
          do:
            {id,
             %{
               "state" => Atom.to_string(result.verdict),
               "result" => result.status,
               "reason" => result.reason
             }}

    %{
      "id" => entry.id,
      "state" => Atom.to_string(core.state),
      "name" => request.name,
      "source" => entry.source.name,
      "begun_at" => Json.time(entry.at),
      "done_at" => Json.time(entry.done_at),
      "what" => what(request.what),
      "step" => core.step,
      "then" => entry.then,
      "counts" => %{
        "waiting" => length(waiting),
        "under_way" => length(under_way),
        "ok" => map_size(core.results) - Core.failed(core),
        "failed" => Core.failed(core)
      },
      "order" => entry.vehicles,
      "vehicles" => Map.new(waiting ++ under_way ++ done)
    }
  end

  defp what({:command, type, params}), do: %{"command" => %{"type" => type, "params" => params}}

  defp what({:shadow, update}), do: %{"shadow" => update}
  # The steps of the first vehicle stand for those of the others.
  defp what({:sequence, [%{steps: steps} | _others]}), do: %{"sequence" => Enum.map(steps, &Sequence.word/1)}
end
