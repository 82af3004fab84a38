defmodule Aerie.BridgeCase do
  @moduledoc """
  Tests of the bridge against the real nats-server: a store, notices and a bridge of their own, folders of their own, any
  free port. Nothing is shared, so all are async.
  """
  use ExUnit.CaseTemplate

  alias Aerie.Base.Store
  alias Aerie.Fleet.Bridge
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.PubSub
  alias Aerie.Vehicle.Event

  using do
    quote do
      import Aerie.BridgeCase
      alias Aerie.Base.Store
      alias Aerie.Fleet
      alias Aerie.Fleet.Bridge
      alias Aerie.Base.PubSub
      alias Aerie.Vehicle.Event
    end
  end

  @doc "The bridge's settings, with folders below `dir`. Overrides are keys of the configuration, as `{\"nats.port\", 0}`."
  @spec config(Path.t(), [{String.t(), term()}]) :: Bridge.Settings.t()
  def config(dir, overrides \\ []) do
    settings(
      [
        {"environment", "test"},
        {"nats.port", 0},
        {"nats.store_dir", Path.join(dir, "nats")},
        {"outbox.dir", Path.join(dir, "outbox")},
        {"nats.retry_min_ms", 20},
        {"nats.retry_max_ms", 200}
      ] ++ overrides
    )
  end

  @doc "The bridge's settings with some keys of the configuration; a `nats.port` is one that somebody asked for."
  @spec settings([{String.t(), term()}]) :: Bridge.Settings.t()
  def settings(overrides \\ []) do
    raw =
      Enum.reduce(overrides, %{}, fn {key, value}, raw ->
        put_in(raw, key |> String.split(".") |> Enum.map(&Access.key(&1, %{})), value)
      end)

    case Bridge.Settings.new(raw) do
      {:ok, settings} -> %{settings | port_given: List.keymember?(overrides, "nats.port", 0)}
      {:error, problems} -> raise ArgumentError, inspect(problems)
    end
  end

  @doc "Starts store, notices and bridge; gives the gateway's name. `epoch`: of the events, none if left out."
  @spec start_bridge(Bridge.Settings.t(), keyword()) :: reference()
  def start_bridge(config, options \\ []) do
    gateway = Keyword.get_lazy(options, :gateway, &make_ref/0)
    # Subscribed before there is anything to hear, so that no news is missed.
    ExUnit.Callbacks.start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})},
      id: {:store, gateway}
    )

    if options[:epoch], do: Journal.epoch(gateway, options[:epoch])
    ExUnit.Callbacks.start_supervised!({PubSub, gateway: gateway}, id: {:pubsub, gateway})
    tell_news(gateway)
    start_bridge_again(gateway, config)
    gateway
  end

  # A test has several gateways, so each piece of news says whose it is.
  defp tell_news(gateway) do
    test = self()

    ExUnit.Callbacks.start_supervised!(
      {Task,
       fn ->
         :ok = PubSub.subscribe(gateway, :bridge)
         send(test, {:listening, gateway})
         pass_on(test, gateway)
       end},
      id: {:news, gateway}
    )

    receive do: ({:listening, ^gateway} -> :ok)
  end

  defp pass_on(test, gateway) do
    receive do
      {:fleet, :bridge, {part, info}} -> send(test, {:news, gateway, part, info})
    end

    pass_on(test, gateway)
  end

  @doc "Starts the bridge of a gateway whose store is there already."
  @spec start_bridge_again(reference(), Bridge.Settings.t()) :: pid()
  def start_bridge_again(gateway, config) do
    ExUnit.Callbacks.start_supervised!({Bridge.Supervisor, gateway: gateway, settings: config},
      id: {:bridge, gateway}
    )
  end

  @doc "Ends the bridge in order. News from before are forgotten: `await/4` is to see those of the next one."
  @spec stop_bridge(reference()) :: :ok
  def stop_bridge(gateway) do
    ExUnit.Callbacks.stop_supervised!({:bridge, gateway})
    forget_news()
  end

  @doc """
  Waits until a part of the bridge is as `fun` wants it, or was since the last `forget_news/0`. What changes a part in a test forgets
  the news from before, as `kill9/1` does.
  """
  @spec await(reference(), atom(), (map() -> as_boolean(term())), timeout()) :: map()
  def await(gateway, part, fun, timeout \\ Aerie.Patience.ms()) do
    deadline = System.monotonic_time(:millisecond) + timeout
    info = gateway |> Bridge.Status.Tables.get() |> info(part)
    if info && fun.(info), do: info, else: await_news(gateway, part, fun, deadline)
  end

  # The tables are gone while the bridge restarts.
  defp info(nil, _part), do: nil
  defp info(tables, part), do: Bridge.Status.Tables.info(tables, part)

  defp await_news(gateway, part, fun, deadline) do
    receive do
      {:news, ^gateway, ^part, info} ->
        if fun.(info), do: info, else: await_news(gateway, part, fun, deadline)
    after
      max(deadline - System.monotonic_time(:millisecond), 0) ->
        ExUnit.Assertions.flunk("no such news of #{part}")
    end
  end

  @doc "Waits until the connection and the streams are there; gives the URL, with the embedded server's login."
  @spec await_up(reference()) :: String.t()
  def await_up(gateway) do
    await(gateway, :connection, &(&1[:status] == :up and &1[:streams] == :ok))
    login_url(gateway)
  end

  # The connection may be up before the server's own process has told its address.
  defp login_url(gateway), do: eventually(fn -> Bridge.login_url(gateway) end)

  @doc """
  Waits until the commands of these vehicles are listened to. The answer to a request on the bridge's own connection shows that the
  server knows the subscriptions: a request of another connection may otherwise overtake them and be lost.
  """
  @spec await_listening(reference(), [String.t()]) :: :ok
  def await_listening(gateway, vehicles) do
    eventually(fn -> Bridge.Commands.vehicles(gateway) == vehicles end)
    %{conn: conn} = gateway |> Bridge.Status.Tables.get() |> Bridge.Connection.current()
    {:ok, _info} = answered(conn, fn -> Gnat.request(conn, "$JS.API.INFO", "") end)
    :ok
  end

  @doc "Waits until there is another connection than `old`, with its streams; gives the URL, as `await_up/1`."
  @spec await_reconnected(reference(), pid()) :: String.t()
  def await_reconnected(gateway, old) do
    eventually(fn ->
      current = with %{} = tables <- Bridge.Status.Tables.get(gateway), do: Bridge.Connection.current(tables)
      match?(%{streams: :ok, conn: conn} when is_pid(conn), current) and current.conn != old
    end)

    login_url(gateway)
  end

  @doc "What `Gnat.Jetstream.API.Stream.info/2` says of a stream."
  @spec stream(pid(), String.t()) :: map()
  def stream(conn, name) do
    {:ok, info} = answered(conn, fn -> Gnat.Jetstream.API.Stream.info(conn, name) end)
    info
  end

  @doc "The last message of a stream on a subject, as soon as there is one."
  @spec last(pid(), String.t(), String.t()) :: map()
  def last(conn, stream, subject) do
    by = %{last_by_subj: subject}
    get = fn -> Gnat.Jetstream.API.Stream.get_message(conn, stream, by) end

    {:ok, message} =
      eventually(fn -> with {:error, %{"code" => 404}} <- answered(conn, get), do: nil end)

    message
  end

  @doc "Deletes a stream; one that is gone was deleted by a request whose answer was late."
  @spec delete_stream(pid(), String.t()) :: :ok
  def delete_stream(conn, name) do
    :ok =
      answered(conn, fn ->
        with {:error, %{"code" => 404}} <- Gnat.Jetstream.API.Stream.delete(conn, name), do: :ok
      end)
  end

  @doc "The TCP port of a nats-server that was started as an operating system process, from its output."
  def listening(port) do
    assert_receive {^port, {:data, {:eol, line}}}

    case Aerie.Fleet.Bridge.NatsServer.LogLine.parse(line) do
      {_level, _text, {:listening, tcp_port}} -> tcp_port
      _other -> listening(port)
    end
  end

  @doc "A plain client on the bridge's server."
  @spec client(String.t()) :: pid()
  def client(url) do
    uri = URI.parse(url)
    login = if uri.userinfo, do: %{token: uri.userinfo}, else: %{}
    at = %{host: uri.host, port: uri.port, connection_timeout: Aerie.Patience.ms()}
    {:ok, conn} = Gnat.start_link(Map.merge(login, at))
    conn
  end

  @doc """
  Connects with settings of `Aerie.Fleet.Nats.connect/1`, and waits until the server has accepted the login, which not every client does. The
  caller traps exits.
  """
  @spec log_in(map()) :: {:ok, pid()} | {:error, term()}
  def log_in(settings) do
    with {:ok, conn} <-
           settings |> Map.put_new(:connection_timeout, Aerie.Patience.ms()) |> Aerie.Fleet.Nats.connect(),
         {:ok, _info} <-
           Aerie.Fleet.Nats.request(conn, "$JS.API.INFO", "", receive_timeout: Aerie.Patience.ms()),
         do: {:ok, conn}
  end

  @doc "Whether the NATS client is the one in `packages/`, which says why a server refuses it (`AERIE_PACKAGES`)."
  @spec own_client?() :: boolean()
  def own_client?, do: System.get_env("AERIE_PACKAGES", "") == ""

  @doc "A URL without its login, as the gateway shows it to everybody."
  @spec bare(String.t()) :: String.t()
  def bare(url), do: String.replace(url, ~r|//.*@|, "//")

  @doc "The process of the system that is the embedded server."
  @spec server_pid(Path.t()) :: String.t()
  def server_pid(dir), do: dir |> Path.join("nats/nats-server.pid") |> File.read!() |> String.trim()

  @doc "`kill -9`. Drops earlier messages, so that `await/4` sees only later ones."
  @spec kill9(String.t()) :: :ok
  def kill9(pid) do
    forget_news()
    Aerie.OtherVM.kill9(pid)
  end

  @doc "See `Aerie.OtherVM.other_vm/3`."
  @spec other_vm(String.t(), String.t(), [String.t()]) :: {port(), String.t()}
  defdelegate other_vm(script, mark, before \\ []), to: Aerie.OtherVM

  @doc "What was told so far does not count."
  @spec forget_news() :: :ok
  def forget_news do
    receive do
      {:news, _gateway, _part, _info} -> forget_news()
    after
      0 -> :ok
    end
  end

  @doc "Events `seqs` of a vehicle, into the journal."
  @spec commit(reference(), String.t(), Enumerable.t()) :: [Event.t()]
  def commit(gateway, vehicle, seqs) do
    events =
      for seq <- seqs,
          do: Event.new(vehicle, "statustext", seq, 1_700_000_000_000_000 + seq, seq, %{"n" => seq})

    :ok = Journal.commit(gateway, vehicle, :some_state, events)
    events
  end

  @doc "Waits until nothing is on its way: neither in the journal nor in the outbox. It goes on as long as events are confirmed."
  @spec await_empty(reference(), left :: non_neg_integer() | :infinity) :: :ok
  def await_empty(gateway, than \\ :infinity) do
    fewer = fn ->
      # In this order: from the journal they go to the outbox.
      pending = Journal.pending_size(gateway)

      with %{events: stored} when pending + stored < than <- outbox(gateway),
           do: {pending + stored},
           else: (_ -> nil)
    end

    what = fn -> "events were confirmed: #{inspect(waiting(gateway), pretty: true, limit: 20)}" end

    with {left} when left > 0 <- Aerie.Patience.eventually(fewer, what),
         do: await_empty(gateway, left),
         else: (_none -> :ok)
  end

  @doc "What events of a gateway wait for, for a test that failed."
  @spec waiting(reference()) :: map()
  def waiting(gateway) do
    tables = Bridge.Status.Tables.get(gateway)

    state =
      with pid when is_pid(pid) <- Aerie.Base.Names.whereis(gateway, :bridge_events),
           do:
             pid
             |> :sys.get_state()
             |> Map.take([:conn, :problem, :refusal, :stall, :silent?, :window])
             |> shown()

    %{
      pending: Journal.pending_size(gateway),
      outbox: outbox(gateway),
      connection: Bridge.Connection.current(tables),
      problem: Bridge.Status.Tables.problem(tables),
      events: state
    }
  end

  defp shown(%{window: window} = state) do
    now = System.monotonic_time(:millisecond)

    sent =
      for {_ref, {{key, _record}, at, tries}} <- window.in_flight,
          do: %{key: key, ms_ago: now - at, tries: tries}

    %{state | window: %{events: MapSet.size(window.keys), ready: :queue.len(window.ready), in_flight: sent}}
  end

  # As it is now: what the bridge shows of it is up to half a second old.
  defp outbox(gateway) do
    with pid when is_pid(pid) <- Aerie.Base.Names.whereis(gateway, :bridge_events),
         %{outbox: outbox} when outbox != nil <- :sys.get_state(pid, Aerie.Patience.ms()),
         do: Bridge.Events.Outbox.stats(outbox)
  catch
    :exit, _killed -> nil
  end

  @doc """
  All events in the streams of a server, `FLEET_EVENTS` or at a hub one of each vehicle, in each one's order, as `{vehicle, seq, headers}`.
  """
  @spec events(pid()) :: [{String.t(), pos_integer(), String.t()}]
  def events(conn) do
    for stream <- event_streams(conn),
        {:ok, %{state: %{first_seq: first, last_seq: last}}} =
          answered(conn, fn -> Gnat.Jetstream.API.Stream.info(conn, stream) end),
        # An empty stream has first 0 or 1 and last 0.
        seq <- max(first, 1)..last//1,
        message = message(conn, stream, seq) do
      body = JSON.decode!(message.data)
      {body["vehicle"], body["seq"], message.hdrs || ""}
    end
  end

  @doc "The names of the streams of events that a server has."
  @spec event_streams(pid()) :: [String.t()]
  def event_streams(conn) do
    {:ok, %{streams: streams}} = answered(conn, fn -> Gnat.Jetstream.API.Stream.list(conn) end)
    for "FLEET_EVENTS" <> _vehicle = name <- Enum.sort(streams || []), do: name
  end

  @doc """
  The answer to a request that does no harm when it is made again: on a busy machine a server may take longer than the five
  seconds that a client waits.
  """
  @spec answered(pid(), (-> answer)) :: answer when answer: term()
  def answered(conn, request) do
    eventually(fn ->
      # 503: servers that stood still elect their leaders again.
      case Aerie.Fleet.Nats.call(conn, request) do
        {:error, :timeout} -> nil
        {:error, %{"code" => 503}} -> nil
        answer -> answer
      end
    end)
  end

  defp message(conn, stream, seq) do
    case answered(conn, fn -> Gnat.Jetstream.API.Stream.get_message(conn, stream, %{seq: seq}) end) do
      {:ok, message} -> message
      {:error, %{"code" => 404}} -> nil
    end
  end

  @doc "A counter of the bridge, summed over its labels."
  @spec metric(reference(), String.t()) :: number()
  def metric(gateway, name) do
    for(%{name: ^name, samples: samples} <- Bridge.metrics(gateway), {_labels, n} <- samples, do: n)
    |> Enum.sum()
  end

  @doc "See `Aerie.Patience.eventually/1`."
  @spec eventually((-> result)) :: result when result: term()
  defdelegate eventually(fun), to: Aerie.Patience
end
