defmodule Aerie.Router.Talker do
  @moduledoc """
  A component that speaks through an endpoint, and where what it says goes: worked out once, kept by the process that
  hears it for a second at most, so that a frame of telemetry costs no look-up at all.

  - `everyone`: endpoints that get its broadcasts (R1); `groups`: the same for groups of redundant links, of which one
    carries; `heartbeats`: endpoints that get only its heartbeats
  - `twice`: whether it is heard by other endpoints too: then frames are looked at for duplicates
  - `other`: it is another vehicle with the id of one that was there before (`Aerie.Router.Apart`)
  - `clock`: its boot time, for reboots (R6)
  - `session`: `{vehicle key, pid}` of its vehicle; a number in the place of the pid (`Aerie.Names.epoch/0`): there was none
  """

  alias Aerie.Router.Apart
  alias Aerie.Router.Plan
  alias Aerie.Router.Plan.Way
  alias Aerie.Router.Renumber
  alias Aerie.Router.Routes
  alias Aerie.Router.Tables

  # How long it may take until what was learned elsewhere is seen here; what changes rules is seen at once.
  @fresh_ms 1_000
  @learn_ms 250
  # Vehicles' ways of a network that hear everything of each other.
  @team 8

  @enforce_keys [:system, :component]
  defstruct [
    :system,
    :component,
    :learned,
    :looked,
    :marks,
    :clock,
    :session,
    everyone: [],
    groups: [],
    heartbeats: [],
    twice: false,
    other: false,
    autopilot: false
  ]

  @type t :: %__MODULE__{}

  @doc "Who it is, not yet learned of."
  @spec new(non_neg_integer, 0..255) :: t
  def new(system, component), do: %__MODULE__{system: system, component: component}

  @doc """
  Brings it up to `now` (monotonic ms): notes the route by which it is heard if `known?` (one of its frames passed its
  check, R4), and works out where its frames go when that is old or something changed.
  """
  @spec refresh(t, Tables.t(), Plan.t(), Way.t(), boolean, integer) :: t
  def refresh(talker, tables, plan, way, known?, now) do
    # A vehicle need not look again for each of many others that comes; an endpoint that is new under its old name must.
    generation = if way.side == :vehicle, do: {plan.audience, way.tally}, else: plan.generation
    marks = {generation, Tables.routed(tables)}

    talker =
      cond do
        # What it was heard by may be forgotten, or be to be found in another network as well.
        talker.marks != marks ->
          look(%{talker | marks: marks, looked: now, learned: nil}, tables, plan, way)

        now - talker.looked >= @fresh_ms ->
          look(%{talker | looked: now}, tables, plan, way)

        true ->
          talker
      end

    if known? and not talker.other, do: learn(talker, tables, way, now), else: talker
  end

  defp learn(%{learned: learned} = talker, _tables, _way, now)
       when is_integer(learned) and now - learned < @learn_ms,
       do: talker

  defp learn(talker, tables, way, now) do
    for network <- way.networks do
      result = Routes.learn(tables, network, talker.system, talker.component, way.key, now)
      # Others who hear it have to look for duplicates from now on.
      if result == :new and elsewhere(tables, way, talker, network) != [], do: Tables.rerouted(tables)
    end

    %{talker | learned: now}
  end

  defp elsewhere(tables, way, talker, network),
    do: Routes.ways(tables, {network, talker.system}, talker.component) -- [way.key]

  defp look(talker, tables, plan, way) do
    if way.side == :vehicle and apart?(tables, way, talker, way),
      do: unknown(talker, tables, plan, way),
      else: known(%{talker | other: false}, tables, plan, way)
  end

  defp apart?(tables, way, talker, to),
    do: Enum.any?(way.networks, &Apart.other?(tables, {&1, talker.system}, to.key))

  # Another vehicle with that id: no way to it, and nobody's business but that of who wants to see everything.
  defp unknown(talker, tables, plan, way) do
    for network <- way.networks,
        do: Routes.drop(tables, {network, talker.system, talker.component}, way.key)

    sniffers =
      for {_key, %{sniffer: true} = to} <- plan.listeners, broadcast?(way, to, talker, tables), do: to

    %{talker | other: true, learned: nil, everyone: sniffers, groups: [], heartbeats: [], twice: false}
  end

  defp known(talker, tables, plan, way) do
    others = way.networks |> Enum.flat_map(&elsewhere(tables, way, talker, &1)) |> Enum.uniq()

    {full, less} =
      cond do
        way.side == :vehicle -> of_vehicle(plan, tables, way, talker)
        # A sender on a link to vehicles of which too many came: vehicles need not hear each of them.
        way.auto and not way.listens -> {plan.listeners, %{}}
        true -> {plan.ways, %{}}
      end

    # A vehicle's own frames do not come back to it by its second radio, nor go to another one that takes them for its own; a
    # client may have a vehicle of its own as well.
    hears? = fn to ->
      broadcast?(way, to, talker, tables) and
        not (to.side == :vehicle and (to.key in others or apart?(tables, way, talker, to)))
    end

    full = for {_key, to} <- full, hears?.(to), do: to
    less = for {_key, to} <- less, hears?.(to), do: to
    {grouped, single} = Enum.split_with(full, &(&1.side == :vehicle and &1.group != nil))

    %{
      talker
      | everyone: single,
        groups: Enum.group_by(grouped, & &1.group) |> Map.to_list(),
        heartbeats: less,
        twice: others != []
    }
  end

  # Of another vehicle, or who may be one, a vehicle hears everything in a small team, heartbeats in a larger one, nothing in a crowd: each of
  # these costs every receiver's radio, and us, in proportion to the number of senders. Its own other parts, and who is no
  # vehicle, get everything.
  defp of_vehicle(plan, tables, way, talker) do
    others = Enum.reduce(way.networks, %{}, &Map.merge(&2, Map.get(plan.vehicles, &1, %{})))
    count = map_size(others)

    case plan.between do
      :all -> {Map.merge(others, plan.listeners), %{}}
      :auto when count <= @team -> {Map.merge(others, plan.listeners), %{}}
      :auto -> parts(plan, tables, way, talker, if(count <= Plan.choir(), do: others, else: %{}))
      :heartbeats -> parts(plan, tables, way, talker, others)
      :none -> parts(plan, tables, way, talker, %{})
    end
  end

  defp parts(plan, tables, way, talker, others) do
    keys = Enum.flat_map(way.networks, &Routes.ways(tables, {&1, talker.system}))
    parts = Map.take(plan.ways, keys)
    {Map.merge(plan.listeners, parts), Map.drop(others, keys)}
  end

  defp broadcast?(way, to, talker, tables) do
    to.key != way.key and (to.group == nil or to.group != way.group) and (to.broadcasts or to.sniffer) and
      sees?(way, to, talker.system, tables)
  end

  @doc """
  Whether an endpoint sees what a system says by another one: they share a network, and if the endpoint sees several, no
  earlier one of them has a system that it sees under that id.
  """
  @spec sees?(Way.t(), Way.t(), non_neg_integer, Tables.t()) :: boolean
  def sees?(%{networks: [network]}, %{networks: [network]}, _system, _tables), do: true

  def sees?(way, to, system, tables) do
    case Enum.split_while(to.networks, &(&1 not in way.networks)) do
      {_all, []} -> false
      {[], _shared} -> true
      {earlier, [shared | _]} -> way.side == :client or not hidden?(to, {shared, system}, earlier, tables)
    end
  end

  @doc "Whether one of these networks has a system that the endpoint sees under the id of that one."
  @spec hidden?(Way.t(), {String.t(), non_neg_integer}, [String.t()], Tables.t()) :: boolean
  def hidden?(%{renumber: offsets}, {network, system}, earlier, tables) do
    id = Renumber.seen(offsets, network, system)
    Enum.any?(earlier, &Routes.known?(tables, {&1, Renumber.meant(offsets, &1, id)}))
  end
end
