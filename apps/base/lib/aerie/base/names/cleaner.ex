defmodule Aerie.Base.Names.Cleaner do
  @moduledoc """
  Removes the entries of ended processes from the tables of names. No caller waits for it: a reader that finds such an
  entry earlier sees that its process is dead. After a restart it checks all entries once.
  """
  use GenServer

  @doc "Options: `:owners` gives the processes that have entries, `:forget` removes those of one."
  @spec start_link(owners: (-> [pid()]), forget: (pid() -> :ok)) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, Map.new(options), name: __MODULE__)

  @doc "The entries of this process are removed when it ends."
  @spec watch(pid()) :: :ok
  def watch(pid), do: GenServer.cast(__MODULE__, {:watch, pid})

  @impl GenServer
  def init(%{owners: owners, forget: forget}),
    do: {:ok, %{watched: Enum.reduce(owners.(), MapSet.new(), &monitored(&2, &1)), forget: forget}}

  @impl GenServer
  def handle_cast({:watch, pid}, state), do: {:noreply, %{state | watched: monitored(state.watched, pid)}}

  @impl GenServer
  def handle_info({:DOWN, _monitor, :process, pid, _reason}, %{forget: forget} = state) do
    :ok = forget.(pid)
    {:noreply, %{state | watched: MapSet.delete(state.watched, pid)}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp monitored(watched, pid) do
    if MapSet.member?(watched, pid) do
      watched
    else
      _monitor = Process.monitor(pid)
      MapSet.put(watched, pid)
    end
  end
end
