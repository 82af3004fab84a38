defmodule Aerie.Fleet.Bridge.State do
  @doubtful_ms 30_000
  @gather_ms 5
  @at_once 64

  @moduledoc """
  Publishes vehicles' state: fire and forget, the newest value only.

  `put/5` runs in the vehicle's process. It encodes the message, puts it into a table with one entry per subject, and wakes
  this process if the entry is new. So a slow or absent NATS costs one value per subject, never a queue: a newer value
  replaces the older one, which is counted as superseded. A value is sent at once, or with all others #{@gather_ms} ms after the last
  were: many vehicles' values then need few writes. When NATS is back, the last value of each subject is published, also
  if it was sent within the last #{div(@doubtful_ms, 1000)} seconds, because the lost connection may have dropped it. Older
  values are sent again only if their stream is a new one, also one that another gateway made: else another gateway may have published newer ones.
  """
  use GenServer

  alias Aerie.Fleet.Bridge.{Connection, Message, Settings}
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.Names
  alias Aerie.Fleet.{Bridge, Nats}

  @max_subjects 100_000
  @look_again_ms 1_000

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_state))
  end

  @doc "Hands over a state group for publishing. Never waits for NATS."
  @spec put(Names.gateway(), String.t(), atom(), map(), integer()) :: :ok
  def put(gateway, vehicle, group, map, at) do
    with %{} = tables <- Tables.get(gateway),
         {pid, {environment, origin}} <- publisher(gateway) do
      {data, time_boot_ms} = parts(map)
      group = Atom.to_string(group)
      subject = Message.state_subject(environment, vehicle, group)
      body = Message.state(vehicle, group, data, time_boot_ms, at, origin)

      if enqueue(tables, {subject, body, "state." <> group}), do: send(pid, {:publish, subject})
    end

    :ok
  end

  @doc "The hub is back: what was published since `since` (monotonic ms) may not have arrived there, so it is published again."
  @spec hub_up(Names.gateway(), integer()) :: :ok
  def hub_up(gateway, since) do
    if pid = Names.whereis(gateway, :bridge_state), do: send(pid, {:hub_up, since})
    :ok
  end

  defp publisher(gateway) do
    case Names.Book.lookup({gateway, :bridge_state, nil}) do
      {pid, {_environment, _origin} = value} -> {pid, value}
      _ -> nil
    end
  end

  # A group as the vehicle's snapshot has it, or just its data.
  defp parts(%{data: data} = group) when is_map(data), do: {data, Map.get(group, :time_boot_ms)}
  defp parts(data), do: {data, nil}

  # Whether the publisher must be notified.
  defp enqueue(tables, {subject, _body, _label} = message) do
    leave(tables, message) and :ets.insert_new(tables.values, {{:dirty, subject}})
  rescue
    # The tables are gone because the bridge restarts. The next value comes soon.
    ArgumentError -> false
  end

  defp leave(%{values: values} = tables, {subject, _body, label} = message) do
    cond do
      :ets.info(values, :size) >= 2 * @max_subjects and not :ets.member(values, subject) ->
        Tables.count(tables, :state_dropped, subject: label)
        false

      # False if a value is already waiting.
      :ets.insert_new(values, message) ->
        true

      # The publisher may take the older value just now, which then counts as superseded although it was published.
      true ->
        Tables.count(tables, :state_superseded, subject: label)
        :ets.insert(values, message)
    end
  end

  @impl GenServer
  def init(options) do
    gateway = options[:gateway]
    Process.set_label({:bridge_state, gateway})
    tables = Tables.get(gateway)
    origin = %{epoch: Journal.epoch(gateway), gateway: Bridge.name(gateway)}
    Names.put_value(gateway, :bridge_state, {options[:settings].environment, origin})
    current = Connection.current(tables)
    conn = current && current.conn
    # `waiting`: subjects that are published together when `timer` ends; `published`: when the last ones were.
    # `made_at`: when the stream was made that has what was published.
    state = %{
      tables: tables,
      conn: conn,
      last_conn: conn,
      made_at: made_at(tables),
      waiting: [],
      timer: nil,
      published: nil
    }

    {:ok, sweep(state)}
  end

  @impl GenServer
  # Without a connection the mark stays, so that this subject causes no further messages. The sweep removes it.
  def handle_info({:publish, _subject}, %{conn: nil} = state), do: {:noreply, state}

  def handle_info({:publish, subject}, %{timer: nil, published: last} = state) do
    if last == nil or now() - last >= @gather_ms do
      {:noreply, publish(state, [subject])}
    else
      timer = Process.send_after(self(), :gathered, last + @gather_ms, abs: true)
      {:noreply, %{state | waiting: [subject], timer: timer}}
    end
  end

  def handle_info({:publish, subject}, state),
    do: {:noreply, %{state | waiting: [subject | state.waiting]}}

  def handle_info(:gathered, %{waiting: waiting} = state),
    do: {:noreply, publish(%{state | waiting: [], timer: nil}, Enum.reverse(waiting))}

  def handle_info({:bridge, :up, conn}, %{tables: tables} = state) do
    made_at = made_at(tables)

    _again =
      cond do
        made_at != state.made_at -> again(tables, :infinity)
        conn != state.last_conn -> again(tables, @doubtful_ms)
        true -> :ok
      end

    {:noreply, sweep(%{state | conn: conn, last_conn: conn, made_at: made_at})}
  end

  def handle_info({:bridge, :down}, state), do: {:noreply, %{state | conn: nil}}

  def handle_info({:hub_up, since}, %{conn: conn} = state) when conn != nil do
    # A value that waits is newer, and comes after it.
    for {subject, {_subject, body, _label}, at} <- :ets.tab2list(state.tables.sent),
        at >= since,
        do: _ = Nats.pub(conn, subject, body, headers: [{"Aerie-Backfill", "true"}])

    {:noreply, state}
  end

  # A connection that did not answer but was not lost sends no message.
  def handle_info(:look_again, %{conn: nil} = state) do
    current = Connection.current(state.tables)
    {:noreply, sweep(%{state | conn: current && current.conn})}
  end

  def handle_info(_message, state), do: {:noreply, state}

  defp made_at(tables), do: Tables.info(tables, :streams)[:state_made_at]

  defp sweep(state),
    do: publish(state, :ets.select(state.tables.values, [{{{:dirty, :"$1"}}, [], [:"$1"]}]))

  # Without a connection the marks stay.
  defp publish(%{conn: nil} = state, _subjects), do: state
  defp publish(state, []), do: %{state | published: now()}

  defp publish(%{tables: %{values: values}, conn: conn} = state, subjects) do
    {some, others} = Enum.split(subjects, @at_once)

    # The mark goes first, so that a value that comes after the take sets a new one.
    messages =
      for subject <- some,
          :ets.delete(values, {:dirty, subject}),
          message <- :ets.take(values, subject),
          do: message

    results = Nats.pub_all(conn, for({subject, body, _label} <- messages, do: {subject, body}))
    messages |> Enum.zip(results) |> Enum.reduce(state, &published/2) |> publish(others)
  end

  defp published({{subject, _body, label} = message, :ok}, %{tables: %{sent: sent} = tables} = state) do
    Tables.count(tables, :published, subject: label)
    if :ets.info(sent, :size) < @max_subjects, do: :ets.insert(sent, {subject, message, now()})
    state
  end

  defp published({_message, {:error, {:too_large, _bytes, _max}}}, state) do
    Tables.count(state.tables, :publish_errors)
    state
  end

  defp published({message, {:error, _gone}}, %{tables: tables} = state) do
    put_back(tables.values, message)
    Tables.count(tables, :publish_errors)
    _ = if state.conn != nil, do: Process.send_after(self(), :look_again, @look_again_ms)
    %{state | conn: nil}
  end

  defp again(%{sent: sent, values: values}, young_ms) do
    for {_subject, message, at} <- :ets.tab2list(sent),
        now() - at <= young_ms,
        do: put_back(values, message)

    :ets.delete_all_objects(sent)
  end

  # Unless there is already a newer value.
  defp put_back(values, {subject, _body, _label} = message) do
    :ets.insert_new(values, message)
    :ets.insert(values, {{:dirty, subject}})
  end

  defp now, do: System.monotonic_time(:millisecond)
end
