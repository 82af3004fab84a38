defmodule MavRouter.Signing.Verifiers do
  @moduledoc """
  The `MavCodec.Signing` of each link and scope, in a table that outlives the link's process.

  Only the link's process writes those of its link. A new one goes on where the former one ended, with its time stamp (S6) and the
  last one of every stream, so that frames recorded before a restart cannot be replayed after it (S3).
  """

  alias Aerie.Base.Secret
  alias Aerie.Base.Names
  alias MavRouter.Signing.{KeyStore, Scope, Tables}
  alias MavCodec.Signing

  @max_stored 1024

  @doc "That of a link and a scope; nil when the scope has no key."
  @spec get(Names.gateway(), Tables.t(), String.t(), Scope.t()) :: Signing.t() | nil
  def get(_gateway, _tables, _link, %Scope{secret: nil}), do: nil

  def get(gateway, tables, link, %Scope{id: id, generation: generation} = scope) do
    case :ets.lookup(tables.verifiers, {link, id}) do
      [{_key, ^generation, signing}] -> signing
      # Another key: the time goes on, the streams of the old key are worth nothing.
      [{_key, _old, signing}] -> make(gateway, tables, link, scope, Signing.timestamp(signing), %{})
      [] -> restore(gateway, tables, link, scope)
    end
  end

  defp restore(gateway, tables, link, scope) do
    case :ets.lookup(tables.stored, {link, scope.id}) do
      [{_key, timestamp, streams}] -> make(gateway, tables, link, scope, timestamp, streams)
      [] -> make(gateway, tables, link, scope, latest(tables, link), %{})
    end
  end

  # A vehicle that gets a key of its own has heard time stamps under another one, and ours go on from there.
  defp latest(tables, link) do
    tables.verifiers
    |> :ets.select([{{{link, :_}, :_, :"$1"}, [], [:"$1"]}])
    |> Enum.reject(&Signing.far?/1)
    |> Enum.reduce(0, &max(Signing.timestamp(&1), &2))
  end

  @doc "Whether a frame's signature is right by a key that is not in force; the frame changes no state."
  @spec proves?(Tables.t(), String.t(), Scope.t(), MavCodec.Frame.t()) :: boolean
  def proves?(_tables, _link, %Scope{secret: nil}, _frame), do: false

  def proves?(tables, link, scope, frame) do
    clock = Tables.clock(tables)
    signing = Signing.new(Secret.reveal(scope.secret), clock: clock, stored: latest(tables, link))
    match?({:signed, _signing}, Signing.check(signing, frame))
  end

  defp make(gateway, tables, link, scope, timestamp, streams) do
    key = {link, scope.id}

    signing =
      Signing.new(Secret.reveal(scope.secret),
        link_id: link_id(tables, link),
        # A vehicle with a key of its own understands us only by its own clock, and nobody else has to follow.
        follow_far: match?({_network, system} when is_integer(system), scope.id),
        stored: timestamp,
        streams: streams,
        clock: Tables.clock(tables),
        save: &KeyStore.reserve(gateway, tables, key, &1)
      )

    put(tables, link, scope, signing)
    signing
  end

  @doc "Keeps one; called by the link's process."
  @spec put(Tables.t(), String.t(), Scope.t(), Signing.t()) :: :ok
  def put(tables, link, scope, signing) do
    :ets.insert(tables.verifiers, {{link, scope.id}, scope.generation, signing})
    :ok
  end

  @doc "Our link id on a link: each has its own, because their time stamps move independently (S2)."
  @spec link_id(Tables.t(), String.t()) :: 0..255
  def link_id(tables, link) do
    case :ets.lookup(tables.settings, {:link_id, link}) do
      [{_key, number}] ->
        number

      [] ->
        number = :ets.update_counter(tables.settings, :next_link_id, 1, {:next_link_id, -1})
        :ets.insert_new(tables.settings, {{:link_id, link}, rem(number, 256)})
        :ets.lookup_element(tables.settings, {:link_id, link}, 2)
    end
  end

  @doc "The present time stamp for a link and a scope, not below any that was used; it is not used up."
  @spec timestamp(Tables.t(), String.t(), Scope.t() | nil) :: Signing.timestamp()
  def timestamp(tables, link, scope) do
    clock = Tables.clock(tables)
    now = Signing.timestamp(Signing.new(<<0::256>>, clock: clock))

    case scope && :ets.lookup(tables.verifiers, {link, scope.id}) do
      [{_key, _generation, signing}] -> max(now, Signing.timestamp(signing))
      _none -> max(now, latest(tables, link))
    end
  end

  @doc "A link was removed: the time stamps of its streams are kept."
  @spec forget(Tables.t(), String.t()) :: :ok
  def forget(tables, link) do
    for {{^link, id} = key, _generation, signing} <- :ets.tab2list(tables.verifiers) do
      if :ets.info(tables.stored, :size) < @max_stored,
        do: :ets.insert(tables.stored, {key, Signing.timestamp(signing), Signing.streams(signing)})

      :ets.delete(tables.verifiers, {link, id})
    end

    true = :ets.match_delete(tables.bursts, {{link, :_, :_}, :_})
    true = :ets.match_delete(tables.announced, {{link, :_, :_}, :_})
    true = :ets.match_delete(tables.proven, {{link, :_}, :_})
    :ok
  end
end
