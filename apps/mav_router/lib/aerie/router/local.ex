defmodule Aerie.Router.Local do
  @moduledoc """
  What one forwarding process keeps for itself between two reads: the plan, and the talkers that it hears.

  It stands in the process dictionary, because frames are delivered by a plain function in processes that know nothing of
  the router (links, WebSockets). It is a cache and nothing else: everything in it comes from the router's tables, and it
  is thrown away with them.
  """

  alias Aerie.Names
  alias Aerie.Router.Early
  alias Aerie.Router.Plan
  alias Aerie.Router.Tables
  alias Aerie.Router.Talker

  # Invented ids must not fill the memory.
  @max_talkers 2_048

  @enforce_keys [:tables, :plan]
  defstruct [:tables, :plan, talkers: %{}, early: Early.new()]

  @typedoc "`tables`: the `id` of the tables that it comes from; `early`: texts of who is no vehicle yet"
  @type t :: %__MODULE__{tables: reference, plan: Plan.t(), talkers: %{term => Talker.t()}, early: Early.t()}

  @doc "The cache of the calling process, with a plan that holds now."
  @spec fetch(Names.gateway(), Tables.t()) :: t
  def fetch(gateway, tables) do
    generation = Tables.generation(tables)

    case :erlang.get({__MODULE__, gateway}) do
      %__MODULE__{tables: ref, plan: %{generation: ^generation}} = local when ref == tables.id ->
        local

      %__MODULE__{tables: ref} = local when ref == tables.id ->
        put(gateway, %{local | plan: Plan.refresh(local.plan, tables)})

      _none ->
        put(gateway, %__MODULE__{tables: tables.id, plan: Plan.read(tables)})
    end
  end

  @doc "Keeps it."
  @spec put(Names.gateway(), t) :: t
  def put(gateway, local) do
    Process.put({__MODULE__, gateway}, local)
    local
  end

  @doc "A talker by its endpoint's key and ids."
  @spec talker(t, term, non_neg_integer, 0..255) :: Talker.t()
  def talker(local, key, system, component) do
    case local.talkers do
      %{{^key, ^system, ^component} => talker} -> talker
      _new -> Talker.new(system, component)
    end
  end

  @doc "Keeps a talker."
  @spec put_talker(t, term, Talker.t()) :: t
  def put_talker(local, key, talker) do
    talkers = if map_size(local.talkers) >= @max_talkers, do: %{}, else: local.talkers
    %{local | talkers: Map.put(talkers, {key, talker.system, talker.component}, talker)}
  end

  @doc "Holds the texts among frames of a system that has no session."
  @spec hold(Names.gateway(), term, [MavCodec.Frame.t()]) :: :ok
  def hold(gateway, key, frames) do
    case Process.get({__MODULE__, gateway}) do
      %__MODULE__{early: early} = local ->
        _ = put(gateway, %{local | early: Early.hold(early, key, frames)})
        :ok

      _none ->
        :ok
    end
  end

  @doc "Takes what is held of a system whose session is there now, given the frame that called it in."
  @spec held(Names.gateway(), term, MavCodec.Frame.t()) :: [MavCodec.Frame.t()]
  def held(gateway, key, %{at: now}) do
    with %__MODULE__{early: early} = local when is_map_key(early, key) <- Process.get({__MODULE__, gateway}) do
      {frames, early} = Early.take(early, key, now)
      _ = put(gateway, %{local | early: early})
      frames
    else
      _nothing -> []
    end
  end

  @doc "Keeps a talker of which something was found out after `put_talker/3`."
  @spec update_talker(Names.gateway(), term, Talker.t()) :: :ok
  def update_talker(gateway, key, talker) do
    # Not there: thrown away meanwhile, with its tables.
    with %__MODULE__{} = local <- Process.get({__MODULE__, gateway}),
         do: put(gateway, put_talker(local, key, talker))

    :ok
  end
end
