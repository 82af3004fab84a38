defmodule Aerie.Router.Nursery do
  @moduledoc """
  Makes vehicles when many are heard at once, one after the other, so that no link waits for that with its other vehicles'
  frames in its mailbox: #{100} a second, fewer on a busy machine (`pause/1`), whose vehicles' frames come first. It gets the
  frames by which a vehicle was found too: they are its first ones.
  """
  use GenServer

  alias Aerie.Names
  alias Aerie.Router.Admission
  alias Aerie.Router.Tables
  alias Aerie.Successor

  @every_ms 10
  @at_most_ms 50

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    name = Names.via(gateway, :router_nursery)
    Successor.start(fn -> GenServer.start_link(__MODULE__, gateway, name: name) end)
  end

  @doc "Asks for a vehicle. Whoever asks sees to it that each is asked for once (`Aerie.Router.Admission`)."
  @spec ask(Names.gateway(), {String.t(), non_neg_integer}, from :: term, [MavCodec.Frame.t()]) :: :ok
  def ask(gateway, key, from, frames) do
    with nursery when is_pid(nursery) <- Names.whereis(gateway, :router_nursery),
         do: send(nursery, {:make, key, from, frames})

    :ok
  end

  @doc "How long to wait before the next one, when one took so long, in ms: #{10} to #{50}."
  @spec pause(non_neg_integer) :: pos_integer
  def pause(took) when is_integer(took), do: (4 * took) |> max(@every_ms) |> min(@at_most_ms)

  @impl GenServer
  def init(gateway) do
    Process.flag(:priority, :low)
    Process.set_label({:router_nursery, gateway})
    {:ok, %{gateway: gateway, queue: :queue.new(), timer: nil}}
  end

  @impl GenServer
  def handle_info({:make, key, from, frames}, %{timer: nil} = state),
    do: {:noreply, make(state, {key, from, frames})}

  def handle_info({:make, key, from, frames}, state),
    do: {:noreply, %{state | queue: :queue.in({key, from, frames}, state.queue)}}

  def handle_info(:next, state) do
    case :queue.out(state.queue) do
      {:empty, _queue} -> {:noreply, %{state | timer: nil}}
      {{:value, asked}, queue} -> {:noreply, make(%{state | queue: queue}, asked)}
    end
  end

  defp make(%{gateway: gateway} = state, {key, from, frames}) do
    began = System.monotonic_time(:millisecond)

    with tables when is_map(tables) <- Tables.of(gateway),
         {:ok, session} <- Admission.make(gateway, tables, key, began) do
      send(session, {:frames, from, frames})
    end

    took = System.monotonic_time(:millisecond) - began
    %{state | timer: Process.send_after(self(), :next, pause(took))}
  end
end
