defmodule MavRouter.Router.Deliver do
  @moduledoc """
  What becomes of the frames of one read, in the process that read them: they teach routes (`MavRouter.Router.Forward.Source`,
  `MavRouter.Router.HeartbeatLearner`), go to other endpoints (`MavRouter.Router.Forward`) and to the sessions of their vehicles.
  """

  alias Aerie.Base.Names
  alias MavRouter.Router.Admission
  alias MavRouter.Router.Delivery
  alias MavRouter.Router.Echo
  alias MavRouter.Router.Endpoint.Counters
  alias MavRouter.Router.Forward
  alias MavRouter.Router.Forward.Cache
  alias MavRouter.Router.Forward.Table
  alias MavRouter.Router.Gate
  alias MavRouter.Router.HeartbeatLearner
  alias MavRouter.Router.SessionBackpressure
  alias MavRouter.Router.ReadCache.Requests
  alias MavRouter.Router.Forward.Source
  alias MavRouter.Router.StreamRequests
  alias MavRouter.Router.Tables
  alias MavRouter.Router.TransferLock
  alias MavRouter.Signing
  alias MavCodec.Frame

  @nothing %{delivered: 0, unclaimed: 0, refused: 0, overload: 0, looped: 0, sessions: []}

  @doc "See `MavRouter.Router.deliver/3`."
  @spec frames(Names.gateway(), MavRouter.Router.origin(), [Frame.t()]) :: MavRouter.Router.outcome()
  def frames(_gateway, _origin, []), do: @nothing

  def frames(gateway, origin, frames) do
    case Tables.of(gateway) do
      # The router is being restarted, and the link with it.
      nil -> unclaimed(frames)
      tables -> frames(gateway, tables, origin, frames)
    end
  end

  defp frames(gateway, tables, origin, frames) do
    %{forwarding: forwarding} = cache = Cache.fetch(gateway, tables)

    case path(forwarding, origin) do
      # A client whose endpoint is gone, as after a restart of the router: its frames are no vehicle's.
      nil ->
        unclaimed(frames)

      path ->
        Counters.add(path.counters, :frames_in, length(frames))
        # What lacks a right signature where one is required is not taken in, but it is forwarded (S10).
        trusted = Signing.admit(gateway, trusted_origin(%{origin | network: hd(path.networks)}, path), frames)

        by_source(frames, trusted, cache, %Delivery{
          gateway: gateway,
          tables: tables,
          forwarding: forwarding,
          path: path,
          now: :erlang.monotonic_time(:millisecond),
          sender: path.owner
        })
    end
  end

  defp unclaimed(frames), do: %{@nothing | unclaimed: length(frames)}

  # A client that is signed for needs no signature of its own.
  defp trusted_origin(origin, %{sign: true}), do: Map.put(origin, :trust, :secure)
  defp trusted_origin(origin, _path), do: origin

  defp path(%{paths: paths}, %{id: id, peer: peer, network: network}) do
    case paths do
      %{{^id, ^peer} => path} -> path
      _unknown when network == nil -> nil
      _unknown -> Table.Path.unregistered(id, peer, network)
    end
  end

  # Nearly every read is of one component.
  defp by_source([%Frame{system: system, component: component} | rest] = frames, trusted, cache, delivery) do
    cond do
      not same?(rest, system, component) -> several(frames, trusted, delivery)
      {system, component} == delivery.forwarding.own -> echo(frames, trusted, delivery)
      true -> one(frames, trusted, {system, component}, cache, delivery)
    end
  end

  defp same?([], _system, _component), do: true
  defp same?([%Frame{system: s, component: c} | rest], s, c), do: same?(rest, s, c)
  defp same?(_rest, _system, _component), do: false

  # What anybody could have sent on a link with keys is no alarm.
  defp echo(frames, trusted, delivery) do
    Echo.check(delivery, trusted)
    %{@nothing | looped: length(frames)}
  end

  defp one(frames, trusted, {system, _component} = ids, cache, delivery) do
    delivery = route(frames, trusted, ids, cache, delivery)

    cond do
      trusted == [] -> @nothing
      delivery.path.side != :vehicle -> unclaimed(trusted)
      true -> to_session(trusted, system, sender(delivery))
    end
  end

  defp several(frames, trusted, %{forwarding: %{own: own}} = delivery) do
    {looped, others} = Enum.split_with(frames, &({&1.system, &1.component} == own))

    {delivery, vehicles} =
      others
      |> Enum.group_by(&{&1.system, &1.component})
      |> Enum.reduce({delivery, []}, fn {{system, _component} = ids, frames}, {delivery, vehicles} ->
        # The source before it may have changed the path or a route.
        cache = Cache.fetch(delivery.gateway, delivery.tables)
        own_trusted = if trusted == frames, do: frames, else: of_source(trusted, ids)
        delivery = route(frames, own_trusted, ids, cache, %{delivery | forwarding: cache.forwarding})
        vehicles = if delivery.vehicle, do: [system | vehicles], else: vehicles
        {%{sender(delivery) | source: nil, vehicle: false}, vehicles}
      end)

    {echoes, claimed} = Enum.split_with(trusted, &({&1.system, &1.component} == own))
    if echoes != [], do: Echo.check(delivery, echoes)

    outcome =
      if delivery.path.side == :vehicle,
        do: to_sessions(claimed, vehicles, delivery),
        else: unclaimed(claimed)

    %{outcome | looped: length(looped)}
  end

  defp of_source(frames, ids), do: Enum.filter(frames, &({&1.system, &1.component} == ids))

  # Each vehicle gets its frames in their order, whichever of its components sent them.
  defp to_sessions(frames, vehicles, delivery) do
    frames
    |> Enum.group_by(& &1.system)
    |> Enum.reduce(@nothing, fn {system, frames}, outcome ->
      Map.merge(outcome, to_session(frames, system, %{delivery | vehicle: system in vehicles}), fn
        :sessions, before, [session] -> [session | before]
        :sessions, before, [] -> before
        _count, before, n -> before + n
      end)
    end)
  end

  # Learns from the frames of one component and forwards them. Frames with an unknown message id are forwarded too, but never
  # teach a route (R4).
  defp route(frames, trusted, {system, component}, cache, %{path: path} = delivery) do
    before = Cache.source(cache, path.key, system, component)
    source = Source.refresh(before, delivery, known?(trusted))
    delivery = HeartbeatLearner.read(trusted, %{delivery | source: source})

    _ =
      if delivery.source !== before,
        do: Cache.put_source(delivery.gateway, cache, path.key, delivery.source)

    for {scope, frames} <- Gate.sort(frames, delivery),
        do: forward(frames, trusted, %{delivery | scope: scope})

    delivery
  end

  defp forward(frames, trusted, delivery) do
    frames = StreamRequests.pass(frames, trusted, delivery)
    frames = Requests.pass(frames, trusted, delivery)
    frames = TransferLock.pass(frames, delivery)
    Forward.frames(frames, delivery)
  end

  defp known?([]), do: false
  defp known?([%Frame{crc_extra: nil} | rest]), do: known?(rest)
  defp known?([_checked | _rest]), do: true

  # While several endpoints bring a system, its session is told which of them it was.
  defp sender(%{source: %{redundant: false, collided: false}} = delivery), do: delivery
  defp sender(%{path: path} = delivery), do: %{delivery | sender: path.key}

  defp to_session(frames, system, %{path: %{networks: [network | _]}} = delivery) do
    key = {network, system}

    case session(key, delivery) do
      nil when delivery.vehicle -> admit(frames, key, delivery)
      nil -> keep(frames, key, delivery)
      session -> pass(frames, key, session, delivery)
    end
  end

  # It may be a vehicle that is being started.
  defp keep(frames, key, delivery) do
    case Admission.keep(key, frames, delivery) do
      :kept -> %{@nothing | delivered: length(frames)}
      {:ok, session} -> pass(frames, key, session, delivery)
      :none -> hold_or_pass(frames, key, delivery)
    end
  end

  # Its session may have taken its name and its first frames since it was looked for.
  defp hold_or_pass(frames, key, delivery) do
    case session(key, delivery) do
      nil -> hold(frames, key, delivery)
      session -> pass(frames, key, session, delivery)
    end
  end

  # No session, so no vehicle yet: its texts are kept for the time when it is one.
  defp hold(frames, key, delivery) do
    Cache.hold(delivery.gateway, key, frames)
    unclaimed(frames)
  end

  # The session is remembered with the source while it lives; that there is none, until some process takes a name.
  defp session(key, %{source: source} = delivery) do
    case source do
      %{session: {^key, session}} when is_pid(session) ->
        if Process.alive?(session), do: session, else: find_session(key, delivery)

      %{session: {^key, epoch}} when is_integer(epoch) ->
        if epoch == Names.epoch(), do: nil, else: find_session(key, delivery)

      _new_or_none ->
        find_session(key, delivery)
    end
  end

  defp find_session(key, %{source: nil} = delivery), do: Names.whereis(delivery.gateway, :session, key)

  defp find_session(key, %{source: source, path: path} = delivery) do
    epoch = Names.epoch()
    found = Names.whereis(delivery.gateway, :session, key)
    Cache.update_source(delivery.gateway, path.key, %{source | session: {key, found || epoch}})
    found
  end

  defp admit(frames, key, %{gateway: gateway} = delivery) do
    first = fn -> Cache.held(gateway, key, hd(frames)) ++ frames end

    case Admission.session(key, first, delivery) do
      # It gets them when it is there.
      :coming -> %{@nothing | delivered: length(frames)}
      {:ok, session} -> pass(first.(), key, session, delivery)
      :refused -> %{@nothing | refused: length(frames)}
      :not_yet -> keep(frames, key, delivery)
    end
  end

  defp pass(frames, {network, system} = key, session, delivery) do
    if SessionBackpressure.over?(delivery.tables, key, session, delivery.now) do
      metadata = %{gateway: delivery.gateway, network: network, system: system, reason: :overload}
      :telemetry.execute([:aerie, :router, :dropped], %{frames: length(frames)}, metadata)
      %{@nothing | overload: length(frames)}
    else
      send(session, {:frames, delivery.sender, frames})
      %{@nothing | delivered: length(frames), sessions: [session]}
    end
  end
end
