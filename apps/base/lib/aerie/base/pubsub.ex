defmodule Aerie.Base.PubSub do
  @moduledoc """
  Change notices: a subscriber of a topic gets `{:fleet, topic, payload}` messages.

  | topic           | payload                                     | when                     |
  |-----------------|---------------------------------------------|--------------------------|
  | `:vehicles`     | ids of the vehicles that changed            | coalesced, once per tick |
  | `:roster`       | id of a vehicle that appeared or was forgotten | at once              |
  | `{:vehicle, id}` | its id: it changed, or is gone              | coalesced, once per tick |
  | `:links`        | ids of the links that changed               | coalesced, once per tick |
  | `{:link, id}`   | its id: it changed, or is gone              | coalesced, once per tick |
  | `:events`       | an event of a vehicle                       | at once                  |
  | `:journal`      | `:pending`: events wait, or what is kept of a vehicle changed | at once            |
  | `:bridge`       | `{part, info}`: the NATS side changed       | at once                  |
  | `:leases`       | `{key, lease}`: who is in charge of a vehicle changed, nil for nobody | at once |
  | `{:commands, vehicle}` | the id of a command of this vehicle that began, went on or ended | at once |
  | `{:notice, part}` | a notice of a part of the layers above | at once               |

  A vehicle may change 200 times a second; its subscribers get at most one notice per tick (`:tick_ms`, 200 by default), and read from
  the store what they need. Nothing but these messages is queued for a slow subscriber.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Base.Names.Book

  @type topic ::
          :vehicles
          | :roster
          | :links
          | :events
          | :journal
          | :bridge
          | :leases
          | {:vehicle | :commands, vehicle :: String.t()}
          | {:link, term()}
          | {:notice, atom()}

  @spec start_link(gateway: Names.gateway(), tick_ms: pos_integer()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, options, name: Names.via(gateway, :pubsub))
  end

  @doc "Sends the calling process the notices of a topic from now on. Ends with `unsubscribe/2` or the process."
  @spec subscribe(Names.gateway(), topic()) :: :ok
  def subscribe(gateway, topic), do: Book.join({gateway, topic}, nil)

  @doc "Ends all subscriptions of the calling process to a topic."
  @spec unsubscribe(Names.gateway(), topic()) :: :ok
  def unsubscribe(gateway, topic), do: Book.leave({gateway, topic})

  @doc "Notes that a vehicle or a link changed; its subscribers are notified at the next tick."
  @spec changed(Names.gateway(), {:vehicle | :link, term()}) :: :ok
  def changed(gateway, {_kind, _id} = what) do
    case Names.held(gateway, :pubsub) do
      {pid, dirty} ->
        # Only the first change since the last tick wakes the process; all others cost one failed insert.
        if new?(dirty, what), do: send(pid, :changed)
        :ok

      nil ->
        :ok
    end
  end

  defp new?(dirty, what) do
    :ets.insert_new(dirty, {what})
  rescue
    # The process ended with its table; the next one starts with nothing noted.
    ArgumentError -> false
  end

  @doc "Sends a payload to all subscribers of a topic at once."
  @spec publish(Names.gateway(), topic(), term()) :: :ok
  def publish(gateway, topic, payload) do
    for {pid, _value} <- Book.members({gateway, topic}), do: send(pid, {:fleet, topic, payload})
    :ok
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:pubsub, gateway})
    dirty = :ets.new(:dirty, [:set, :public, write_concurrency: true])
    Names.put_held(gateway, :pubsub, {self(), dirty})
    {:ok, %{gateway: gateway, dirty: dirty, tick_ms: Keyword.get(options, :tick_ms, 200), armed: false}}
  end

  @impl GenServer
  def handle_info(:changed, %{armed: false} = state) do
    Process.send_after(self(), :tick, state.tick_ms)
    {:noreply, %{state | armed: true}}
  end

  def handle_info(:changed, state), do: {:noreply, state}

  # The answer that a watchdog waits for.
  def handle_info({:watchdog, watchdog, tag}, state) do
    send(watchdog, {:alive, tag, self()})
    {:noreply, state}
  end

  def handle_info(:tick, state) do
    # Taken one by one: a change noted while this runs is either taken here or wakes the next tick.
    changed = for {what} <- :ets.tab2list(state.dirty), :ets.take(state.dirty, what) != [], do: what
    notify(state.gateway, :vehicles, :vehicle, for({:vehicle, id} <- changed, do: id))
    notify(state.gateway, :links, :link, for({:link, id} <- changed, do: id))
    {:noreply, %{state | armed: false}}
  end

  defp notify(_gateway, _all, _one, []), do: :ok

  defp notify(gateway, all, one, ids) do
    publish(gateway, all, ids)
    Enum.each(ids, &publish(gateway, {one, &1}, &1))
  end
end
