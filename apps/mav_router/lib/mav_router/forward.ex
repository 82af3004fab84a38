defmodule MavRouter.Forward do
  @moduledoc """
  From one endpoint to the others: where each frame of a delivery goes.

  | rule | |
  |---|---|
  | R1 | a frame without a target, or with target 0, goes to every other endpoint of the network; any other one to the endpoints where its target was heard |
  | R2 | no frame goes back to the endpoint that it came from, and a frame for an unknown target goes nowhere |
  | R3, S10 | frames go out as they came in, signature and all; only what a client with `sign` sends unsigned is signed, by the link that needs it |
  | R4 | an unknown message goes to every client; to vehicles only if the policy opens it |
  | R6 | a boot time that starts over clears the routes that the same endpoint taught of the system |
  | R9 | a component that never spoke is reached where its system is |
  | S8 | SETUP_SIGNING goes nowhere |
  | S9 | other secrets (`MavCodec.Signing.Redact`) go to vehicles; clients get what vehicles say without them |
  | F10 | a target that was cut off is 0, which is everyone |

  Runs in the process that received the frames. Each receiver gets its frames in their order.
  """

  alias MavCodec.Meaning.HighLatency
  alias MavCodec.MessageId
  alias MavRouter.Endpoints.Output.Batch
  alias MavRouter.Routes.LinkSelector
  alias MavRouter.Endpoints.Queue.TrafficClass
  alias MavRouter.Forward.Dedupe
  alias MavRouter.Forward.Delivery
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Endpoints.Owner.Filter
  alias MavRouter.Endpoints.Output
  alias MavRouter.Endpoints.Owner.RateLimit
  alias MavRouter.Forward.Reach
  alias MavRouter.Forward.Refusal
  alias MavRouter.Endpoints.Owner.Renumber
  alias MavRouter.Routes
  alias MavRouter.Forward.Holders
  alias Aerie.Base.Names
  alias Aerie.Base.Timing.TokenBucket
  alias MavCodec.Frame
  alias MavCodec.Signing.Redact

  @heartbeat MessageId.of!("HEARTBEAT")
  @setup_signing MessageId.of!("SETUP_SIGNING")
  # Other vehicles hear two heartbeats a second of one component, and up to four at once.
  @heartbeat_us 500_000
  @heartbeats 4
  # Commands that an autopilot sends to 1/0 or 0/0 are for itself: PX4 says its internal ones so.
  @commands Enum.map(
              ~w(COMMAND_INT COMMAND_LONG COMMAND_INT_STAMPED COMMAND_LONG_STAMPED),
              &MessageId.of!/1
            )

  @doc "Forwards the frames of one source, in order."
  @spec frames(Delivery.t()) :: :ok
  def frames(%{frames: frames, path: %{role: :read_only} = path}),
    do: Counters.add(path.counters, :read_only, length(frames))

  def frames(%{frames: frames, path: path, source: source} = delivery) do
    if source.collided, do: Counters.add(path.counters, :collided, length(frames))

    case admitted(frames, delivery) do
      [] ->
        :ok

      frames ->
        _ = if source.standing == :claim, do: claimed(hd(frames), delivery)
        run(frames, [], delivery)
    end
  end

  # Frames in the name of a vehicle that are not an echo of it: its session reports them. Once a second is enough.
  defp claimed(%{at: at}, %{gateway: gateway, tables: tables, path: path, source: source}) do
    key = {path.key, :claim, source.system, 0}

    with {:pass, due} <-
           RateLimit.pass(
             :ets.lookup_element(tables.limits, key, 2, nil),
             1_000_000,
             System.monotonic_time(:microsecond)
           ) do
      :ets.insert(tables.limits, {key, due})

      for network <- path.networks, session = Names.whereis(gateway, :session, {network, source.system}) do
        send(session, {:claimed, path.key, at || System.os_time(:microsecond)})
      end
    end
  end

  # Nearly always there is nothing to look at.
  defp admitted(frames, %{path: %{in: nil} = path, source: %{redundant: false}}) do
    if secrets?(frames), do: Enum.reject(frames, &secret?(&1, path)), else: frames
  end

  defp admitted(frames, %{path: path} = delivery) do
    Enum.reject(frames, &(secret?(&1, path) or filtered_in?(&1, path) or duplicate?(&1, delivery)))
  end

  defp secrets?([]), do: false
  defp secrets?([%{id: @setup_signing} | _rest]), do: true
  defp secrets?([_other | rest]), do: secrets?(rest)

  defp secret?(%{id: @setup_signing}, path), do: Counters.add(path.counters, :secret, 1) == :ok
  defp secret?(_frame, _path), do: false

  defp filtered_in?(frame, path),
    do:
      not Filter.pass?(path.in, frame, path.owner) and
        Counters.add(path.counters, :filtered_in, 1) == :ok

  defp duplicate?(_frame, %{source: %{redundant: false}}), do: false

  defp duplicate?(frame, %{tables: tables, path: path, scope: scope, now: now}),
    do:
      Dedupe.duplicate?(tables, frame.bytes, path.key, scope, now) and
        Counters.add(path.counters, :duplicates, 1) == :ok

  # Broadcasts are gathered until a frame has a target, so that each receiver gets everything in its order.
  defp run([], gathered, delivery), do: broadcast(gathered, delivery)

  defp run([frame | rest], gathered, delivery) do
    case {target(frame, delivery), Redact.kept?(frame)} do
      {:all, false} ->
        run(rest, [frame | gathered], delivery)

      {target, false} ->
        broadcast(gathered, delivery)
        send_to(target, frame, delivery)
        run(rest, [], delivery)

      {target, true} ->
        broadcast(gathered, delivery)
        secret(target, frame, delivery)
        run(rest, [], delivery)
    end
  end

  # To vehicles only. Clients learn what a vehicle says without the secret itself; what other clients say they
  # do not hear.
  defp secret(:all, frame, %{source: source, path: path} = delivery) do
    vehicles =
      for {relation, paths} <- source.vehicles,
          do: {relation, Enum.filter(paths, &(relation == :own or vehicle?(&1)))}

    groups =
      for {group, relation, paths} <- source.groups, do: {group, relation, Enum.filter(paths, &vehicle?/1)}

    groups = Enum.reject(groups, &match?({_group, _relation, []}, &1))
    _ = to_vehicles(Batch.new([frame]), %{delivery | source: %{source | vehicles: vehicles, groups: groups}})

    if path.side == :vehicle,
      do: emit_all(source.receivers, Batch.new([Redact.frame(frame)]), delivery),
      else: Refusal.of_broadcast([frame], delivery)
  end

  defp secret(target, frame, %{forwarding: forwarding, path: path} = delivery) do
    {system, keys} = addressed(target, delivery)

    with keys when is_list(keys) <- open(keys, frame, delivery) do
      # A camera has not said that it is a vehicle.
      {vehicles, clients} = Enum.split_with(keys, &match?(%{side: :vehicle}, forwarding.paths[&1]))
      if vehicles != [] or clients == [], do: send_by(frame, system, vehicles, delivery)

      case clients do
        [] -> :ok
        clients when path.side == :vehicle -> send_by(Redact.frame(frame), system, clients, delivery)
        _another_client -> Counters.add(path.counters, :secret, length(clients))
      end
    end
  end

  defp vehicle?(to), do: match?(%{side: :vehicle, heard_vehicle: true}, to)

  @doc "The receiver of a frame: a system and a component of it (0 for all), or everybody."
  @spec target(Frame.t(), Delivery.t()) :: :all | {pos_integer, 0..255}
  # A collided vehicle's frames go to sniffers, whatever their target.
  def target(_frame, %{source: %{collided: true}}), do: :all

  def target(frame, %{path: path, source: source}) do
    case Frame.target(frame) do
      nil ->
        :all

      {0, _component} when frame.id in @commands and source.autopilot and path.side == :vehicle ->
        {frame.system, 0}

      {0, _component} ->
        :all

      target ->
        target
    end
  end

  defp broadcast([], _delivery), do: :ok

  defp broadcast(gathered, %{source: source} = delivery) do
    batch = emit_all(source.receivers, gathered |> :lists.reverse() |> Batch.new(), delivery)
    _ = if source.vehicles != [] or source.groups != [], do: to_vehicles(batch, delivery)
    _ = if source.heartbeat_receivers != [], do: heartbeats_only(batch, delivery)
    Refusal.of_broadcast(batch.frames, delivery)
  end

  defp to_vehicles(_batch, %{scope: :clients}), do: :ok

  defp to_vehicles(batch, %{scope: :cleared, source: source} = delivery) do
    _batch = source.vehicles |> Enum.flat_map(&elem(&1, 1)) |> emit_all(batch, delivery)
    for {group, _relation, paths} <- source.groups, do: to_group({group, paths}, batch.frames, delivery)
  end

  # A vehicle's telemetry is not for other vehicles.
  defp to_vehicles(batch, %{source: source} = delivery) do
    for {relation, paths} <- source.vehicles,
        [_ | _] = frames <- [passing(relation, batch.frames, delivery)],
        do: _ = emit_all(paths, Batch.new(frames), delivery)

    for {group, relation, paths} <- source.groups,
        [_ | _] = frames <- [passing(relation, batch.frames, delivery)],
        do: to_group({group, paths}, frames, delivery)
  end

  defp passing(relation, frames, %{forwarding: %{between: between}}),
    do: Enum.filter(frames, &Reach.passes?(relation, &1, between))

  defp emit_all([], batch, _delivery), do: batch
  defp emit_all([to | rest], batch, delivery), do: emit_all(rest, emit(to, batch, delivery), delivery)

  defp to_group({group, paths}, frames, %{tables: tables} = delivery) do
    for {class, frames} <- classes(frames), to <- carriers(tables, group, paths, class) do
      emit(to, Batch.new(frames), delivery)
    end
  end

  defp heartbeats_only(batch, %{source: source} = delivery) do
    case Enum.filter(batch.frames, &heartbeat?(&1, delivery)) do
      [] -> :ok
      heartbeats -> emit_all(source.heartbeat_receivers, Batch.new(heartbeats), delivery)
    end
  end

  defp heartbeat?(
         %{id: @heartbeat} = frame,
         %{source: %{vehicle: true}, forwarding: %{between: between}} = delivery
       ),
       do: Reach.passes?(:vehicle, frame, between) and heartbeat_due?(delivery)

  defp heartbeat?(_frame, _delivery), do: false

  # Each goes out as often as there are vehicles, so their rate is limited by sender.
  defp heartbeat_due?(%{tables: tables, path: path, source: source}) do
    key = {path.key, :heartbeat, source.system, source.component}
    full = :ets.lookup_element(tables.limits, key, 2, nil)

    case TokenBucket.take(full, System.monotonic_time(:microsecond), @heartbeat_us, @heartbeats) do
      {:ok, full} -> :ets.insert(tables.limits, {key, full})
      :none -> false
    end
  end

  defp classes(frames) do
    frames |> Enum.chunk_by(&TrafficClass.of(&1.id)) |> Enum.map(&{TrafficClass.of(hd(&1).id), &1})
  end

  defp send_to(target, frame, delivery) do
    {system, keys} = addressed(target, delivery)

    case open(keys, frame, delivery) do
      :shut -> :ok
      keys -> send_by(frame, system, keys, delivery)
    end
  end

  # Those of the endpoints by which a target is reached that are open to a frame; `:shut` when there were some and none is left.
  defp open(keys, _frame, %{scope: :cleared}), do: keys

  defp open(keys, frame, %{path: path} = delivery) do
    case Enum.split_with(keys, &(&1 == path.key or open?(&1, frame, delivery))) do
      {keys, []} ->
        keys

      {open, _shut} ->
        Refusal.withheld(frame, delivery)
        if open -- [path.key] == [], do: :shut, else: open
    end
  end

  defp open?(key, frame, %{forwarding: forwarding, path: path, source: source, tables: tables} = delivery) do
    case forwarding.paths do
      %{^key => %{side: :vehicle} = to} ->
        delivery.scope == :related and
          Reach.passes?(relation(source, path, to, tables), frame, forwarding.between)

      _client_or_gone ->
        true
    end
  end

  defp relation(source, path, to, tables) do
    own? = Enum.any?(path.networks, &Routes.on_endpoint?(tables, {&1, source.system}, to.key))
    Reach.relation(source, path, to, own?, tables)
  end

  defp send_by(frame, system, keys, %{path: path} = delivery) do
    if not delivery.source.redundant,
      do: Dedupe.note(delivery.tables, frame.bytes, path.key, delivery.scope, delivery.now)

    case renumbered_in(frame, system, path) do
      {:ok, frame} -> reach(frame, system, keys, delivery)
      :refused -> Counters.add(path.counters, :refused, 1)
    end
  end

  # A client that sees other ids uses them as targets too.
  defp renumbered_in(frame, {_network, system}, %{renumber: offsets}) when offsets != nil,
    do: Renumber.inward(frame, system)

  defp renumbered_in(frame, _system, _path), do: {:ok, frame}

  defp reach(frame, system, keys, %{forwarding: forwarding, path: path} = delivery) do
    batch = Batch.new([frame])
    heard = for key <- keys, key != path.key, to = forwarding.paths[key], reach?(to, frame, delivery), do: to

    sniffers =
      for {key, %{sniffer: true} = to} <- forwarding.listeners,
          not Redact.kept?(frame),
          key != path.key,
          key not in keys,
          shares?(path, to),
          do: to

    case heard do
      # A frame for the gateway itself has arrived and goes no further.
      [] ->
        if Frame.target(frame) != forwarding.own, do: Counters.add(path.counters, :no_route, 1)

      heard ->
        heard |> one_of_each_group(system, frame, delivery) |> Enum.each(&emit(&1, batch, delivery))
    end

    Enum.each(sniffers, &emit(&1, batch, delivery))
  end

  # Neither within a group of redundant links nor to the sender itself by another endpoint: a vehicle would take its own frame
  # for a command.
  defp reach?(to, frame, %{tables: tables, path: path, source: source}) do
    (to.group == nil or to.group != path.group) and
      not (source.redundant and to.side == :vehicle and
             Enum.any?(path.networks, &Routes.talks?(tables, {&1, frame.system, frame.component}, to.key)))
  end

  # The first of the sender's networks in which the target is known decides.
  defp addressed({id, component}, %{tables: tables, forwarding: forwarding, path: path, now: now}) do
    Enum.find_value(path.networks, {nil, []}, fn network ->
      key = {network, Renumber.meant(path.renumber, network, id)}

      heard? = component != 0 and Routes.endpoints(tables, key, component) != []

      if heard? or {id, component} != forwarding.own,
        do: some(key, Holders.endpoints(tables, key, component, now))
    end)
  end

  defp some(_key, []), do: nil
  defp some(key, endpoints), do: {key, endpoints}

  defp shares?(path, to), do: Enum.any?(path.networks, &(&1 in to.networks))

  defp one_of_each_group([_one] = paths, _system, _frame, _delivery), do: paths

  defp one_of_each_group(paths, system, frame, %{tables: tables}) do
    {grouped, single} = Enum.split_with(paths, &(&1.group != nil and &1.side == :vehicle))
    class = TrafficClass.of(frame.id)

    single ++
      Enum.flat_map(Enum.group_by(grouped, & &1.group), fn {group, paths} ->
        near = LinkSelector.within_reach(tables, system, Enum.map(paths, & &1.key))
        carriers(tables, group, Enum.filter(paths, &(&1.key in near)), class)
      end)
  end

  defp carriers(_tables, _group, [path], _class), do: [path]

  defp carriers(tables, group, paths, class) do
    links =
      LinkSelector.links(tables, group, Enum.map(paths, & &1.owner), LinkSelector.configured(paths, class))

    Enum.filter(paths, &(&1.owner in links))
  end

  defp emit(%{plain: true} = to, batch, delivery), do: out(to, batch, delivery.path)

  defp emit(to, batch, delivery) do
    # These frames are a batch of their own: no other path can use its bytes.
    _ =
      case batch.frames |> renumbered_out(to, delivery) |> Enum.filter(&passes?(&1, to, delivery)) do
        [] -> :ok
        frames -> out(to, Batch.new(frames), delivery.path)
      end

    batch
  end

  defp renumbered_out(frames, %{renumber: offsets} = to, %{tables: tables, path: %{side: :vehicle} = path})
       when offsets != nil do
    theirs? = fn system -> Enum.any?(path.networks, &Routes.on_endpoint?(tables, {&1, system}, to.key)) end

    Enum.flat_map(frames, fn frame ->
      case Renumber.outward(offsets, path, frame, theirs?) do
        {:ok, frame} ->
          [frame]

        :refused ->
          Counters.add(to.counters, :refused, 1)
          []
      end
    end)
  end

  defp renumbered_out(frames, _to, _delivery), do: frames

  defp out(%{side: :vehicle} = to, batch, %{sign: true}), do: Output.emit_to_be_signed(to, batch)
  defp out(to, batch, _path), do: Output.emit(to, batch)

  defp passes?(frame, to, %{tables: tables, path: path}) do
    cond do
      to.high_latency and not HighLatency.carries?(frame) -> stopped(to, :spared)
      not Filter.pass?(to.filter, frame, path.owner) -> stopped(to, :filtered_out)
      limited?(frame, to, tables) -> stopped(to, :limited)
      true -> true
    end
  end

  defp stopped(to, counter) do
    Counters.add(to.counters, counter, 1)
    false
  end

  defp limited?(%{id: id} = frame, %{limits: limits} = to, tables) do
    case limits do
      %{^id => interval} -> limited?(frame, to, interval, tables)
      _none_or_free -> false
    end
  end

  defp limited?(frame, to, interval, tables) do
    key = {to.key, frame.id, frame.system, frame.component}
    due = :ets.lookup_element(tables.limits, key, 2, nil)

    case RateLimit.pass(due, interval, System.monotonic_time(:microsecond)) do
      {:pass, due} -> not :ets.insert(tables.limits, {key, due})
      :drop -> true
    end
  end
end
