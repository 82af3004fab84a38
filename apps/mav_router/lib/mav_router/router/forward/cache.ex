defmodule MavRouter.Router.Forward.Cache do
  @moduledoc """
  What one forwarding process keeps between two reads: the forwarding table, the sources that it hears, and texts of systems
  that are no vehicles yet.

  It is in the process dictionary, because frames are delivered by a plain function in processes that know nothing of the
  router (links, WebSockets). All of it but the texts comes from the router's tables, and all of it goes with them.
  """

  alias Aerie.Base.Names
  alias MavRouter.Router.Admission.EarlyTexts
  alias MavRouter.Router.Forward.Table
  alias MavRouter.Router.Forward.Source
  alias MavRouter.Router.Tables
  alias MavCodec.Frame

  # Invented ids must not fill the memory.
  @max_sources 2_048

  @enforce_keys [:tables, :forwarding]
  defstruct [:tables, :forwarding, sources: %{}, early_texts: EarlyTexts.new()]

  @typedoc "`tables`: the `id` of the tables that it was read from"
  @type t :: %__MODULE__{
          tables: reference,
          forwarding: Table.t(),
          sources: %{term => Source.t()},
          early_texts: EarlyTexts.t()
        }

  @doc "The cache of the calling process, with a forwarding table that is up to date."
  @spec fetch(Names.gateway(), Tables.t()) :: t
  def fetch(gateway, tables) do
    generation = Tables.generation(tables)

    case :erlang.get({__MODULE__, gateway}) do
      %__MODULE__{tables: id, forwarding: %{generation: ^generation}} = cache when id == tables.id ->
        cache

      %__MODULE__{tables: id} = cache when id == tables.id ->
        put(gateway, %{cache | forwarding: Table.refresh(cache.forwarding, tables)})

      _none ->
        put(gateway, %__MODULE__{tables: tables.id, forwarding: Table.read(tables)})
    end
  end

  defp put(gateway, cache) do
    Process.put({__MODULE__, gateway}, cache)
    cache
  end

  @doc "A source by the key of its endpoint and its ids; a new one if it is not known."
  @spec source(t, term, non_neg_integer, 0..255) :: Source.t()
  def source(cache, key, system, component) do
    case cache.sources do
      %{{^key, ^system, ^component} => source} -> source
      _new -> Source.new(system, component)
    end
  end

  @doc "Keeps a source in the cache that was fetched for it."
  @spec put_source(Names.gateway(), t, term, Source.t()) :: t
  def put_source(gateway, cache, key, source) do
    sources = if map_size(cache.sources) >= @max_sources, do: %{}, else: cache.sources
    put(gateway, %{cache | sources: Map.put(sources, {key, source.system, source.component}, source)})
  end

  @doc "Keeps what was found out about a source after `put_source/4`."
  @spec update_source(Names.gateway(), term, Source.t()) :: :ok
  def update_source(gateway, key, source) do
    # The cache may have gone with its tables meanwhile.
    with %__MODULE__{} = cache <- Process.get({__MODULE__, gateway}),
         do: put_source(gateway, cache, key, source)

    :ok
  end

  @doc "Holds the texts among the frames of a system that has no session."
  @spec hold(Names.gateway(), term, [Frame.t()]) :: :ok
  def hold(gateway, key, frames) do
    with %__MODULE__{early_texts: texts} = cache <- Process.get({__MODULE__, gateway}),
         do: put(gateway, %{cache | early_texts: EarlyTexts.hold(texts, key, frames)})

    :ok
  end

  @doc "Takes the texts that are held of a system that has a session now; `frame` is the one by which it was found."
  @spec held(Names.gateway(), term, frame :: Frame.t()) :: [Frame.t()]
  def held(gateway, key, %{at: now}) do
    with %__MODULE__{early_texts: texts} = cache when is_map_key(texts, key) <-
           Process.get({__MODULE__, gateway}) do
      {frames, texts} = EarlyTexts.take(texts, key, now)
      _ = put(gateway, %{cache | early_texts: texts})
      frames
    else
      _nothing -> []
    end
  end
end
