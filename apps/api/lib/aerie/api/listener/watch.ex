defmodule Aerie.Api.Listener.Watch do
  @moduledoc "Ends when one of a listener's supervisors of connections does, so that the listener is started again."
  use GenServer, shutdown: 1_000

  @spec start_link(term()) :: GenServer.on_start()
  def start_link(ref), do: GenServer.start_link(__MODULE__, ref)

  @impl GenServer
  def init(ref) do
    Process.set_label({:listener_watch, ref})
    for {_number, pid} <- :ranch_server.get_connections_sups(ref), do: Process.monitor(pid)
    {:ok, ref}
  end

  @impl GenServer
  def handle_info({:DOWN, _monitor, :process, _pid, reason}, ref),
    do: {:stop, {:shutdown, {:connections, reason}}, ref}

  def handle_info(_other, ref), do: {:noreply, ref}
end
