defmodule MavRouter.Forward.Source do
  @moduledoc """
  A component that sends frames by an endpoint, and the endpoints that its broadcasts go to. Worked out once and kept by the
  process that hears the component, for a second at most, so that a frame of telemetry costs no look-up at all.

  | field | |
  |---|---|
  | `receivers` | paths of clients and sniffers, which get its broadcasts (R1) |
  | `vehicles` | paths on the side of vehicles, by the sender's relation to them (`MavRouter.Forward.Reach`) |
  | `groups` | the same for groups of redundant links, of which one carries |
  | `heartbeat_receivers` | paths of other vehicles, which get a vehicle's heartbeats and nothing else |
  | `vehicle` | it is part of a vehicle whose autopilot is heard by the same endpoint |
  | `redundant` | other endpoints bring it too, so its frames are checked for duplicates |
  | `collided` | it is another vehicle with an id that was taken (`MavRouter.Routes.Collisions`), or a claim |
  | `standing` | what its endpoint is to the vehicle with its id (`MavRouter.Forward.Holders`) |
  | `clock` | its boot time, which tells reboots (R6) |
  | `session` | `{vehicle key, pid}` of its vehicle; a number in the place of the pid (`Aerie.Base.Names.epoch/0`) says that there was none |
  | `learned`, `looked` | monotonic ms of the last time that its route was noted, and its receivers were worked out |
  | `marks` | what the receivers were worked out from: they are worked out again when it changes |
  """

  alias MavRouter.Routes.Collisions
  alias MavRouter.Forward.Delivery
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Forward.Table
  alias MavRouter.Forward.Reach
  alias MavRouter.Endpoints.Owner.Renumber
  alias MavRouter.Routes
  alias MavRouter.Forward.Holders
  alias MavRouter.Tables

  # How long it may take until what another process learned is seen here. A change of rules is seen at once.
  @fresh_ms 1_000
  @learn_ms 250
  # The component id of nearly every autopilot.
  @autopilot 1

  @enforce_keys [:system, :component]
  defstruct [
    :system,
    :component,
    :learned,
    :looked,
    :marks,
    :clock,
    :session,
    receivers: [],
    vehicles: [],
    groups: [],
    heartbeat_receivers: [],
    redundant: false,
    collided: false,
    standing: :free,
    autopilot: false,
    vehicle: false
  ]

  @type t :: %__MODULE__{}

  @doc "A component of which nothing is known yet."
  @spec new(non_neg_integer, 0..255) :: t
  def new(system, component), do: %__MODULE__{system: system, component: component}

  @doc """
  Brings the source of a delivery up to its time: notes the route by which it is heard if one of the trusted frames passed
  its check (R4), and works its receivers out again when they are old or something changed.
  """
  @spec refresh(Delivery.t()) :: Delivery.t()
  def refresh(%{tables: tables, forwarding: forwarding, path: path, now: now, source: before} = delivery) do
    # The endpoints' counters tell an endpoint from a new one with its key. One more vehicle among many changes nothing for a
    # vehicle.
    generation =
      if path.side == :vehicle, do: {forwarding.audience, path.counters}, else: forwarding.generation

    marks = {generation, Tables.routed(tables)}

    source =
      cond do
        # The route may be forgotten, or be wanted in another network as well.
        before.marks != marks ->
          find_receivers(%{before | marks: marks, looked: now, learned: nil}, delivery)

        now - before.looked >= @fresh_ms ->
          find_receivers(%{before | looked: now}, delivery)

        true ->
          before
      end

    source =
      if not source.collided and known?(delivery.trusted), do: learn(source, tables, path, now), else: source

    if source === before, do: delivery, else: %{delivery | source: source}
  end

  # An unknown message teaches no route (R4).
  defp known?([]), do: false
  defp known?([%{crc_extra: nil} | rest]), do: known?(rest)
  defp known?([_checked | _rest]), do: true

  defp learn(%{learned: learned} = source, _tables, _path, now)
       when is_integer(learned) and now - learned < @learn_ms,
       do: source

  defp learn(source, tables, path, now) do
    for network <- path.networks do
      result = Routes.learn(tables, network, source.system, source.component, path.key, now)
      _ = if result == :full, do: Counters.add(path.counters, :routes_refused, 1)
      # Those who hear it by another endpoint have to look for duplicates from now on.
      if result == :new and elsewhere(tables, path, source, network) != [], do: Tables.rerouted(tables)
    end

    %{source | learned: now}
  end

  defp elsewhere(tables, path, source, network),
    do: Routes.endpoints(tables, {network, source.system}, source.component) -- [path.key]

  # Who may not command cannot make a client's commands look like copies.
  defp rivals(others, %{commands: true, side: :client}, %{paths: paths}),
    do: Enum.reject(others, &match?(%{^&1 => %{commands: false}}, paths))

  defp rivals(others, _path, _forwarding), do: others

  defp find_receivers(source, %{path: path} = delivery) do
    source = %{source | standing: standing(source, delivery)}

    if source.standing == :claim or (path.side == :vehicle and collided?(delivery, source, path)),
      do: of_collided(source, delivery),
      else: of_known(%{source | collided: false}, delivery)
  end

  defp standing(source, %{tables: tables, path: path, now: now}) do
    standings =
      for network <- path.networks,
          do:
            Holders.standing(tables, {network, source.system}, source.component, path, source.autopilot, now)

    Enum.find([:claim, :part, :holder], :free, &(&1 in standings))
  end

  defp collided?(%{tables: tables, path: path}, source, to),
    do: Enum.any?(path.networks, &Collisions.other?(tables, {&1, source.system}, to.key))

  # Another vehicle with that id: no route leads to it, and only sniffers get its frames.
  defp of_collided(source, %{tables: tables, forwarding: forwarding, path: path, now: now}) do
    for network <- path.networks do
      Routes.drop(tables, {network, source.system, source.component}, path.key)

      if source.standing == :claim and Holders.claim(tables, {network, source.system}, now) == :new,
        do: Tables.rerouted(tables)
    end

    sniffers =
      for {_key, %{sniffer: true} = to} <- forwarding.listeners, broadcast?(path, to, source, tables), do: to

    %{
      source
      | collided: true,
        learned: nil,
        receivers: sniffers,
        vehicles: [],
        groups: [],
        heartbeat_receivers: [],
        redundant: source.standing == :claim
    }
  end

  defp of_known(source, %{tables: tables, forwarding: forwarding, path: path} = delivery) do
    others = path.networks |> Enum.flat_map(&elsewhere(tables, path, source, &1)) |> Enum.uniq()
    claimed? = Enum.any?(path.networks, &Holders.claimed?(tables, {&1, source.system}, delivery.now))

    source = %{source | vehicle: vehicle?(source, path, tables)}

    {all, heartbeats} =
      cond do
        path.side == :vehicle -> of_vehicle(delivery, source)
        # A sender on a link to vehicles that has too many of them: vehicles need not hear each one.
        path.auto and not path.listens -> {forwarding.listeners, %{}}
        true -> {forwarding.paths, %{}}
      end

    # A vehicle's frames go neither back to it by its second radio nor to another vehicle that would take them for its own. A
    # client may have a vehicle of its own, so this holds for vehicles only.
    receives? = fn to ->
      broadcast?(path, to, source, tables) and
        not (to.side == :vehicle and (to.key in others or collided?(delivery, source, to)))
    end

    all = for {_key, to} <- all, receives?.(to), do: to

    heartbeats =
      for {_key, to} <- heartbeats,
          receives?.(to),
          not Reach.station?(source, path, to, tables),
          do: to

    {vehicles, clients} = Enum.split_with(all, &(&1.side == :vehicle and not &1.sniffer))
    related = related(vehicles, source, delivery)
    {grouped, single} = Enum.split_with(related, fn {_relation, to} -> to.group != nil end)

    %{
      source
      | receivers: clients,
        vehicles: single |> Enum.group_by(&elem(&1, 0), &elem(&1, 1)) |> Enum.to_list(),
        groups: grouped |> Enum.group_by(fn {_relation, to} -> to.group end) |> Enum.map(&group(&1, source)),
        heartbeat_receivers: heartbeats,
        redundant: rivals(others, path, forwarding) != [] or claimed?
    }
  end

  defp related([], _source, _delivery), do: []

  defp related(vehicles, source, %{tables: tables, path: path}) do
    own = Enum.flat_map(path.networks, &Routes.endpoints(tables, {&1, source.system}))
    for to <- vehicles, do: {Reach.relation(source, path, to, to.key in own, tables), to}
  end

  # One of the group's links carries, so what reaches one of them must be allowed to reach each.
  defp group({name, related}, source) do
    relations = related |> Enum.map(&elem(&1, 0)) |> Enum.uniq()

    strictest =
      cond do
        :station in relations -> :station
        source.vehicle -> :vehicle
        true -> :stranger
      end

    {name, if(match?([_one], relations), do: hd(relations), else: strictest), Enum.map(related, &elem(&1, 1))}
  end

  defp vehicle?(source, path, tables) do
    path.side == :vehicle and path.heard_vehicle == true and
      (source.autopilot or
         Enum.any?(path.networks, &Routes.talks?(tables, {&1, source.system, @autopilot}, path.key)))
  end

  # Other vehicles hear heartbeats of a vehicle, in a crowd nothing. They hear what the gate clears of a client that a
  # router brings by the vehicle's endpoint. Each of these costs the receivers' radios, and us, in
  # proportion to the number of senders. The vehicle's own other parts, and clients, get everything.
  defp of_vehicle(%{forwarding: forwarding, path: path} = delivery, source) do
    others = Enum.reduce(path.networks, %{}, &Map.merge(&2, Map.get(forwarding.vehicles, &1, %{})))
    count = map_size(others)

    between = if path.commands and not source.vehicle, do: :all, else: forwarding.between

    case between do
      :all -> {Map.merge(others, forwarding.listeners), %{}}
      :auto -> own_parts(delivery, source, if(count <= Table.crowd(), do: others, else: %{}))
      :heartbeats -> own_parts(delivery, source, others)
      :none -> own_parts(delivery, source, %{})
    end
  end

  defp own_parts(%{tables: tables, forwarding: forwarding, path: path}, source, others) do
    keys = Enum.flat_map(path.networks, &Routes.endpoints(tables, {&1, source.system}))
    parts = Map.take(forwarding.paths, keys)
    {Map.merge(forwarding.listeners, parts), Map.drop(others, keys)}
  end

  defp broadcast?(path, to, source, tables) do
    to.key != path.key and (to.group == nil or to.group != path.group) and (to.broadcasts or to.sniffer) and
      sees?(path, to, source.system, tables)
  end

  # Whether an endpoint sees the frames of a system that another one brings: they share a network, and no network that
  # comes earlier in the endpoint's list has a system that it sees under the same id.
  defp sees?(%{networks: [network]}, %{networks: [network]}, _system, _tables), do: true

  defp sees?(path, to, system, tables) do
    case Enum.split_while(to.networks, &(&1 not in path.networks)) do
      {_all, []} -> false
      {[], _shared} -> true
      {earlier, [shared | _]} -> path.side == :client or not hidden?(to, {shared, system}, earlier, tables)
    end
  end

  # One of the earlier networks has a system that the endpoint sees under this one's id.
  defp hidden?(%{renumber: offsets}, {network, system}, earlier, tables) do
    id = Renumber.seen(offsets, network, system)
    Enum.any?(earlier, &Routes.known?(tables, {&1, Renumber.meant(offsets, &1, id)}))
  end
end
