defmodule Aerie.Fleet.Bridge.Events do
  @moduledoc """
  Brings events from the journal into the stream `FLEET_EVENTS`, at least once and in each vehicle's order.

  * With NATS, pending events of the journal are published with their id as `Nats-Msg-Id`, and leave the journal when the
    stream has confirmed them. An event that is not confirmed is sent again; its id makes the second copy harmless.
  * Without NATS, or if it confirms nothing, pending events move from the journal to the outbox on disk.
  * When NATS is back, the outbox goes first, marked `Aerie-Backfill: true`, then the journal, so that the order holds.
  * If the disk cannot be written, events stay in the journal, which is bounded and counts what it drops. That is logged once
    and retried every half second.

  `Aerie.Fleet.Bridge.Events.Stores` brings the events into the window, and `Aerie.Fleet.Bridge.Events.Window` decides
  what may be in flight.
  """
  # Its end writes to the disk.
  use GenServer, shutdown: 30_000

  alias Aerie.Fleet.Bridge.{Connection, NatsServer, Settings}
  alias Aerie.Fleet.Bridge.Events.Outbox
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Fleet.Bridge.Events.{Gaps, PubAck, StallDetector, Stores, Window}
  alias Aerie.Base.Names
  alias Aerie.Fleet.Nats
  alias Aerie.Base.PubSub

  require Logger

  @tick_ms 500
  @answer_ms 2_000
  # After so many sendings without a confirmation, events are safer on disk than in memory.
  @patience 4
  # If the journal has more events than this, or is a quarter full, it is moved to the disk even while NATS answers.
  @spill_above 5_000
  @drain_ms 1_000
  # A server that has answered nothing for so long is restarted.
  @silence_ms 10_000

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_events))
  end

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = options[:gateway]
    %Settings{} = settings = Keyword.fetch!(options, :settings)
    Process.set_label({:bridge_events, gateway})
    Logger.metadata(gateway: inspect(gateway))
    :ok = PubSub.subscribe(gateway, :journal)
    notice_denials(gateway)

    state = %{
      gateway: gateway,
      environment: settings.environment,
      epoch: Journal.epoch(gateway),
      tables: Tables.get(gateway),
      settings: settings.outbox,
      spill_above: min(@spill_above, div(settings.fleet.max_pending_events, 4)),
      window: Window.new(settings.max_events_in_flight),
      gaps: Gaps.new(),
      places: %{},
      outbox: nil,
      problem: nil,
      refusal: nil,
      denied: nil,
      conn: nil,
      conn_at: nil,
      inbox: nil,
      stall: StallDetector.new(),
      silent?: false,
      told?: false,
      synced_at: now()
    }

    Process.send_after(self(), :tick, @tick_ms)
    {:ok, Stores.open(state), {:continue, :start}}
  end

  @impl GenServer
  def handle_continue(:start, state), do: {:noreply, state |> look_for_connection() |> pump()}

  @impl GenServer
  def handle_info({:fleet, :journal, _payload}, state) do
    flush_notifications()
    {:noreply, pump(state)}
  end

  def handle_info({:msg, message}, state),
    do: {:noreply, [message] |> more_answers() |> answers(state) |> pump()}

  def handle_info({:bridge, :up, _conn}, state), do: {:noreply, state |> look_for_connection() |> pump()}
  def handle_info({:bridge, :down}, state), do: {:noreply, state |> away() |> pump()}

  def handle_info(:tick, state) do
    Process.send_after(self(), :tick, @tick_ms)
    state = if state.outbox == nil, do: Stores.open(state), else: state

    {:noreply,
     state |> look_again() |> send_overdue() |> pump() |> Stores.sync() |> stalled() |> put_info() |> report()}
  end

  def handle_info({:denied, conn, text}, %{conn: conn} = state), do: {:noreply, %{state | denied: text}}
  def handle_info(_message, state), do: {:noreply, state}

  # A server says only by an error of the connection that the gateway's user lacks a right, and then confirms nothing.
  defp notice_denials(gateway) do
    id = {__MODULE__, gateway}
    _ = :telemetry.detach(id)
    :ok = :telemetry.attach(id, [:gnat, :server_error], &__MODULE__.server_error/4, self())
  end

  @doc false
  @spec server_error([atom()], map(), map(), pid()) :: :ok
  def server_error(_event, _count, %{message: "Permissions Violation" <> _ = text}, events) do
    send(events, {:denied, self(), text})
    :ok
  end

  def server_error(_event, _count, _metadata, _events), do: :ok

  @impl GenServer
  def terminate(_reason, state) do
    _ = :telemetry.detach({__MODULE__, state.gateway})
    state = drain(state, now() + @drain_ms)
    state = Stores.spill(state)
    if state.outbox, do: Outbox.close(state.outbox)
  end

  # At an orderly end, events in flight get a moment to be confirmed; the rest goes to the disk.
  defp drain(%{conn: nil} = state, _deadline), do: state

  defp drain(state, deadline) do
    state = pump(state)

    if Window.size(state.window) == 0 do
      state
    else
      receive do
        {:msg, message} -> [message] |> more_answers() |> answers(state) |> drain(deadline)
        {:bridge, :down} -> away(state)
      after
        max(deadline - now(), 0) -> state
      end
    end
  end

  defp look_for_connection(state) do
    case Connection.current(state.tables) do
      %{conn: conn, streams: :ok} when conn != state.conn -> subscribe(away(state), conn)
      %{conn: conn, streams: :ok} when conn == state.conn -> state
      _none_or_no_stream -> away(state)
    end
  end

  # A connection that did not answer but was not lost sends no message.
  defp look_again(%{conn: nil} = state) do
    case Connection.current(state.tables) do
      %{streams: :ok} -> look_for_connection(state)
      _none_or_no_stream -> state
    end
  end

  defp look_again(state), do: state

  defp subscribe(state, conn) do
    inbox = "_INBOX.aerie-#{Base.encode16(:crypto.strong_rand_bytes(9), case: :lower)}"

    case Nats.sub(conn, self(), inbox <> ".*") do
      {:ok, _sid} -> %{state | conn: conn, conn_at: now(), inbox: inbox}
      {:error, _reason} -> state
    end
  end

  # Unconfirmed events are read again from the journal or the outbox.
  defp away(state), do: reset(%{state | conn: nil, inbox: nil, refusal: nil, denied: nil})

  defp reset(state) do
    %{
      state
      | window: Window.reset(state.window),
        gaps: Gaps.reset(state.gaps),
        places: %{},
        outbox: state.outbox && Outbox.rewind(state.outbox)
    }
  end

  # All events are moved here: to the disk, or to NATS.
  defp pump(%{conn: nil} = state), do: Stores.spill(state)

  defp pump(state) do
    if Journal.pending_size(state.gateway) > state.spill_above do
      state |> reset() |> Stores.spill() |> Stores.fill() |> send_ready()
    else
      state |> Stores.fill() |> send_ready()
    end
  end

  defp send_ready(%{conn: nil} = state), do: state

  defp send_ready(state) do
    case Window.next(state.window, now()) do
      {ref, item, window} -> %{state | window: window} |> publish(ref, item) |> send_ready()
      :none -> state
    end
  end

  defp send_overdue(%{conn: nil} = state), do: state

  defp send_overdue(state) do
    state =
      state.window |> Window.overdue(now() - @answer_ms) |> Enum.sort() |> Enum.reduce(state, &send_again/2)

    if Window.most_tries(state.window) > @patience and Stores.journal?(state),
      do: state |> reset() |> Stores.spill(),
      else: state
  end

  defp send_again(_ref, %{conn: nil} = state), do: state

  defp send_again(ref, state) do
    case Window.again(state.window, ref, now()) do
      {ref, item, _tries, window} ->
        Tables.count(state.tables, :event_retries)
        publish(%{state | window: window}, ref, item)

      :none ->
        state
    end
  end

  defp publish(state, ref, {key, record}) do
    options = [reply_to: "#{state.inbox}.#{ref}", headers: headers(key, record)]

    case Nats.pub(state.conn, record.subject, record.body, options) do
      :ok ->
        state

      {:error, reason} ->
        Tables.count(state.tables, :publish_errors)
        if PubAck.hopeless?(reason), do: give_up(state, ref, record, reason), else: state
    end
  end

  defp headers({:outbox, _seq}, record), do: [{"Nats-Msg-Id", record.id}, {"Aerie-Backfill", "true"}]
  defp headers({:lost, key}, record), do: headers(key, record)
  defp headers({:journal, _id}, record), do: [{"Nats-Msg-Id", record.id}]

  # It would be refused for ever, and hold up the vehicle's other events.
  defp give_up(state, ref, record, reason) do
    Logger.error("event #{record.id} on #{record.subject} is dropped: #{PubAck.text(reason)}")
    Tables.count(state.tables, :events_dropped)
    {key, window} = Window.confirm(state.window, ref)
    done(%{state | window: window}, [key])
  end

  defp answers(messages, state) do
    {state, keys} = Enum.reduce(messages, {state, []}, &answer/2)
    done(state, keys)
  end

  defp answer(message, {state, keys}) do
    case PubAck.parse(message, state.inbox) do
      {:confirmed, ref, duplicate?} ->
        if duplicate?, do: Tables.count(state.tables, :event_duplicates)
        subject = subject(state.window, ref)
        {key, window} = Window.confirm(state.window, ref)
        if key, do: Tables.count(state.tables, :published, subject: subject)
        {%{state | window: window, refusal: nil}, List.wrap(key) ++ keys}

      {:refused, ref, reason} ->
        {refused(state, ref, reason), keys}

      :other ->
        {state, keys}
    end
  end

  defp refused(state, ref, reason) do
    Tables.count(state.tables, :publish_errors)

    case state.window.in_flight do
      %{^ref => {{_key, record}, _at, _tries}} ->
        if PubAck.hopeless?(reason), do: give_up(state, ref, record, reason), else: not_now(state, reason)

      _late ->
        state
    end
  end

  # The event stays in flight and is sent again when it is overdue. If the stream was deleted, it is created again.
  defp not_now(state, reason) do
    if reason == :no_stream, do: send_to_connection(state, :check_streams)
    text = "NATS does not take events: #{PubAck.text(reason)}"
    if text != state.refusal, do: Logger.warning(text)
    %{state | refusal: text}
  end

  defp send_to_connection(state, message) do
    if pid = Names.whereis(state.gateway, :bridge_connection), do: send(pid, message)
  end

  defp subject(window, ref) do
    case window.in_flight do
      %{^ref => {{_key, record}, _at, _tries}} ->
        "event." <> (record.subject |> String.split(".event.") |> List.last())

      _late ->
        ""
    end
  end

  defp done(state, []), do: state

  defp done(state, keys) do
    ids = for {:journal, id} <- keys, do: id
    seqs = for {:outbox, seq} <- keys, do: seq
    if ids != [], do: Journal.ack(state.gateway, ids)

    :telemetry.execute([:aerie, :bridge, :events, :confirmed], %{count: length(keys)}, %{
      gateway: state.gateway
    })

    {places, rest} = Map.split(state.places, keys)
    gaps = places |> Map.values() |> Enum.sort() |> Enum.reduce(state.gaps, &Gaps.confirm(&2, &1))
    # On a leaf node it brings them to the hub.
    if pid = Names.whereis(state.gateway, :bridge_forward), do: send(pid, :pump)
    state = %{state | stall: StallDetector.confirmed(state.stall, now()), places: rest, gaps: gaps}
    if seqs == [], do: state, else: %{state | outbox: Outbox.ack(state.outbox, seqs)}
  end

  defp stalled(state) do
    waiting? = Stores.waiting?(state)
    stall = StallDetector.check(state.stall, now(), waiting?)

    # A restart helps against silence, not against a refusal. A new connection gets its time.
    silent? =
      stall.problem? and stall.calm_since == nil and state.conn != nil and
        now() - state.conn_at >= @silence_ms and state.refusal == nil and state.denied == nil

    if silent?, do: NatsServer.stalled(state.gateway, "it answers no event")
    %{state | stall: stall, silent?: silent?}
  end

  defp report(%{silent?: true, told?: false} = state) do
    Logger.error(Tables.problem(state.tables) || stall_text(state))
    %{state | told?: true}
  end

  defp report(%{stall: %{problem?: false}, told?: true} = state) do
    Logger.notice("NATS confirms events again")
    %{state | told?: false}
  end

  defp report(state), do: state

  defp stall_text(%{stall: %{problem?: false}}), do: nil

  defp stall_text(%{refusal: nil, denied: "" <> text}) do
    "NATS does not confirm events: the gateway's user lacks a right (#{text}). Give it that right, or make the " <>
      "account again with aerie nats-setup"
  end

  defp stall_text(%{refusal: nil}), do: "NATS does not confirm events"
  defp stall_text(%{refusal: text}), do: text

  defp put_info(state) do
    stats =
      if state.outbox, do: Outbox.stats(state.outbox), else: %{events: 0, bytes: 0, dropped: 0, damaged: 0}

    info =
      Map.merge(stats, %{
        in_flight: Window.in_flight(state.window),
        problem: state.problem,
        stalled: stall_text(state),
        silent?: state.silent?,
        stalled_s: div(StallDetector.ms(state.stall, now()), 1000)
      })

    if info != Tables.info(state.tables, :outbox),
      do: Tables.put_info(state.gateway, state.tables, :outbox, info)

    state
  end

  # Waiting answers and notifications are handled together: one write of the outbox's head, one read of the journal.
  defp more_answers(messages) when length(messages) >= 64, do: messages

  defp more_answers(messages) do
    receive do
      {:msg, message} -> more_answers([message | messages])
    after
      0 -> messages
    end
  end

  defp flush_notifications do
    receive do
      {:fleet, :journal, _payload} -> flush_notifications()
    after
      0 -> :ok
    end
  end

  defp now, do: System.monotonic_time(:millisecond)
end
