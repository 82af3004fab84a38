defmodule MavRouter.Endpoints do
  @moduledoc """
  All endpoints and the rules of their owners, in the router's tables. Every change moves the generation, so that every
  forwarding process sees it with its next frame.
  """

  alias Aerie.Base.{Error, Names}
  alias MavRouter.Identity
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Routes
  alias MavRouter.Endpoints.Owner.SavedRules
  alias MavRouter.Tables
  alias MavRouter.Endpoints.Monitor

  @max_listeners 32
  @max_unknown 8

  @doc "Adds an owner's rules, or replaces them."
  @spec put_owner(Tables.t(), Owner.t()) :: :ok
  def put_owner(tables, %Owner{} = owner) do
    insert_owner(tables, owner)
    Tables.changed(tables)
  end

  # A client of all networks sees them in the order in which they came.
  defp insert_owner(tables, %Owner{id: id} = owner) do
    names = if owner.side == :vehicle and is_list(owner.networks), do: owner.networks, else: []

    Enum.each(
      names,
      &:ets.insert_new(tables.settings, {{:network, &1}, :erlang.unique_integer([:monotonic])})
    )

    :ets.insert(tables.owners, {id, owner})
  end

  defp delete_owner(tables, id) do
    :ets.delete(tables.settings, {:starts, id})

    case :ets.take(tables.owners, id) do
      [{^id, %Owner{networks: names}}] when is_list(names) ->
        kept =
          for {_id, %Owner{networks: kept}} <- :ets.tab2list(tables.owners),
              is_list(kept),
              name <- kept,
              do: name

        Enum.each(names -- kept, &:ets.delete(tables.settings, {:network, &1}))

      _none ->
        :ok
    end
  end

  @doc "Whether these are networks of the gateway: its own, or one that a link has. The error names those that there are."
  @spec known_networks(Tables.t(), [String.t()]) :: :ok | {:error, Error.t()}
  def known_networks(tables, names) do
    of_links =
      for {_id, %Owner{side: :vehicle, networks: [_ | _] = networks}} <- :ets.tab2list(tables.owners),
          name <- networks,
          do: name

    # Links may be added to the gateway's own later.
    known = Enum.uniq([Tables.setting(tables, :network, Identity.default_network()) | of_links])

    case names -- known do
      [] ->
        :ok

      [stray | _] ->
        Error.new(
          {:invalid,
           "unknown network #{inspect(String.slice(stray, 0, 64))}; known: #{Enum.join(Enum.sort(known), ", ")}"}
        )
    end
  end

  @doc "An owner's rules, nil for an unknown one."
  @spec owner(Tables.t(), String.t()) :: Owner.t() | nil
  def owner(tables, id), do: :ets.lookup_element(tables.owners, id, 2, nil)

  @doc "Adds an owner with its one endpoint; an error when a live process has the id."
  @spec attach(Names.gateway(), Tables.t(), Owner.t(), Endpoint.t()) :: :ok | {:error, String.t()}
  def attach(gateway, tables, %Owner{id: id} = owner, endpoint) do
    taken? = Enum.any?(of(tables, id), &(&1.pid != endpoint.pid and Process.alive?(&1.pid)))

    if taken? or Names.whereis(gateway, :link, id) not in [nil, endpoint.pid] do
      {:error, "there is an endpoint #{id} already"}
    else
      put(gateway, tables, endpoint)
      put_owner(tables, owner)
    end
  end

  @doc "Adds an endpoint, or replaces the one with its key."
  @spec put(Names.gateway(), Tables.t(), Endpoint.t()) :: :ok
  def put(gateway, tables, %Endpoint{key: key} = endpoint) do
    :ets.insert(tables.endpoints, {key, endpoint})
    Monitor.monitor(gateway, endpoint.pid)
    Tables.changed(tables, key)
  end

  @doc "An endpoint, nil for an unknown one."
  @spec get(Tables.t(), Endpoint.key()) :: Endpoint.t() | nil
  def get(tables, key), do: :ets.lookup_element(tables.endpoints, key, 2, nil)

  @doc """
  Whether one more endpoint of a link to vehicles that is not a vehicle's may get broadcasts: #{@max_listeners} of each link whose
  heartbeat said what they are (`:said`: ground stations, cameras), #{@max_unknown} of which nothing is known yet (`:unknown`). So
  neither vehicles whose heartbeat has not come yet nor a thousand made-up senders multiply the traffic of the link. Frames with
  their id as target reach all of them; the peers of a client endpoint are as many as its rules allow.
  """
  @spec listens?(Tables.t(), Owner.t(), :said | :unknown) :: boolean
  def listens?(_tables, %Owner{side: :client}, _what), do: true

  def listens?(tables, %Owner{id: id}, what) do
    one = {{{id, :_}, %{heard_vehicle: false, listens: true}}, [], [true]}
    :ets.select_count(tables.endpoints, [one]) < if(what == :said, do: @max_listeners, else: @max_unknown)
  end

  @doc "All endpoints."
  @spec list(Tables.t()) :: [Endpoint.t()]
  def list(tables), do: :ets.select(tables.endpoints, [{{:_, :"$1"}, [], [:"$1"]}])

  @doc "The endpoints of one owner."
  @spec of(Tables.t(), String.t()) :: [Endpoint.t()]
  def of(tables, owner), do: :ets.select(tables.endpoints, [{{{owner, :_}, :"$1"}, [], [:"$1"]}])

  @doc "Removes an endpoint and its routes."
  @spec remove(Tables.t(), Endpoint.key()) :: :ok
  def remove(tables, {owner, peer} = key) do
    case :ets.take(tables.endpoints, key) do
      [{_key, endpoint}] ->
        limits_of(tables, key)
        :ets.delete(tables.scores, {:heartbeat, key})
        Tables.changed(tables, key)
        forget_requests(tables, endpoint)

      [] ->
        :ok
    end

    Routes.forget(tables, owner, peer)
  end

  defp forget_requests(%{requests: nil}, _endpoint), do: :ok

  defp forget_requests(%{requests: requests}, endpoint),
    do: requests.forget(endpoint.gateway, {:endpoint, endpoint.key})

  @doc "Removes an owner with all its endpoints and routes."
  @spec close(Names.gateway(), Tables.t(), String.t()) :: :ok
  def close(gateway, tables, owner) do
    SavedRules.forget(gateway, owner)
    for endpoint <- of(tables, owner), do: remove(tables, endpoint.key)
    delete_owner(tables, owner)
    Routes.forget(tables, owner)
    for name <- [:score, :rtt], do: :ets.delete(tables.scores, {name, owner})
    Tables.changed(tables)
  end

  @doc "Removes the endpoints of a process that ended."
  @spec down(Tables.t(), pid) :: :ok
  def down(tables, pid) do
    for endpoint <- list(tables), endpoint.pid == pid do
      remove(tables, endpoint.key)
      {owner, peer} = endpoint.key

      if peer == :self do
        delete_owner(tables, owner)
        Tables.changed(tables)
        SavedRules.forget(endpoint.gateway, owner)
      end
    end

    :ok
  end

  @doc """
  Notes what was found out about an endpoint: `side:` (nil: its owner's), `heard_vehicle:`, `listens:`, `high_latency:`. What is
  known already does not move the generation.
  """
  @spec note(Tables.t(), Endpoint.key(), keyword) :: :ok
  def note(tables, key, fields) do
    with %Endpoint{} = endpoint <- get(tables, key),
         noted when noted != endpoint <- struct!(endpoint, fields) do
      :ets.insert(tables.endpoints, {key, noted})
      Tables.changed(tables, key)
    else
      _gone_or_known -> :ok
    end
  end

  defp limits_of(tables, key), do: :ets.match_delete(tables.limits, {{key, :_, :_, :_}, :_})
end
