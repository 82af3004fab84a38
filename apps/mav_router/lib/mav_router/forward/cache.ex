defmodule MavRouter.Forward.Cache do
  @moduledoc """
  What one forwarding process keeps between two reads: the forwarding table, the sources that it hears, and texts of systems
  that are not vehicles yet. A value, which the process gives to `MavRouter.Router.deliver/4` and gets back; nil before the first read.

  All of it but the texts comes from the router's tables, and all of it goes with them.
  """

  alias MavRouter.Forward.Cache.EarlyTexts
  alias MavRouter.Forward.Delivery
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Forward.Table
  alias MavRouter.Forward.Source
  alias MavRouter.Tables
  alias Aerie.Base.Names
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

  @doc "Brings a cache up to date with the tables; makes one if there is none of these tables."
  @spec refresh(t() | nil, Tables.t()) :: t
  def refresh(cache, tables) do
    generation = Tables.generation(tables)

    case cache do
      %__MODULE__{tables: id, forwarding: %{generation: ^generation}} when id == tables.id ->
        cache

      %__MODULE__{tables: id} when id == tables.id ->
        %{cache | forwarding: Table.refresh(cache.forwarding, tables)}

      _none ->
        %__MODULE__{tables: tables.id, forwarding: Table.read(tables)}
    end
  end

  @doc "A delivery of frames that an endpoint sent before; nil when the endpoint is gone."
  @spec delivery(t, Names.gateway(), Tables.t(), Endpoint.key()) :: Delivery.t() | nil
  def delivery(%{forwarding: forwarding}, gateway, tables, key) do
    with %{^key => path} <- forwarding.paths do
      now = :erlang.monotonic_time(:millisecond)
      %Delivery{gateway: gateway, tables: tables, forwarding: forwarding, path: path, now: now}
    else
      _gone -> nil
    end
  end

  @doc "A source by the key of its endpoint and its ids; a new one if it is not known."
  @spec source(t, term, non_neg_integer, 0..255) :: Source.t()
  def source(cache, key, system, component) do
    case cache.sources do
      %{{^key, ^system, ^component} => source} -> source
      _new -> Source.new(system, component)
    end
  end

  @doc "Keeps a source."
  @spec put_source(t, term, Source.t()) :: t
  def put_source(cache, key, source) do
    sources = if map_size(cache.sources) >= @max_sources, do: %{}, else: cache.sources
    %{cache | sources: Map.put(sources, {key, source.system, source.component}, source)}
  end

  @doc "Holds the texts among the frames of a system that has no session."
  @spec hold(t, term, [Frame.t()]) :: t
  def hold(cache, key, frames), do: %{cache | early_texts: EarlyTexts.hold(cache.early_texts, key, frames)}

  @doc "Takes the texts that are held of a system that has a session now; `frame` is the one by which it was found."
  @spec take_held(t, term, frame :: Frame.t()) :: {[Frame.t()], t}
  def take_held(%{early_texts: texts} = cache, key, %{at: now}) when is_map_key(texts, key) do
    {frames, texts} = EarlyTexts.take(texts, key, now)
    {frames, %{cache | early_texts: texts}}
  end

  def take_held(cache, _key, _frame), do: {[], cache}
end
