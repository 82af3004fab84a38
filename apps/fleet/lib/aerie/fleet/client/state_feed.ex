defmodule Aerie.Fleet.Client.StateFeed do
  @moduledoc """
  The state of all vehicles as text, made once for all who read it, ten times a second while anybody does: for each
  vehicle a line with an object of JSON (`Aerie.Vehicle.Snapshot.Fields`). While there is no vehicle, one line says
  so: nothing is connected, and the rest is null.

  A reader (`join/1`) gets the message `:state_lines` when there is a new text, takes it with `latest/1`, and gets no
  further message before it has: a slow subscriber misses texts and never has more than one message waiting.
  """
  use GenServer

  alias Aerie.Base.{Json, Names, Store}
  alias Aerie.Fleet
  alias Aerie.Vehicle.Snapshot

  @topic :state_lines

  @typedoc "What a reader keeps to take the text with."
  @opaque reader :: {Names.gateway(), :atomics.atomics_ref()}

  @doc "Options: `:gateway`, `:hz`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, options, name: Names.via(gateway, :state_feed))
  end

  @doc "Makes the calling process a reader, until it ends."
  @spec join(Names.gateway()) :: reader()
  def join(gateway) do
    told = :atomics.new(1, [])
    :ok = Names.Book.join({gateway, @topic}, told)
    if pid = Names.whereis(gateway, :state_feed), do: send(pid, :joined)
    {gateway, told}
  end

  @doc "The newest text; nil when there is none yet. The next message comes only after this was called."
  @spec latest(reader()) :: binary() | nil
  def latest({gateway, told}) do
    :ok = :atomics.put(told, 1, 0)
    # After a restart of the feed the next message comes when it has a text.
    Names.read(gateway, :state_feed, nil, &:ets.lookup_element(&1, :text, 2, nil))
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:state_feed, gateway})
    table = :ets.new(:state_feed, [:set, :protected, read_concurrency: true])
    Names.put_value(gateway, :state_feed, table)
    period = max(round(1000 / Keyword.fetch!(options, :hz)), 1)
    {:ok, tick(%{gateway: gateway, table: table, period: period, due: now_ms()})}
  end

  @impl GenServer
  def handle_info(:tick, state) do
    case Names.Book.members({state.gateway, @topic}) do
      [] ->
        :ets.delete(state.table, :text)
        {:noreply, %{state | due: nil}}

      readers ->
        notify(state, readers)
        {:noreply, tick(state)}
    end
  end

  # The first reader after a time without any.
  def handle_info(:joined, %{due: nil} = state), do: {:noreply, tick(%{state | due: now_ms()})}
  def handle_info(:joined, state), do: {:noreply, state}

  defp notify(state, readers) do
    :ets.insert(state.table, {:text, lines(state.gateway)})
    for {pid, told} <- readers, :atomics.exchange(told, 1, 1) == 0, do: send(pid, @topic)
    :ok
  end

  defp lines(gateway) do
    context = %{now: System.os_time(:microsecond), links: Map.new(Store.links(gateway), &{&1.id, &1})}
    vehicles = with [] <- Fleet.vehicles(gateway), do: [%Snapshot{}]
    line = &[&1 |> Snapshot.show(:short, context) |> Json.encode_to_iodata!(), ?\n]
    vehicles |> Enum.map(line) |> IO.iodata_to_binary()
  end

  # By the clock, so that the rate is the rate; after a pause of the machine no ticks are made up for.
  defp tick(state) do
    due = max(state.due + state.period, now_ms())
    Process.send_after(self(), :tick, due, abs: true)
    %{state | due: due}
  end

  defp now_ms, do: System.monotonic_time(:millisecond)
end
