defmodule MavRouter.Routes do
  @moduledoc """
  The endpoints by which components are reached: learned from the source of every frame, with the time of the last one (R1).

  System ids are integers of up to 32 bits (N3) and belong to a network: the routes of two networks never meet. Times are
  monotonic ms. A component that is addressed but never talks (a vehicle's log at component 155, R9) is reached where its
  system was heard.
  """

  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Tables

  @max_routes 16_384
  # While half of the routes are free, one endpoint may bring as many as it likes: a router behind it may have a whole fleet.
  @plenty div(@max_routes, 2)
  @max_each 256
  @ttl_ms 300_000

  @type route :: %{
          network: String.t(),
          system: non_neg_integer,
          component: 0..255,
          link: String.t(),
          peer: term,
          age_ms: non_neg_integer,
          known_ms: non_neg_integer
        }

  @doc """
  Notes that a component was heard. `:new` the first time; `:full` when there are #{@max_routes} routes already, or more than half of
  them and #{@max_each} by this endpoint, so that one endpoint leaves room for the vehicles of others.
  """
  @spec learn(Tables.t(), String.t(), non_neg_integer, 0..255, Endpoint.key(), integer) :: :ok | :new | :full
  def learn(tables, network, system, component, {link, peer}, now) do
    key = {network, system, component, link, peer}

    cond do
      :ets.update_element(tables.routes, key, {2, now}) -> :ok
      full?(tables, :ets.info(tables.routes, :size), link, peer) -> :full
      true -> add(tables, {key, now, now})
    end
  end

  defp full?(_tables, size, _link, _peer) when size < @plenty, do: false
  defp full?(_tables, size, _link, _peer) when size >= @max_routes, do: true

  # Looks at no more of them than it may have.
  defp full?(tables, _size, link, peer) do
    case :ets.select(tables.heard_by, [{{{link, peer, :_, :_, :_}}, [], [true]}], @max_each) do
      {found, _more} -> length(found) >= @max_each
      :"$end_of_table" -> false
    end
  end

  defp add(tables, {{network, system, component, link, peer}, _now, _since} = route) do
    true = :ets.insert(tables.heard_by, {{link, peer, network, system, component}})
    true = :ets.insert(tables.routes, route)
    :new
  end

  @doc """
  The endpoint by which a system was heard last, or one of its components (`:component`), where that is heard at all. `:link`
  in `options` asks for the endpoints of one link only.
  """
  @spec best(Tables.t(), {String.t(), non_neg_integer}, keyword) :: Endpoint.key() | nil
  def best(tables, {network, system}, options \\ []) do
    component = Keyword.get(options, :component, 0)
    link = Keyword.get(options, :link, :_)
    newest(tables, network, system, component, link) || newest(tables, network, system, :_, link)
  end

  defp newest(_tables, _network, _system, 0, _link), do: nil

  defp newest(tables, network, system, component, link) do
    match = {{network, system, component, if(link == :_, do: :"$1", else: link), :"$2"}, :"$3", :_}

    found =
      :ets.select(tables.routes, [{match, [], [{{:"$3", if(link == :_, do: :"$1", else: link), :"$2"}}]}])

    case found do
      [] -> nil
      endpoints -> endpoints |> Enum.max() |> then(fn {_heard, link, peer} -> {link, peer} end)
    end
  end

  @doc "Every endpoint by which a system (or one component of it) was heard, the most recent first."
  @spec endpoints(Tables.t(), {String.t(), non_neg_integer}, 0..255 | :any) :: [Endpoint.key()]
  def endpoints(tables, {network, system}, component \\ :any) do
    component = if component == :any, do: :_, else: component

    tables.routes
    |> :ets.select([{{{network, system, component, :"$1", :"$2"}, :"$3", :_}, [], [{{:"$3", :"$1", :"$2"}}]}])
    |> Enum.sort(:desc)
    |> Enum.map(fn {_heard, link, peer} -> {link, peer} end)
    |> Enum.uniq()
  end

  @doc "Whether a system is heard by any endpoint."
  @spec known?(Tables.t(), {String.t(), non_neg_integer}) :: boolean
  def known?(tables, {network, system}) do
    # The first key after all that are smaller.
    match?({^network, ^system, _, _, _}, :ets.next(tables.routes, {network, system, -1, "", nil}))
  end

  @doc "Whether a system is heard by an endpoint."
  @spec on_endpoint?(Tables.t(), {String.t(), non_neg_integer}, Endpoint.key()) :: boolean
  def on_endpoint?(tables, {network, system}, {link, peer}) do
    :ets.select_count(tables.routes, [{{{network, system, :_, link, peer}, :_, :_}, [], [true]}]) > 0
  end

  @doc "When a system was heard last by an endpoint (monotonic ms, to a quarter of a second), nil for never."
  @spec heard(Tables.t(), {String.t(), non_neg_integer}, Endpoint.key()) :: integer | nil
  def heard(tables, {network, system}, {link, peer}) do
    case :ets.select(tables.routes, [{{{network, system, :_, link, peer}, :"$1", :_}, [], [:"$1"]}]) do
      [] -> nil
      times -> Enum.max(times)
    end
  end

  @doc "The systems that an endpoint brings, with their networks; forgotten ones may be among them."
  @spec heard_by(Tables.t(), Endpoint.key()) :: [{String.t(), non_neg_integer}]
  def heard_by(tables, {link, peer}), do: tables.heard_by |> :ets.select(brought(link, peer)) |> Enum.uniq()

  @doc "The same of an endpoint that has no more than `most` routes."
  @spec heard_by(Tables.t(), Endpoint.key(), pos_integer) :: [{String.t(), non_neg_integer}] | :many
  def heard_by(tables, {link, peer}, most) do
    case :ets.select(tables.heard_by, brought(link, peer), most) do
      {found, :"$end_of_table"} -> found
      :"$end_of_table" -> []
      {_found, _more} -> :many
    end
  end

  defp brought(link, peer), do: [{{{link, peer, :"$1", :"$2", :_}}, [], [{{:"$1", :"$2"}}]}]

  @doc "Whether a component is heard by an endpoint."
  @spec talks?(Tables.t(), {String.t(), non_neg_integer, 0..255}, Endpoint.key()) :: boolean
  def talks?(tables, {network, system, component}, {link, peer}),
    do: :ets.member(tables.routes, {network, system, component, link, peer})

  @doc "The systems that are heard, and by whom, by network."
  @spec systems(Tables.t()) :: %{String.t() => [{system :: non_neg_integer, Endpoint.key()}]}
  def systems(tables) do
    tables.routes
    |> :ets.select([
      {{{:"$1", :"$2", :_, :"$3", :"$4"}, :_, :_}, [], [{{:"$1", {{:"$2", {{:"$3", :"$4"}}}}}}]}
    ])
    |> Enum.uniq()
    |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
  end

  @doc "All routes, with their ages in ms."
  @spec list(Tables.t(), integer) :: [route]
  def list(tables, now) do
    for {{network, system, component, link, peer}, heard, since} <- :ets.tab2list(tables.routes) do
      %{
        network: network,
        system: system,
        component: component,
        link: link,
        peer: peer,
        age_ms: now - heard,
        known_ms: now - since
      }
    end
  end

  @doc "Forgets the routes of a system by a link, or by one of its peers, as after its reboot there (R6)."
  @spec forget_system(Tables.t(), {String.t(), non_neg_integer}, String.t(), term) :: :ok
  def forget_system(tables, {network, system}, link, peer) do
    true = :ets.match_delete(tables.routes, {{network, system, :_, link, peer}, :_, :_})
    :ok
  end

  @doc "Forgets one route."
  @spec drop(Tables.t(), {String.t(), non_neg_integer, 0..255}, Endpoint.key()) :: :ok
  def drop(tables, {network, system, component}, {link, peer}) do
    true = :ets.delete(tables.routes, {network, system, component, link, peer})
    :ok
  end

  @doc "Forgets all routes by a link, or by one of its peers."
  @spec forget(Tables.t(), String.t(), term) :: :ok
  def forget(tables, link, peer \\ :_) do
    # Peers come and go while others are heard: their routes are found without a look at everybody else's.
    for {{link, peer, network, system, component}} = entry <-
          :ets.match_object(tables.heard_by, {{link, peer, :_, :_, :_}}) do
      :ets.delete(tables.routes, {network, system, component, link, peer})
      :ets.delete_object(tables.heard_by, entry)
    end

    :ok
  end

  @typedoc "Whether a vehicle that is not lost is reached by an endpoint at a time."
  @type needed? :: (Endpoint.key(), integer -> boolean)

  @doc """
  Forgets routes by which nothing was heard for #{div(@ttl_ms, 60_000)} minutes and no vehicle is reached; how many.
  """
  @spec sweep(Tables.t(), integer, needed?) :: non_neg_integer
  def sweep(tables, now, needed? \\ fn _endpoint, _now -> false end) do
    old = :ets.select(tables.routes, [{{:"$1", :"$2", :_}, [{:<, :"$2", now - @ttl_ms}], [:"$1"]}])

    swept =
      for {_, _, _, link, peer} = key <- old,
          not needed?.({link, peer}, now),
          do: :ets.delete(tables.routes, key)

    _ = if :ets.info(tables.heard_by, :size) > :ets.info(tables.routes, :size), do: tidy(tables)
    length(swept)
  end

  # Routes that were forgotten by system still have their entry by endpoint.
  defp tidy(tables) do
    for {{link, peer, network, system, component}} = entry <- :ets.tab2list(tables.heard_by),
        not :ets.member(tables.routes, {network, system, component, link, peer}),
        do: :ets.delete_object(tables.heard_by, entry)
  end
end
