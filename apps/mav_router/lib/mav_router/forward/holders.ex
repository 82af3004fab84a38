defmodule MavRouter.Forward.Holders do
  @reach_ms 2_500
  @silent_ms 5_000
  @slow_silent_ms 180_000
  @claimed_ms 10_000
  @max_members 8
  @max_systems 16_384

  @moduledoc """
  The endpoints that bring a vehicle, in the order of their seniority. What a frame says about its sender proves
  nothing, so a system id belongs to the endpoint by which its autopilot's heartbeat came first, until that endpoint
  is silent for #{div(@silent_ms, 1_000)} s (#{div(@slow_silent_ms, 60_000)} minutes on a link of high latency).

  | rank | a later endpoint that brings a heartbeat of the same autopilot |
  |---|---|
  | 2 | belongs to a link with one other end, or with `secure: true`: it joins, and comes before those of rank 0 |
  | 1 | is another link of a member's group, or may command anyway: it joins as the junior |
  | 0 | is anybody's: it has the id only while every senior member is silent |

  Any other sender under the id **claims** it, whatever its messages are: they go to sniffers and nowhere else, teach
  no route, and the vehicle's session reports a collision. A component that no member brings is a **part** on a socket
  of its own: it is reached there, and by the vehicle's way as well, unless its link has `parts: true` or may command.

  The gateway's own messages go to the senior member that was heard within #{@reach_ms} ms, and never to a client's
  endpoint.
  """

  alias Aerie.Base.Names
  alias Aerie.Base.Store
  alias MavRouter.Endpoints.Access
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints
  alias MavRouter.Forward.Table.Path
  alias MavRouter.Routes
  alias MavRouter.Tables

  # The component id of nearly every autopilot.
  @autopilot 1

  @type system :: {network :: String.t(), system :: non_neg_integer}
  @type rank :: 0..2
  @typedoc "MAV_TYPE and MAV_AUTOPILOT"
  @type kind :: {0..255, 0..255}
  @type standing :: :free | :holder | :part | :claim

  @doc """
  What an endpoint is to a component of a system: `:free` while no vehicle has the id, `:holder` of the vehicle,
  `:part` or `:claim`.
  """
  @spec standing(Tables.t(), system, 0..255, Path.t(), autopilot? :: boolean, integer) :: standing
  def standing(tables, system, component, path, autopilot?, now) do
    case members(tables, system) do
      [] ->
        :free

      members ->
        cond do
          path.side == :vehicle and path.key in active(tables, system, members, now) -> :holder
          autopilot? or component in [0, @autopilot] or brought?(tables, system, component, members) -> :claim
          true -> :part
        end
    end
  end

  defp brought?(tables, {network, system}, component, members),
    do: Enum.any?(members, fn {key, _rank} -> Routes.talks?(tables, {network, system, component}, key) end)

  @doc "An autopilot's heartbeat came by an endpoint on the side of vehicles. `:changed` when it joined."
  @spec join(Tables.t(), system, Path.t(), kind, secure? :: boolean, integer) ::
          :changed | :unchanged | :claim
  def join(tables, system, path, kind, secure?, now) do
    case :ets.lookup(tables.holders, system) do
      [] -> first(tables, system, {path.key, rank(tables, [], system, path, secure?, now)}, kind)
      [{_system, members, known, _claimed}] -> join(tables, system, members, known, path, kind, secure?, now)
    end
  end

  defp first(tables, system, member, kind) do
    cond do
      :ets.info(tables.holders, :size) >= @max_systems -> :unchanged
      :ets.insert_new(tables.holders, {system, [member], kind, nil}) -> :changed
      true -> :claim
    end
  end

  defp join(tables, system, members, known, %{key: key} = path, kind, secure?, now) do
    heard? =
      Enum.any?(members, fn {member, _rank} -> member != key and heard?(tables, system, member, now) end)

    member? = List.keymember?(members, key, 0)

    cond do
      member? and (kind == known or key not in active(tables, system, members, now)) -> :unchanged
      # The same autopilot was loaded with another firmware.
      member? and not heard? -> put(tables, system, members, kind)
      member? -> :unchanged
      # Another autopilot, while the vehicle's own connection is still there.
      kind != known and Enum.any?(members, &there?(tables, system, &1)) -> :claim
      not heard? -> add(tables, system, members, {key, 0}, kind, path, secure?, now)
      true -> add(tables, system, members, {key, nil}, kind, path, secure?, now)
    end
  end

  defp add(tables, system, members, {key, least}, kind, path, secure?, now) do
    members = room(tables, system, members, now)
    rank = rank(tables, members, system, path, secure?, now)

    cond do
      rank == 0 and least == nil -> :claim
      length(members) >= @max_members -> :claim
      rank == 2 -> put(tables, system, before_strangers(members, {key, rank}), kind)
      true -> put(tables, system, members ++ [{key, rank}], kind)
    end
  end

  defp before_strangers(members, member) do
    {seniors, strangers} = Enum.split_while(members, fn {_key, rank} -> rank > 0 end)
    seniors ++ [member | strangers]
  end

  defp room(_tables, _system, members, _now) when length(members) < @max_members, do: members
  defp room(tables, system, members, now), do: Enum.filter(members, &heard?(tables, system, elem(&1, 0), now))

  defp put(tables, system, members, kind) do
    # The sweeper may just have forgotten the system; the next heartbeat begins it again.
    _there? = :ets.update_element(tables.holders, system, [{2, members}, {3, kind}])
    :changed
  end

  defp rank(tables, members, system, %{key: {owner, peer}} = path, secure?, now) do
    cond do
      peer == :remote or secure? -> 2
      path.commands -> 1
      path.group != nil and grouped?(tables, members, system, owner, path.group, now) -> 1
      true -> 0
    end
  end

  # Another link of the group, of which no other peer brings the vehicle now.
  defp grouped?(tables, members, system, owner, group, now) do
    Enum.any?(members, fn {{other, _peer}, _rank} ->
      other != owner and match?(%{group: ^group}, Endpoints.owner(tables, other))
    end) and
      not Enum.any?(members, fn {{other, _peer} = key, _rank} ->
        other == owner and heard?(tables, system, key, now)
      end)
  end

  @doc """
  Notes that somebody claims a vehicle's id. `:new` when nobody did for a while: from now on the holders' frames are
  remembered, so that those which only come back by another endpoint do not count as claims.
  """
  @spec claim(Tables.t(), system, integer) :: :new | :known
  def claim(tables, system, now) do
    known? = claimed?(tables, system, now)
    :ets.update_element(tables.holders, system, {4, now})
    if known?, do: :known, else: :new
  end

  @doc "Whether somebody claimed a vehicle's id a moment ago."
  @spec claimed?(Tables.t(), system, integer) :: boolean
  def claimed?(tables, system, now) do
    claimed = :ets.lookup_element(tables.holders, system, 4, nil)
    claimed != nil and now - claimed <= @claimed_ms
  end

  @doc "The endpoints that bring a vehicle now, seniors first; none while no vehicle has the id."
  @spec active(Tables.t(), system, integer) :: [Endpoint.key()]
  def active(tables, system, now), do: active(tables, system, members(tables, system), now)

  defp active(_tables, _system, [{only, _rank}], _now), do: [only]

  defp active(tables, system, members, now) do
    {active, _senior?} =
      Enum.flat_map_reduce(members, false, fn {key, rank}, senior? ->
        active = if rank > 0 or not senior?, do: [key], else: []
        {active, senior? or heard?(tables, system, key, now)}
      end)

    active
  end

  defp heard?(tables, system, key, now) do
    heard = Routes.heard(tables, system, key)
    heard != nil and now - heard <= silent_ms(tables, key)
  end

  defp there?(tables, system, {key, _rank}), do: Routes.heard(tables, system, key) != nil

  defp silent_ms(tables, key), do: if(slow?(tables, key), do: @slow_silent_ms, else: @silent_ms)

  @doc "Whether an endpoint is one of high latency: configured, or found out."
  @spec slow?(Tables.t(), Endpoint.key()) :: boolean
  def slow?(tables, {owner, _peer} = key) do
    match?(%{high_latency: true}, Endpoints.get(tables, key)) or
      match?(%{high_latency: true}, Endpoints.owner(tables, owner))
  end

  defp members(tables, system), do: :ets.lookup_element(tables.holders, system, 2, [])

  @doc """
  The endpoints to which a message of the gateway goes: one, or two for a part that may be a stranger's. `:component`
  prefers where that one is heard, `:link` allows one link only.
  """
  @spec way(Tables.t(), system, keyword, integer) :: [Endpoint.key()]
  def way(tables, system, options, now) do
    case active(tables, system, now) do
      [] -> tables |> Routes.best(system, options) |> List.wrap()
      active -> way(tables, system, active, Keyword.get(options, :component, 0), options[:link], now)
    end
  end

  defp way(tables, {network, id} = system, active, component, link, now) do
    holder = active |> Enum.filter(&by?(&1, link)) |> senior(tables, system, now)

    with true <-
           component != 0 and not Enum.any?(active, &Routes.talks?(tables, {network, id, component}, &1)),
         [part | _] <-
           for(
             key <- Routes.endpoints(tables, system, component),
             by?(key, link),
             of_vehicle?(tables, key),
             do: key
           ) do
      if trusted_part?(tables, part), do: [part], else: Enum.uniq([part | List.wrap(holder)])
    else
      _the_vehicle -> List.wrap(holder)
    end
  end

  defp by?({owner, _peer}, link), do: link in [nil, owner]

  defp of_vehicle?(tables, {owner, _peer} = key) do
    not match?(%{side: :client}, Endpoints.owner(tables, owner)) and
      not match?(%{side: :client}, Endpoints.get(tables, key))
  end

  # The first that was heard a moment ago, else the one that was heard last.
  defp senior([], _tables, _system, _now), do: nil

  defp senior(active, tables, system, now) do
    heard = for key <- active, at = Routes.heard(tables, system, key), do: {key, at}

    case Enum.find(heard, fn {_key, at} -> now - at <= @reach_ms end) ||
           Enum.max_by(heard, &elem(&1, 1), fn -> nil end) do
      {key, _at} -> key
      nil -> nil
    end
  end

  defp trusted_part?(tables, {owner, _peer} = key) do
    with %{} = endpoint <- Endpoints.get(tables, key), %{} = owner <- Endpoints.owner(tables, owner) do
      owner.parts or Access.commands?(endpoint, owner)
    else
      _gone -> false
    end
  end

  @doc """
  Whether the gateway's own messages to a vehicle that is not lost go to an endpoint, or would if no other link brought
  the vehicle and this one has a high latency.
  """
  @spec needed?(Tables.t(), Names.gateway(), Endpoint.key(), integer) :: boolean
  def needed?(tables, gateway, {link, _peer} = key, now) do
    options = if slow?(tables, key), do: [link: link], else: []

    Enum.any?(Routes.heard_by(tables, key), fn system ->
      vehicle = Store.vehicle(gateway, system)
      vehicle != nil and not match?(%{status: :lost}, vehicle) and key in way(tables, system, options, now)
    end)
  end

  @doc "The endpoints where frames of others reach a component of a system; 0 stands for all components (R1, R9)."
  @spec endpoints(Tables.t(), system, 0..255, integer) :: [Endpoint.key()]
  def endpoints(tables, system, component, now) do
    case active(tables, system, now) do
      [] -> unheld(tables, system, component)
      active -> held(tables, system, component, active)
    end
  end

  defp unheld(tables, system, component) do
    with [] <- if(component == 0, do: [], else: Routes.endpoints(tables, system, component)),
         do: Routes.endpoints(tables, system)
  end

  defp held(tables, system, 0, active) do
    for key <- Routes.endpoints(tables, system), key in active or part?(tables, system, key), do: key
  end

  defp held(tables, system, component, active) do
    heard = Routes.endpoints(tables, system, component)

    case Enum.filter(heard, &(&1 in active)) do
      [] ->
        if heard != [] and Enum.all?(heard, &trusted_part?(tables, &1)),
          do: heard,
          else: others(heard, tables, system, active)

      by_vehicle ->
        by_vehicle
    end
  end

  # One that never talks is where its system is (R9); a stranger's part gets no more than a copy.
  defp others([], tables, system, active), do: held(tables, system, 0, active)

  defp others(heard, tables, system, active),
    do: Enum.uniq(heard ++ Enum.filter(Routes.endpoints(tables, system), &(&1 in active)))

  # What said it was the autopilot before the vehicle came has no part.
  defp part?(tables, {network, system}, key),
    do: not Routes.talks?(tables, {network, system, @autopilot}, key)

  @doc "Forgets the systems that have no route any more."
  @spec sweep(Tables.t()) :: :ok
  def sweep(tables) do
    for {system, _members, _kind, _claimed} <- :ets.tab2list(tables.holders),
        not Routes.known?(tables, system),
        do: :ets.delete(tables.holders, system)

    :ok
  end
end
