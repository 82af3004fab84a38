defmodule Aerie.Base.Names do
  @moduledoc """
  Finds the processes of a gateway.

  One node can have several gateways (tests start one each), so no process has a global name. Each is registered in
  `Aerie.Base.Names.Book` under `{gateway, role, id}`: the gateway's name (any term), an atom for what the process does,
  and what tells processes of one role apart (`nil` when there is only one).
  """

  alias Aerie.Base.Names.Book

  @type gateway :: term()
  @type role :: atom()

  @doc "The `:via` name to start or call a process by."
  @spec via(gateway(), role(), term()) :: {:via, module(), term()}
  def via(gateway, role, id \\ nil), do: {:via, Book, {gateway, role, id}}

  @doc "The process registered under a role, or nil when there is none just now."
  @spec whereis(gateway(), role(), term()) :: pid() | nil
  def whereis(gateway, role, id \\ nil),
    do: with({pid, _value} <- Book.lookup({gateway, role, id}), do: pid)

  @doc "Registers the calling process, for processes that we do not start ourselves (Cowboy's, for example)."
  @spec register(gateway(), role(), term()) :: :ok | {:error, :taken}
  def register(gateway, role, id) do
    case Book.register({gateway, role, id}, nil) do
      :ok -> changed()
      {:error, {:already_registered, _pid}} -> {:error, :taken}
    end
  end

  @doc "The processes that have a role. Looks at all names, so it is not for every frame."
  @spec processes(gateway(), role()) :: [pid()]
  def processes(gateway, role), do: for({_id, pid, _value} <- all(gateway, role), do: pid)

  @doc "The same, each with its id and the value of its name."
  @spec all(gateway(), role()) :: [{id :: term(), pid(), value :: term()}]
  def all(gateway, role) do
    for {{_gateway, _role, id}, pid, value} <-
          Book.rows({:"$1", role, :_}, [{:"=:=", :"$1", {:const, gateway}}]),
        do: {id, pid, value}
  end

  @doc "The roles that a process has in a gateway, each with its id."
  @spec roles(gateway(), pid()) :: [{role(), id :: term()}]
  def roles(gateway, pid), do: for({^gateway, role, id} <- Book.keys(pid), do: {role, id})

  @doc """
  Attaches a value to the name that the calling process has, for others to read with `value/3` without a call.
  """
  @spec put_value(gateway(), role(), term(), term()) :: :ok
  def put_value(gateway, role, id \\ nil, value) do
    :ok = Book.put_value({gateway, role, id}, value)
    # Afterwards, so that nobody remembers the old value under the new number.
    changed()
  end

  @doc "A number that moves when a value is attached to a name, or when a process calls `changed/0`."
  @spec epoch() :: non_neg_integer()
  def epoch, do: :atomics.get(:persistent_term.get(__MODULE__), 1)

  @doc "The calling process took a name by `via/3` that others may remember to be free."
  @spec changed() :: :ok
  def changed, do: :atomics.add(:persistent_term.get(__MODULE__), 1, 1)

  @doc "The value a process attached to its name, or nil."
  @spec value(gateway(), role(), term()) :: term() | nil
  def value(gateway, role, id \\ nil) do
    with {_pid, value} <- Book.lookup({gateway, role, id}), do: value
  end

  @doc """
  Applies `fun` to the value that a process attached to its name, usually its table. Returns `absent` if there is none,
  or if the process ended with its table before `fun` read it; so `fun` must only read.
  """
  @spec read(gateway(), role(), absent, (term() -> result)) :: absent | result
        when absent: term(), result: term()
  def read(gateway, role, absent, fun) do
    case Book.lookup({gateway, role, nil}) do
      {owner, value} when value != nil -> read_of(owner, value, absent, fun)
      _none -> absent
    end
  end

  defp read_of(owner, value, absent, fun) do
    fun.(value)
  rescue
    error in ArgumentError ->
      if Process.alive?(owner), do: reraise(error, __STACKTRACE__), else: absent
  end

  @doc """
  The same as `put_value/3`, for a value that processes read with every frame, by `held/2`, and that its owner attaches
  once: a map of tables, say. Replacing it costs every process that has read it a garbage collection.
  """
  @spec put_held(gateway(), role(), term()) :: :ok
  def put_held(gateway, role, value) do
    put_value(gateway, role, value)
    :persistent_term.put({__MODULE__, gateway, role}, {self(), value})
  end

  @doc "A value of `put_held/3` whose owner lives, or nil. Reading it copies nothing and waits for nobody."
  @spec held(gateway(), role()) :: term() | nil
  def held(gateway, role) do
    case :persistent_term.get({__MODULE__, gateway, role}, nil) do
      {owner, value} -> if Process.alive?(owner), do: value, else: value(gateway, role)
      # There is none, or it is just being cleaned up after the owner before.
      nil -> value(gateway, role)
    end
  end

  @doc false
  # The remains of an ended process.
  @spec forget(pid()) :: :ok
  def forget(pid) do
    for {gateway, role, nil} <- Book.keys(pid), do: forget_held({__MODULE__, gateway, role}, pid)
    Book.forget(pid)
  end

  defp forget_held({_names, gateway, role} = key, pid) do
    with {^pid, _value} <- :persistent_term.get(key, nil) do
      :persistent_term.erase(key)
      # Its successor may have attached its value just before.
      with {owner, value} when owner != pid and value != nil <- Book.lookup({gateway, role, nil}),
           do: :persistent_term.put(key, {owner, value})
    end
  end

  @doc false
  # The tables, which belong to the calling process, and the number of `epoch/0`; made once, before there is any name.
  @spec prepare() :: :ok
  def prepare do
    :ok = Book.create()
    :persistent_term.put(__MODULE__, :atomics.new(1, signed: false))
  end
end
