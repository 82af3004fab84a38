defmodule Aerie.Names.Cleaner do
  @moduledoc """
  Removes the entries of ended processes from `Aerie.Names.Book`. Nobody waits for it: whoever meets such an entry before sees that its
  process is dead. If it is restarted it looks at all entries once.
  """
  use GenServer

  alias Aerie.Names.Book

  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(_options), do: GenServer.start_link(__MODULE__, nil, name: __MODULE__)

  @doc "The entries of this process are removed when it ends."
  @spec watch(pid()) :: :ok
  def watch(pid), do: GenServer.cast(__MODULE__, {:watch, pid})

  @impl GenServer
  def init(nil), do: {:ok, Enum.reduce(Book.owners(), MapSet.new(), &monitored(&2, &1))}

  @impl GenServer
  def handle_cast({:watch, pid}, watched), do: {:noreply, monitored(watched, pid)}

  @impl GenServer
  def handle_info({:DOWN, _monitor, :process, pid, _reason}, watched) do
    :ok = Book.forget(pid)
    {:noreply, MapSet.delete(watched, pid)}
  end

  def handle_info(_other, watched), do: {:noreply, watched}

  defp monitored(watched, pid) do
    if MapSet.member?(watched, pid) do
      watched
    else
      _monitor = Process.monitor(pid)
      MapSet.put(watched, pid)
    end
  end
end
