defmodule Aerie.Fleet.Remote.Listener do
  @moduledoc """
  Follows the state of vehicles that other gateways publish, and writes it to `Aerie.Fleet.Remote.Table`.

  At each connection it reads the last values that the stream has, so that a vehicle whose gateway is away is shown with
  its age. For vehicles that this gateway's own links hear, it takes only the names of others that hear them. It tells
  `Aerie.Fleet.Bridge.Commands` which vehicles to leave to another gateway, because this one's links have lost them.

  Counters (`gateway_occurrences_total{name="remote.…"}`): `taken`, and those of the table.

  | what | limit | beyond it |
  |---|---|---|
  | messages that wait here | 20,000 | dropped, counted (`:dropped`) |
  | a message | 32 KiB; fields of the contract only | ignored, counted (`:malformed`) |
  | vehicles | `remote.max_vehicles` | a lost one is forgotten, or the new one is not shown, counted (`:full`) |
  | gateways of a vehicle | 8 | not shown, counted (`:full`) |
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet.{Bridge, Nats}
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Fleet.Bridge.Commands
  alias Aerie.Fleet.Bridge.Connection.Subscriber
  alias Aerie.Fleet.Remote.Table
  alias Aerie.Fleet.Remote.{Message, Settings}
  alias Aerie.Base.PubSub

  @max_waiting 20_000
  @max_gateways 8
  @tick_ms 1_000
  # A clock error up to this is not corrected.
  @offset_us 2_000_000

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :remote_listener))

  @impl GenServer
  def init(gateway: gateway, settings: settings) do
    Process.set_label({:remote_listener, gateway})
    :ok = PubSub.subscribe(gateway, :bridge)
    :ok = Table.configure(gateway, %{stale_us: div(settings.lost_us, 2), lost_us: settings.lost_us})
    {:ok, tasks} = Task.Supervisor.start_link()

    known =
      for {id, name, _what} <- Table.gateways(gateway), reduce: %{} do
        known -> Map.update(known, id, [name], &[name | &1])
      end

    state = %{
      gateway: gateway,
      environment: settings.bridge.environment,
      max: settings.max_vehicles,
      tasks: tasks,
      conn: nil,
      me: {Bridge.name(gateway), Journal.epoch(gateway)},
      known: known,
      offsets: %{},
      own: MapSet.new(),
      elsewhere: nil
    }

    {:ok, state |> tick() |> connect()}
  end

  @impl GenServer
  def handle_info({:msg, %{topic: topic, body: body} = message}, state) do
    {:message_queue_len, waiting} = Process.info(self(), :message_queue_len)

    if waiting > @max_waiting,
      do: {:noreply, count(state, :dropped)},
      else: {:noreply, take(state, topic, body, how(message))}
  end

  def handle_info({:timeout, _timer, :tick}, state), do: {:noreply, state |> tick() |> connect()}
  def handle_info({:fleet, :bridge, {:connection, _info}}, state), do: {:noreply, connect(state)}
  def handle_info(_late, state), do: {:noreply, state}

  # From the task that reads the stream; it waits, so that its pages do not pile up here.
  @impl GenServer
  def handle_call({:last, messages}, _from, state),
    do:
      {:reply, :ok,
       Enum.reduce(messages, state, fn {topic, body}, state -> take(state, topic, body, :last) end)}

  defp connect(%{conn: before} = state) do
    subjects = "fleet.#{state.environment}.*.state.*"
    %{conn: conn, tasks: tasks} = state = Subscriber.follow(state, subjects)
    listener = self()

    _reader =
      if conn not in [nil, before] do
        {:ok, _pid} = Task.Supervisor.start_child(tasks, fn -> read(conn, subjects, listener) end)
      end

    state
  end

  # Without the stream there is only what comes from now on.
  defp read(conn, subjects, listener) do
    _ =
      Nats.Reader.last(conn, "FLEET_STATE", subjects, fn message ->
        GenServer.call(listener, {:last, [{message.topic, message.body}]}, :infinity)
      end)

    :ok
  catch
    :exit, _gone -> :ok
  end

  # Said again after a cut, it is as old as it says.
  defp how(message),
    do: if({"aerie-backfill", "true"} in Map.get(message, :headers, []), do: :last, else: :live)

  defp take(state, topic, body, how) do
    with {:ok, id, group} <- Message.subject(topic),
         true <- group == "gateway" or id not in state.own,
         {:ok, message} <- Message.parse(id, group, body) do
      if {message.gateway, message.epoch} == state.me,
        do: state,
        else: state |> count(:taken) |> receive_message(message, how)
    else
      false -> state
      :error -> count(state, :malformed)
    end
  end

  defp receive_message(state, %{vehicle: id} = message, how) do
    name = message.gateway || "unnamed"

    case admit(state, id, name) do
      {:ok, state} -> write(state, id, name, message, how)
      :full -> count(state, :full)
    end
  end

  defp write(state, id, name, message, how) do
    now = System.os_time(:microsecond)
    state = clock(state, name, message, how, now)
    offset = Map.get(state.offsets, name, 0)
    at = min(now, message.time + offset)
    # A stored message was published at its time, not now.
    heard = if how == :live, do: now, else: at

    case message.content do
      {:facts, facts} ->
        last = facts.last_heard && min(now, facts.last_heard + offset)
        spoken(state, id, name, %{facts | last_heard: last}, heard)

      {:group, group, data} ->
        Table.put(state.gateway, id, group, %{
          data: data,
          at: at,
          time_boot_ms: message.time_boot_ms,
          via: name
        })

        state
    end
  end

  # How far the other clock is off, as far as it is more than a message takes.
  defp clock(state, name, %{content: {:facts, _facts}, time: time}, :live, now) do
    offset = if abs(now - time) > @offset_us, do: now - time, else: 0
    offsets = if map_size(state.offsets) > state.max, do: %{}, else: state.offsets
    %{state | offsets: Map.put(offsets, name, offset)}
  end

  defp clock(state, _name, _message, _how, _now), do: state

  defp spoken(state, id, name, facts, heard) do
    :ok = Table.put_gateway(state.gateway, id, name, facts, heard)
    state
  end

  defp admit(%{known: known} = state, id, name) do
    case known do
      %{^id => names} ->
        cond do
          name in names -> {:ok, state}
          length(names) >= @max_gateways -> :full
          true -> {:ok, begin(state, id, name)}
        end

      _new ->
        if map_size(known) < state.max, do: {:ok, begin(state, id, name)}, else: replace(state, id, name)
    end
  end

  defp begin(state, id, name) do
    # Known only by a value until its gateway announces it.
    :ok = Table.put_gateway(state.gateway, id, name, nil, 0)
    %{state | known: Map.update(state.known, id, [name], &[name | &1])}
  end

  # Looked for once a second at most: a flood of made-up names must not cost more than that.
  defp replace(state, id, name) do
    with true <- Store.claim(state.gateway, {__MODULE__, :replace}, @tick_ms),
         {oldest, %{status: :lost}} <-
           Enum.min_by(Table.vehicles(state.gateway, System.os_time(:microsecond)), fn {_id, vehicle} ->
             {vehicle.status != :lost, vehicle.last_heard || 0}
           end) do
      :ok = Table.forget(state.gateway, oldest)
      {:ok, begin(%{state | known: Map.delete(state.known, oldest)}, id, name)}
    else
      _none_lost -> :full
    end
  end

  defp tick(state) do
    _timer = :erlang.start_timer(@tick_ms, self(), :tick)
    vehicles = Store.vehicles(state.gateway)
    now = System.os_time(:microsecond)
    own = for %{id: id, status: status} <- vehicles, status != :lost, into: MapSet.new(), do: id

    # Told before this gateway loses them: from then on it must not answer for them.
    elsewhere =
      for %{id: id} <- vehicles,
          %{status: status} when status != :lost <- [Table.vehicle(state.gateway, id, now)],
          into: MapSet.new(),
          do: id

    if {own, elsewhere} != {state.own, state.elsewhere},
      do: Commands.leave(state.gateway, :heard, elsewhere)

    %{state | own: own, elsewhere: elsewhere}
  end

  defp count(state, what) do
    _ = Store.count(state.gateway, {:remote, what})
    state
  end
end
