defmodule MavRouter.Router.Deliver do
  @moduledoc """
  What becomes of the frames of one read, in the process that read them: they teach routes (`MavRouter.Forward.Source`,
  `MavRouter.Forward.HeartbeatLearner`), go to other endpoints (`MavRouter.Forward`) and to the sessions of their
  vehicles.
  """

  alias Aerie.Base.Names
  alias MavRouter.Forward.Delivery
  alias MavRouter.Router.Echo
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Forward
  alias MavRouter.Forward.Cache
  alias MavRouter.Forward.Table
  alias MavRouter.Forward.Gate
  alias MavRouter.Forward.HeartbeatLearner
  alias MavRouter.Router.SessionBackpressure
  alias MavRouter.Router.Starter
  alias MavRouter.Forward.Source
  alias MavRouter.Tables
  alias MavRouter.Sharing
  alias MavRouter.Signing
  alias MavCodec.Frame

  @nothing %{delivered: 0, unclaimed: 0, refused: 0, overload: 0, looped: 0, sessions: []}

  @typep result :: {MavRouter.Router.outcome(), Cache.t() | nil}

  @doc "See `MavRouter.Router.deliver/4`."
  @spec frames(Names.gateway(), MavRouter.Router.origin(), [Frame.t()], Cache.t() | nil) :: result
  def frames(_gateway, _origin, [], cache), do: {@nothing, cache}

  def frames(gateway, origin, frames, cache) do
    case Tables.of(gateway) do
      # The router is being restarted, and the link with it.
      nil -> {unclaimed(frames), nil}
      tables -> read(gateway, tables, origin, frames, Cache.refresh(cache, tables))
    end
  end

  defp read(gateway, tables, origin, frames, %{forwarding: forwarding} = cache) do
    case path(forwarding, origin) do
      # A client whose endpoint is gone, as after a restart of the router: its frames are not a vehicle's.
      nil ->
        {unclaimed(frames), cache}

      path ->
        Counters.add(path.counters, :frames_in, length(frames))
        # A frame without the required signature is forwarded, but not processed (S10).
        trusted = Signing.admit(gateway, trusted_origin(%{origin | network: hd(path.networks)}, path), frames)

        by_source(cache, %Delivery{
          frames: frames,
          trusted: trusted,
          gateway: gateway,
          tables: tables,
          forwarding: forwarding,
          path: path,
          now: :erlang.monotonic_time(:millisecond),
          secure: match?(%{trust: :secure}, origin),
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
  defp by_source(cache, %{frames: [%Frame{system: system, component: component} | rest]} = delivery) do
    cond do
      not same?(rest, system, component) -> several(cache, delivery)
      {system, component} == delivery.forwarding.own -> {echo(delivery), cache}
      true -> one({system, component}, cache, delivery)
    end
  end

  defp same?([], _system, _component), do: true
  defp same?([%Frame{system: s, component: c} | rest], s, c), do: same?(rest, s, c)
  defp same?(_rest, _system, _component), do: false

  # Unsigned echoes on a link with keys raise no alarm: anyone can forge them.
  defp echo(%{frames: frames, trusted: trusted} = delivery) do
    Echo.check(delivery, trusted)
    %{@nothing | looped: length(frames)}
  end

  defp one({system, _component} = ids, cache, %{trusted: trusted} = delivery) do
    {delivery, cache} = route(delivery, ids, cache)

    cond do
      trusted == [] -> {@nothing, cache}
      delivery.path.side != :vehicle or delivery.source.standing == :claim -> {unclaimed(trusted), cache}
      true -> to_session(trusted, system, cache, sender(delivery))
    end
  end

  defp several(cache, %{frames: frames, trusted: trusted, tables: tables, forwarding: %{own: own}} = delivery) do
    {looped, others} = Enum.split_with(frames, &({&1.system, &1.component} == own))

    {delivery, cache, {vehicles, claims}} =
      others
      |> Enum.group_by(&{&1.system, &1.component})
      |> Enum.reduce({delivery, cache, {[], []}}, fn {{system, _component} = ids, frames},
                                                     {delivery, cache, {vehicles, claims}} ->
        # The source before it may have changed the path or a route.
        cache = Cache.refresh(cache, tables)
        own_trusted = if trusted == frames, do: frames, else: of_source(trusted, ids)
        delivery = %{delivery | forwarding: cache.forwarding, frames: frames, trusted: own_trusted}
        {delivery, cache} = route(delivery, ids, cache)
        vehicles = if delivery.vehicle, do: [system | vehicles], else: vehicles
        claims = if delivery.source.standing == :claim, do: [ids | claims], else: claims
        {%{sender(delivery) | source: nil, vehicle: false}, cache, {vehicles, claims}}
      end)

    {echoes, claimed} = Enum.split_with(trusted, &({&1.system, &1.component} == own))
    if echoes != [], do: Echo.check(delivery, echoes)

    {foreign, theirs} =
      if delivery.path.side == :vehicle,
        do: Enum.split_with(claimed, &({&1.system, &1.component} in claims)),
        else: {claimed, []}

    {outcome, cache} = to_sessions(theirs, vehicles, cache, delivery)
    {%{outcome | looped: length(looped), unclaimed: outcome.unclaimed + length(foreign)}, cache}
  end

  defp of_source(frames, ids), do: Enum.filter(frames, &({&1.system, &1.component} == ids))

  # Each vehicle gets its frames in their order, whichever of its components sent them.
  defp to_sessions(frames, vehicles, cache, delivery) do
    frames
    |> Enum.group_by(& &1.system)
    |> Enum.reduce({@nothing, cache}, fn {system, frames}, {sum, cache} ->
      {outcome, cache} = to_session(frames, system, cache, %{delivery | vehicle: system in vehicles})
      {Map.merge(sum, outcome, &add/3), cache}
    end)
  end

  defp add(:sessions, sessions, more), do: more ++ sessions
  defp add(_count, sum, more), do: sum + more

  # The stations that the frames of one component pass, in this order; each gives the delivery to the next.
  defp route(%{path: %{key: key}} = delivery, {system, component}, cache) do
    before = Cache.source(cache, key, system, component)

    delivery =
      %{delivery | source: before}
      |> Source.refresh()
      |> HeartbeatLearner.read()

    # The gate parts them by whom they may reach.
    :ok = delivery |> Gate.sort() |> forward()

    if delivery.source === before,
      do: {delivery, cache},
      else: {delivery, Cache.put_source(cache, key, delivery.source)}
  end

  defp forward([]), do: :ok

  defp forward([run | rest]) do
    _ = run |> Sharing.pass() |> Forward.frames()
    forward(rest)
  end

  # While several endpoints bring a system, its session gets the endpoint with the frames.
  defp sender(%{source: %{redundant: false, collided: false}} = delivery), do: delivery
  defp sender(%{path: path} = delivery), do: %{delivery | sender: path.key}

  defp to_session(frames, system, cache, %{path: %{networks: [network | _]}} = delivery) do
    key = {network, system}

    case session(key, cache, delivery) do
      {nil, cache} when delivery.vehicle -> admit(frames, key, cache, delivery)
      {nil, cache} -> keep(frames, key, cache, delivery)
      {session, cache} -> {pass(frames, key, session, delivery), cache}
    end
  end

  # It may be a vehicle that is being started.
  defp keep(frames, key, cache, delivery) do
    if Starter.keep?(key, frames, delivery),
      do: {%{@nothing | delivered: length(frames)}, cache},
      else: pass_or_hold(frames, key, cache, delivery)
  end

  # Its session may have taken its name since it was looked for, which the cache learns a moment later.
  defp pass_or_hold(frames, key, cache, delivery) do
    case Names.whereis(delivery.gateway, :session, key) do
      # No session, so no vehicle yet: its texts are kept for the time when it is one.
      nil -> {unclaimed(frames), Cache.hold(cache, key, frames)}
      session -> {pass(frames, key, session, delivery), cache}
    end
  end

  # The session is remembered with the source while it lives; that there is none, until some process takes a name.
  defp session(key, cache, %{source: source} = delivery) do
    case source do
      %{session: {^key, session}} when is_pid(session) ->
        if Process.alive?(session), do: {session, cache}, else: find_session(key, cache, delivery)

      %{session: {^key, epoch}} when is_integer(epoch) ->
        if epoch == Names.epoch(), do: {nil, cache}, else: find_session(key, cache, delivery)

      _new_or_none ->
        find_session(key, cache, delivery)
    end
  end

  defp find_session(key, cache, %{source: source, path: path} = delivery) do
    epoch = Names.epoch()
    found = Names.whereis(delivery.gateway, :session, key)

    if source == nil,
      do: {found, cache},
      else: {found, Cache.put_source(cache, path.key, %{source | session: {key, found || epoch}})}
  end

  defp admit(frames, key, cache, delivery) do
    {texts, without} = Cache.take_held(cache, key, hd(frames))

    case Starter.session(key, texts ++ frames, delivery) do
      # It gets them when it is there.
      :coming -> {%{@nothing | delivered: length(frames)}, without}
      {:ok, session} -> {pass(texts ++ frames, key, session, delivery), without}
      :refused -> {%{@nothing | refused: length(frames)}, cache}
      :not_yet -> keep(frames, key, cache, delivery)
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
