defmodule Aerie.Base.Names.Book do
  @moduledoc """
  The tables behind `Aerie.Base.Names` and the subscriptions of change notices: which process has which key.

  Unlike with Elixir's `Registry`, no process depends on another here. The tables belong to the top supervisor of the application,
  which runs no code; entries are made by the registered process itself, which is linked to nobody; and an entry of a dead process counts
  as none, whether `Aerie.Base.Names.Cleaner` has removed it yet or not. So the cleaner may die at any time.
  """

  alias Aerie.Base.Names.Cleaner

  # Rows: {key, pid, value}. A key has one owner in @names, any number in @topics.
  @names Aerie.Base.Names
  @topics Aerie.Base.Names.Topics
  # {pid, table, key}
  @owned __MODULE__

  @type key :: term()

  @doc "Makes the tables, which belong to the calling process."
  @spec create() :: :ok
  def create do
    shared = [:named_table, :public, read_concurrency: true]
    _ = :ets.new(@names, [:set | shared])
    _ = :ets.new(@topics, [:duplicate_bag | shared])
    _ = :ets.new(@owned, [:bag | shared])
    :ok
  end

  @doc "Gives the calling process a key that no other living process has, with a value."
  @spec register(key(), term()) :: :ok | {:error, {:already_registered, pid()}}
  def register(key, value) do
    if :ets.insert_new(@names, {key, self(), value}), do: own(@names, key), else: taken(key, value)
  end

  defp taken(key, value) do
    case :ets.lookup(@names, key) do
      [{_key, pid, _value} = row] ->
        if Process.alive?(pid) do
          {:error, {:already_registered, pid}}
        else
          true = :ets.delete_object(@names, row)
          register(key, value)
        end

      [] ->
        register(key, value)
    end
  end

  # After the entry: a cleaner that starts meanwhile finds it in the tables, a running one gets a message.
  defp own(table, key) do
    true = :ets.insert(@owned, {self(), table, key})
    Cleaner.watch(self())
  end

  @doc "Ends what `register/2` began, if the calling process has the key."
  @spec unregister(key()) :: :ok
  def unregister(key), do: remove(self(), @names, key)

  @doc "Replaces the value of a key of the calling process."
  @spec put_value(key(), term()) :: :ok
  def put_value(key, value) do
    owner = self()
    [{_key, ^owner, _old}] = :ets.lookup(@names, key)
    true = :ets.update_element(@names, key, {3, value})
    :ok
  end

  @doc "The living process that has a key, and its value."
  @spec lookup(key()) :: {pid(), term()} | nil
  def lookup(key) do
    with [{_key, pid, value}] <- :ets.lookup(@names, key), true <- Process.alive?(pid) do
      {pid, value}
    else
      _free -> nil
    end
  end

  @doc "The keys that a match specification's head and conditions choose: `{key, pid, value}` of each."
  @spec rows(term(), [term()]) :: [{key(), pid(), term()}]
  def rows(key, conditions),
    do:
      for(
        {_, pid, _} = row <- :ets.select(@names, [{{key, :_, :_}, conditions, [:"$_"]}]),
        Process.alive?(pid),
        do: row
      )

  @doc "The names of a process."
  @spec keys(pid()) :: [key()]
  def keys(pid), do: for({_pid, @names, key} <- :ets.lookup(@owned, pid), do: key)

  @doc "Adds the calling process to a topic."
  @spec join(key(), term()) :: :ok
  def join(topic, value) do
    true = :ets.insert(@topics, {topic, self(), value})
    own(@topics, topic)
  end

  @doc "Takes the calling process out of a topic."
  @spec leave(key()) :: :ok
  def leave(topic), do: remove(self(), @topics, topic)

  @doc "The processes in a topic, each with its value."
  @spec members(key()) :: [{pid(), term()}]
  def members(topic), do: for({_topic, pid, value} <- :ets.lookup(@topics, topic), do: {pid, value})

  @doc "The processes with an entry, dead or alive."
  @spec owners() :: [pid()]
  def owners, do: Enum.uniq(:ets.select(@owned, [{{:"$1", :_, :_}, [], [:"$1"]}]))

  @doc "Removes all entries of a process."
  @spec forget(pid()) :: :ok
  def forget(pid),
    do: Enum.each(:ets.lookup(@owned, pid), fn {_pid, table, key} -> remove(pid, table, key) end)

  # By the rows found, because a key may be any term, even one that a pattern takes for a variable.
  defp remove(pid, table, key) do
    for {_key, ^pid, _value} = row <- :ets.lookup(table, key), do: :ets.delete_object(table, row)
    true = :ets.delete_object(@owned, {pid, table, key})
    :ok
  end

  # The callbacks of a `:via` name.

  @doc false
  @spec register_name(key(), pid()) :: :yes | :no
  def register_name(key, pid) when pid == self(), do: if(register(key, nil) == :ok, do: :yes, else: :no)

  @doc false
  @spec unregister_name(key()) :: :ok
  def unregister_name(key), do: unregister(key)

  @doc false
  @spec whereis_name(key()) :: pid() | :undefined
  def whereis_name(key) do
    case lookup(key) do
      {pid, _value} -> pid
      nil -> :undefined
    end
  end

  @doc false
  @spec send(key(), term()) :: pid()
  def send(key, message) do
    case lookup(key) do
      {pid, _value} ->
        Kernel.send(pid, message)
        pid

      nil ->
        exit({:badarg, {key, message}})
    end
  end
end
