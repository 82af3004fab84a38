defmodule Aerie.Names do
  @moduledoc """
  Where every process of a gateway instance is found.

  Several gateways can live in one node (tests start one each), so no process has a global name: each is registered in
  `Aerie.Registry` under `{gateway, role, id}`, where `gateway` is the instance's name (any term), `role` an atom that
  says what the process does and `id` tells processes of one role apart (`nil` when there is only one).

  | role             | id                     | process                              |
  |------------------|------------------------|--------------------------------------|
  | `:gateway`       | nil                    | `Aerie.Gateway` supervisor           |
  | `:store`         | nil                    | `Aerie.Store`                  |
  | `:pubsub`        | nil                    | `Aerie.Store.PubSub`                 |
  | `:vehicles`      | nil                    | `Aerie.Vehicle.Supervisor`           |
  | `:vehicle_trees` | nil                    | its dynamic supervisor               |
  | `:tree`          | `{network, system_id}` | `Aerie.Vehicle.Tree`                 |
  | `:session`       | `{network, system_id}` | `Aerie.Vehicle.Session`              |
  | `:events`        | `{network, system_id}` | `Aerie.Vehicle.Events`               |
  | `:pulse`         | nil                    | `Aerie.Identity.Pulse`       |

  | `:clients`       | nil                    | `Aerie.Client.Supervisor`            |
  | `:websocket_client`, `:unix_client` | the endpoint's id | of one client     |

  Links, router and bridge add their own roles.
  """

  @type gateway :: term()
  @type role :: atom()

  @doc "The `:via` name to start or call a process by."
  @spec via(gateway(), role(), term()) :: {:via, module(), term()}
  def via(gateway, role, id \\ nil), do: {:via, Registry, {Aerie.Registry, {gateway, role, id}}}

  @doc "The process registered under a role, or nil when there is none just now."
  @spec whereis(gateway(), role(), term()) :: pid() | nil
  def whereis(gateway, role, id \\ nil) do
    # A dead process stays registered for a moment; its name is free already.
    case Registry.whereis_name({Aerie.Registry, {gateway, role, id}}) do
      :undefined -> nil
      pid -> pid
    end
  end

  @doc "Registers the calling process, which somebody else started (Cowboy, say)."
  @spec register(gateway(), role(), term()) :: :ok | {:error, :taken}
  def register(gateway, role, id) do
    case Registry.register(Aerie.Registry, {gateway, role, id}, nil) do
      {:ok, _owner} -> changed()
      {:error, {:already_registered, _pid}} -> {:error, :taken}
    end
  end

  @doc "How many processes have a role. Looks at all names: not for every frame."
  @spec count(gateway(), role()) :: non_neg_integer()
  def count(gateway, role) do
    Registry.count_select(Aerie.Registry, [
      {{{:"$1", role, :_}, :_, :_}, [{:"=:=", :"$1", {:const, gateway}}], [true]}
    ])
  end

  @doc "The processes that have a role. Looks at all names, as `count/2`."
  @spec processes(gateway(), role()) :: [pid()]
  def processes(gateway, role) do
    Registry.select(Aerie.Registry, [
      {{{:"$1", role, :_}, :"$2", :_}, [{:"=:=", :"$1", {:const, gateway}}], [:"$2"]}
    ])
  end

  @doc """
  Attaches a value to the name that the calling process has, for others to read with `value/3` without a call.
  """
  @spec put_value(gateway(), role(), term(), term()) :: :ok
  def put_value(gateway, role, id \\ nil, value) do
    {_new, _old} = Registry.update_value(Aerie.Registry, {gateway, role, id}, fn _old -> value end)
    # After it is there, so that nobody remembers the old one under the new number.
    changed()
  end

  @doc "A number that has moved whenever a value was attached to a name, or a process told that it took a name."
  @spec epoch() :: non_neg_integer()
  def epoch, do: :atomics.get(:persistent_term.get(__MODULE__), 1)

  @doc "Tells that the calling process took a name by `via/3` that others may remember to be nobody's."
  @spec changed() :: :ok
  def changed, do: :atomics.add(:persistent_term.get(__MODULE__), 1, 1)

  @doc "The value a process attached to its name, or nil."
  @spec value(gateway(), role(), term()) :: term() | nil
  def value(gateway, role, id \\ nil) do
    case Registry.lookup(Aerie.Registry, {gateway, role, id}) do
      [{_pid, value}] -> value
      [] -> nil
    end
  end

  @doc """
  The same as `value/2` for who asks with every frame: the calling process remembers it (in its dictionary) for as long as
  its owner lives and nobody attached a value to any name, so that asking costs neither a look at a table nor a copy.
  """
  @spec held(gateway(), role()) :: term() | nil
  def held(gateway, role) do
    epoch = epoch()
    key = {__MODULE__, role, gateway}

    case :erlang.get(key) do
      {^epoch, nil, nil} -> nil
      {^epoch, owner, value} -> if Process.alive?(owner), do: value, else: hold(gateway, role, key, epoch)
      _old_or_none -> hold(gateway, role, key, epoch)
    end
  end

  defp hold(gateway, role, key, epoch) do
    {owner, value} =
      case Registry.lookup(Aerie.Registry, {gateway, role, nil}) do
        # A name without a value yet: its owner is just starting.
        [{_owner, nil}] -> {nil, nil}
        [found] -> found
        [] -> {nil, nil}
      end

    Process.put(key, {epoch, owner, value})
    value
  end

  @doc false
  # What `held/2` compares with; made once, before there is any name.
  @spec prepare() :: :ok
  def prepare, do: :persistent_term.put(__MODULE__, :atomics.new(1, signed: false))

  @doc """
  What `fun` makes of the value that a process attached to its name, usually an ETS table of its own; `absent` when
  there is none, or when it was gone before `fun` had read it (an `ArgumentError`).
  """
  @spec with_value(gateway(), role(), absent, (term() -> result)) :: absent | result
        when absent: term(), result: term()
  def with_value(gateway, role, absent, fun) do
    case value(gateway, role) do
      nil -> absent
      found -> fun.(found)
    end
  rescue
    # The process ended with its table in between.
    ArgumentError -> absent
  end
end
