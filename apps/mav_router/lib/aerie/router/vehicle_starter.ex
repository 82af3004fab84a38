defmodule Aerie.Router.VehicleStarter do
  @every_ms 10
  @at_most_ms 50

  @moduledoc """
  Starts vehicles one after the other when many are heard at once, so that no link has to do it while frames of its other
  vehicles wait in its mailbox. #{div(1_000, @every_ms)} a second, fewer on a busy machine (`pause/1`), where frames come first. It
  also gets the frames by which a vehicle was found, which are the vehicle's first ones.
  """
  use GenServer

  alias Aerie.Names
  alias Aerie.Router.Admission
  alias Aerie.Router.Tables

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, gateway, name: Names.via(gateway, :vehicle_starter))
  end

  @doc "Asks for a vehicle, which `Aerie.Router.Admission` does once for each. Its session gets the frames as sent by `sender`."
  @spec ask(Names.gateway(), {String.t(), non_neg_integer}, sender :: term, [MavCodec.Frame.t()]) :: :ok
  def ask(gateway, key, sender, frames) do
    with pid when is_pid(pid) <- Names.whereis(gateway, :vehicle_starter),
         do: send(pid, {:start, key, sender, frames})

    :ok
  end

  @doc "The pause after a start that took so many ms: #{@every_ms} to #{@at_most_ms} ms."
  @spec pause(non_neg_integer) :: pos_integer
  def pause(took) when is_integer(took), do: (4 * took) |> max(@every_ms) |> min(@at_most_ms)

  @impl GenServer
  def init(gateway) do
    Process.flag(:priority, :low)
    Process.set_label({:vehicle_starter, gateway})
    {:ok, %{gateway: gateway, queue: :queue.new(), timer: nil}}
  end

  @impl GenServer
  def handle_info({:start, key, sender, frames}, %{timer: nil} = state),
    do: {:noreply, start(state, {key, sender, frames})}

  def handle_info({:start, key, sender, frames}, state),
    do: {:noreply, %{state | queue: :queue.in({key, sender, frames}, state.queue)}}

  def handle_info(:next, state) do
    case :queue.out(state.queue) do
      {:empty, _queue} -> {:noreply, %{state | timer: nil}}
      {{:value, asked}, queue} -> {:noreply, start(%{state | queue: queue}, asked)}
    end
  end

  defp start(%{gateway: gateway} = state, {key, sender, frames}) do
    began = System.monotonic_time(:millisecond)

    with tables when is_map(tables) <- Tables.of(gateway),
         {:ok, session} <- Admission.start(gateway, tables, key, began) do
      send(session, {:frames, sender, frames})
    end

    took = System.monotonic_time(:millisecond) - began
    %{state | timer: Process.send_after(self(), :next, pause(took))}
  end
end
