defmodule MavRouter.Router.Admission.VehicleStarter do
  @every_ms 10
  @at_most_ms 250

  @moduledoc """
  Starts vehicles one after the other when many are heard at once, so that no link has to do it while frames of its other
  vehicles wait in its mailbox. #{div(1_000, @every_ms)} a second, #{div(1_000, @at_most_ms)} on a machine that is too busy (`pause/1`): the frames of those that are there come
  first. Links have turns (`MavRouter.Router.Admission.StartQueue`).

  A vehicle waits in the router's tables until it is started or refused, however long that takes. After a restart of this process
  those that wait there are started.
  """
  use GenServer

  alias Aerie.Base.Names
  alias MavRouter.Router.Admission
  alias MavRouter.Router.Admission.StartQueue
  alias MavRouter.Tables

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, gateway, name: Names.via(gateway, :vehicle_starter))
  end

  @doc "Asks for a vehicle, which `MavRouter.Router.Admission` does once for each that waits in the router's tables."
  @spec ask(Names.gateway(), {String.t(), non_neg_integer}) :: :ok
  def ask(gateway, key) do
    with pid when is_pid(pid) <- Names.whereis(gateway, :vehicle_starter), do: send(pid, {:start, key})

    :ok
  end

  @doc "The pause after a start that took so many ms: #{@every_ms} to #{@at_most_ms} ms."
  @spec pause(non_neg_integer) :: pos_integer
  def pause(took) when is_integer(took), do: (4 * took) |> max(@every_ms) |> min(@at_most_ms)

  @impl GenServer
  def init(gateway) do
    Process.flag(:priority, :low)
    Process.set_label({:vehicle_starter, gateway})
    timer = Process.send_after(self(), :next, 0)
    {:ok, %{gateway: gateway, queue: waiting(gateway), timer: timer}}
  end

  # Those that the last one was asked for.
  defp waiting(gateway) do
    case Tables.of(gateway) do
      nil -> StartQueue.new()
      tables -> Enum.reduce(:ets.tab2list(tables.waiting), StartQueue.new(), &put/2)
    end
  end

  defp put({key, sender}, queue), do: StartQueue.put(queue, Admission.brought_by(sender), key)

  @impl GenServer
  def handle_info({:start, key}, %{timer: nil} = state), do: {:noreply, start(state, key)}

  def handle_info({:start, key}, state) do
    tables = Tables.of(state.gateway)
    # None for one that a link has started meanwhile.
    rows = if tables, do: :ets.lookup(tables.waiting, key), else: []
    {:noreply, %{state | queue: Enum.reduce(rows, state.queue, &put/2)}}
  end

  def handle_info(:next, state), do: {:noreply, next(state)}

  defp next(state) do
    case StartQueue.take(state.queue) do
      nil -> %{state | timer: nil}
      {key, queue} -> start(%{state | queue: queue}, key)
    end
  end

  defp start(%{gateway: gateway} = state, key) do
    began = System.monotonic_time(:millisecond)
    tables = Tables.of(gateway)

    # One that waits no more was started by a link.
    if tables != nil and :ets.member(tables.waiting, key) do
      _ = Admission.start(gateway, tables, key, began)
      took = System.monotonic_time(:millisecond) - began
      %{state | timer: Process.send_after(self(), :next, pause(took))}
    else
      next(state)
    end
  end
end
