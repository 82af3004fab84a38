defmodule Aerie.Fleet.Bridge.Forward do
  @moduledoc """
  On a leaf node: brings the events of the local stream to the hub's, at least once and in each vehicle's order.

  `Aerie.Fleet.Bridge.Events` stores events in the local stream, whether the hub is there or not. This process reads them from there,
  publishes each on `hub.fleet.…`, which the hub's accounts turn into `fleet.…` (`Aerie.Fleet.Bridge.Hub.Accounts`), and goes on when the
  hub's stream has confirmed it. How far it is, is in `hub/position.json` in the outbox's folder.

  It also asks every second whether the hub is there. When the hub is back, events that were stored meanwhile go with
  `Aerie-Backfill: true`, and `Aerie.Fleet.Bridge.State` sends what it published meanwhile.

  Where events are missing in a vehicle's row, because the local stream overflowed, the hub gets a marker
  (`Aerie.Fleet.Bridge.Events.Gaps`).

  A hub that is there and does not store what it gets is `stalled`, until it confirms an event.
  """
  use GenServer

  alias Aerie.Fleet.Bridge.{Connection, Message, Settings, State}
  alias Aerie.Fleet.Bridge.Status.Readiness
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Fleet.Bridge.Events.{Gaps, PubAck, Window}
  alias Aerie.Fleet.Bridge.Forward.{Hub, Local, Position}
  alias Aerie.Base.{Names, Store}
  alias Aerie.Base.Files.Private
  alias Aerie.Fleet.Nats

  require Logger

  @tick_ms 500
  @ask_ms 1_000
  @silence_ms 4_000
  @answer_ms 2_000
  # After so many sends without a confirmation, that is reported.
  @patience 3
  @batch 64
  @told_ms 60_000
  # Messages published so long before this process started count as delivered.
  @unknown_ms 30_000

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_forward))

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = options[:gateway]
    %Settings{} = settings = Keyword.fetch!(options, :settings)
    Process.set_label({:bridge_forward, gateway})
    Logger.metadata(gateway: inspect(gateway))
    dir = Path.join(Path.expand(settings.outbox.dir), "hub")
    file = Path.join(dir, "position.json")
    {position, last} = Position.load(file)
    _ = Private.folder(dir)

    state = %{
      gateway: gateway,
      environment: settings.environment,
      tables: Tables.get(gateway),
      file: file,
      position: position,
      saved: position,
      gaps: Gaps.new(last),
      places: %{},
      window: Window.new(settings.max_events_in_flight),
      conn: nil,
      inbox: nil,
      hub: :down,
      dry: false,
      good_at: now() - @unknown_ms,
      asked_at: nil,
      heard_at: nil,
      backfill_to: 0,
      last: 0,
      lost: 0,
      stalled: nil,
      problem: nil
    }

    {:ok, put_info(state), {:continue, :start}}
  end

  @impl GenServer
  def handle_continue(:start, state), do: handle_info(:tick, state)

  @impl GenServer
  def handle_info(:tick, state) do
    Process.send_after(self(), :tick, @tick_ms)
    {:noreply, state |> connect() |> ask() |> check() |> send_overdue() |> pump() |> save() |> put_info()}
  end

  # The local stream has new events (`Aerie.Fleet.Bridge.Events`), or there are more to read.
  def handle_info(:pump, state) do
    flush_pumps()
    {:noreply, pump(%{state | dry: false})}
  end

  def handle_info({:msg, %{topic: topic} = message}, state) do
    if topic == "#{state.inbox}.hub",
      do: {:noreply, state |> receive_message(message) |> pump() |> put_info()},
      else: {:noreply, message |> answer(state) |> pump()}
  end

  def handle_info(_late, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, state), do: save(state)

  ## The connection and the hub

  defp connect(state) do
    case Connection.current(state.tables) do
      %{conn: conn, streams: :ok} when conn == state.conn -> state
      %{conn: conn, streams: :ok} -> subscribe(away(state), conn)
      _none -> if state.conn, do: away(state), else: state
    end
  end

  defp subscribe(state, conn) do
    inbox = "_INBOX.aerie-hub-#{Base.encode16(:crypto.strong_rand_bytes(9), case: :lower)}"

    case Nats.sub(conn, self(), inbox <> ".*") do
      {:ok, _sid} -> %{state | conn: conn, inbox: inbox, asked_at: nil, heard_at: now()}
      {:error, _lost} -> state
    end
  end

  # The local server is gone, and with it the way to the hub.
  defp away(state), do: again(down(%{state | conn: nil, inbox: nil}, nil))

  defp again(state) do
    %{
      state
      | window: Window.reset(state.window),
        position: Position.reset(state.position),
        gaps: Gaps.reset(state.gaps),
        places: %{}
    }
  end

  defp ask(%{conn: nil} = state), do: state

  defp ask(state) do
    state = if now() - state.heard_at > @silence_ms, do: silent(state), else: state

    if state.asked_at == nil or now() - state.asked_at >= @ask_ms do
      _lost = Nats.pub(state.conn, "hub.info", "", reply_to: state.inbox <> ".hub")
      %{state | asked_at: now()}
    else
      state
    end
  end

  # After a pause of this machine the answer waits here.
  defp silent(%{inbox: inbox} = state) do
    topic = "#{inbox}.hub"

    receive do
      {:msg, %{topic: ^topic} = message} -> receive_message(state, message)
    after
      0 -> down(state, "it does not answer")
    end
  end

  defp receive_message(state, message) do
    state = %{state | heard_at: now()}

    case Hub.answer(message) do
      :there -> up(state)
      {:away, why} -> down(state, why)
    end
  end

  defp up(%{hub: :up} = state), do: %{state | good_at: now()}
  defp up(%{conn: nil} = state), do: state

  # Without the local stream's end nobody knows what is history for the hub: then the next answer counts.
  defp up(state) do
    case Local.info(state.conn) do
      {:ok, born, last} ->
        Logger.notice("the hub is there")
        # Messages sent just before the last answer may have been lost.
        State.hub_up(state.gateway, state.good_at - @ask_ms)
        state = looked(%{state | hub: :up, problem: nil}, born, last)
        %{state | good_at: now(), backfill_to: state.last}

      {:error, _why} ->
        state
    end
  end

  defp down(%{hub: :down} = state, why), do: %{state | problem: why || state.problem}

  defp down(state, why) do
    Logger.warning("the hub is gone: #{why || "the local server is"}")
    %{state | hub: :down, problem: why, stalled: nil}
  end

  defp check(%{conn: nil} = state), do: state

  defp check(state) do
    case Local.info(state.conn) do
      {:ok, born, last} -> looked(state, born, last)
      {:error, _why} -> state
    end
  end

  defp looked(%{position: %{born: born} = position} = state, born, last),
    do: %{state | last: last, dry: last < position.next}

  # A stream that was deleted and recreated starts its numbers again.
  defp looked(state, born, last) do
    position = Position.of(state.position, born)
    %{again(state) | position: position, last: last, dry: false, backfill_to: last}
  end

  ## Events

  defp pump(%{hub: :up, conn: conn} = state) when conn != nil, do: state |> fill(@batch) |> send_ready()
  defp pump(state), do: state

  defp fill(%{dry: true} = state, _left), do: state

  defp fill(state, 0) do
    send(self(), :pump)
    state
  end

  defp fill(state, left),
    do: if(Window.size(state.window) >= 2 * state.window.max, do: state, else: read(state, left))

  defp read(state, left) do
    case Local.next(state.conn, state.position.next) do
      {:ok, message} ->
        state |> take(message) |> fill(left - 1)

      :none ->
        %{state | dry: true, position: %{state.position | next: max(state.position.next, state.last + 1)}}

      {:error, _why} ->
        state
    end
  end

  # A program aboard made it. The hub takes what is listed (`Aerie.Fleet.Bridge.Hub.Accounts`), and others must not wait for this one.
  defp take(state, %{seq: seq, record: %{subject: subject}} = message) do
    if Message.event?(subject) do
      wait(state, message)
    else
      if Store.claim(state.gateway, {__MODULE__, :unlisted}, @told_ms),
        do: Logger.warning("an event on #{subject} is not sent to the hub: there is no such type")

      Tables.count(state.tables, :events_dropped)
      %{state | position: state.position |> Position.read(seq) |> Position.confirm(seq)}
    end
  end

  defp wait(state, %{seq: seq, place: place} = message) do
    {missing, gaps} = Gaps.observe(state.gaps, place, true)
    if missing, do: Logger.error(Gaps.text(missing))

    marker =
      if missing,
        do: [{{:lost, seq, message.late?}, Gaps.marker(state.environment, missing, os_now())}],
        else: []

    items = marker ++ [{{:event, seq, message.late?}, message.record}]

    %{
      state
      | gaps: gaps,
        places: Map.put(state.places, seq, place),
        position: Position.read(state.position, seq),
        window: Window.put(state.window, items),
        lost: state.lost + Gaps.size(missing)
    }
  end

  defp send_ready(state) do
    case Window.next(state.window, now()) do
      {ref, item, window} -> %{state | window: window} |> publish(ref, item) |> send_ready()
      :none -> state
    end
  end

  defp send_overdue(%{hub: :up, conn: conn} = state) when conn != nil do
    state =
      state.window |> Window.overdue(now() - @answer_ms) |> Enum.sort() |> Enum.reduce(state, &send_again/2)

    silent? = Window.most_tries(state.window) > @patience and state.stalled == nil

    if silent?,
      do: stalled(state, "it confirms no event: #{Readiness.mend("the hub's nats-server")}"),
      else: state
  end

  defp send_overdue(state), do: state

  defp send_again(ref, state) do
    case Window.again(state.window, ref, now()) do
      {ref, item, _tries, window} -> publish(%{state | window: window}, ref, item)
      :none -> state
    end
  end

  defp publish(state, ref, {{_what, seq, late?}, record}) do
    late = if late? or seq <= state.backfill_to, do: [{"Aerie-Backfill", "true"}], else: []
    headers = [{"Nats-Msg-Id", record.id} | late]
    options = [reply_to: "#{state.inbox}.#{ref}", headers: headers]

    case Nats.pub(state.conn, "hub." <> record.subject, record.body, options) do
      :ok -> state
      {:error, reason} -> if PubAck.hopeless?(reason), do: give_up(state, ref, reason), else: state
    end
  end

  defp answer(message, state) do
    case PubAck.parse(message, state.inbox) do
      {:confirmed, ref, _duplicate?} ->
        confirmed(state, ref)

      {:refused, ref, reason} ->
        if PubAck.hopeless?(reason), do: give_up(state, ref, reason), else: refused(state, reason)

      :other ->
        state
    end
  end

  # It is sent again when it is overdue.
  defp refused(state, :no_stream), do: state
  defp refused(state, reason), do: stalled(state, "it does not take events: #{PubAck.text(reason)}")

  defp stalled(%{stalled: same} = state, same), do: state

  defp stalled(state, text) do
    Logger.error("the hub does not store events: #{text}")
    %{state | stalled: text}
  end

  defp stores(%{stalled: nil} = state), do: state

  defp stores(state) do
    Logger.notice("the hub confirms events again")
    %{state | stalled: nil}
  end

  defp give_up(state, ref, reason) do
    Logger.error("an event is not sent to the hub: #{PubAck.text(reason)}")
    Tables.count(state.tables, :events_dropped)
    confirmed(state, ref)
  end

  defp confirmed(state, ref) do
    case Window.confirm(state.window, ref) do
      {{:event, seq, _late?}, window} ->
        {place, places} = Map.pop(state.places, seq)
        Tables.count(state.tables, :hub_events)

        %{
          stores(state)
          | window: window,
            places: places,
            gaps: Gaps.confirm(state.gaps, place),
            position: Position.confirm(state.position, seq),
            problem: nil
        }

      {_marker_or_late, window} ->
        %{state | window: window}
    end
  end

  defp save(%{position: same, saved: same} = state), do: state

  defp save(state) do
    case Position.save(state.file, state.position, state.gaps.confirmed) do
      :ok -> %{state | saved: state.position}
      {:error, reason} -> %{state | problem: "cannot write #{state.file}: #{:file.format_error(reason)}"}
    end
  end

  defp put_info(state) do
    info = %{
      status: state.hub,
      waiting: max(state.last - Position.reached(state.position), 0),
      lost: state.lost,
      stalled: state.stalled,
      problem:
        if(state.hub == :down, do: Hub.refusal(Tables.info(state.tables, :leaf), now())) || state.stalled ||
          state.problem
    }

    if info != Tables.info(state.tables, :hub), do: Tables.put_info(state.gateway, state.tables, :hub, info)
    state
  end

  defp flush_pumps, do: receive(do: (:pump -> flush_pumps()), after: (0 -> :ok))

  defp now, do: System.monotonic_time(:millisecond)
  defp os_now, do: System.os_time(:microsecond)
end
