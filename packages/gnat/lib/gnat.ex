defmodule Gnat do
  @moduledoc """
  A client for NATS.

      {:ok, gnat} = Gnat.start_link(%{host: "127.0.0.1", port: 4222})
      {:ok, sid} = Gnat.sub(gnat, self(), "fleet.>")
      :ok = Gnat.pub(gnat, "fleet.news", "hello")

      receive do
        {:msg, %{topic: "fleet.news", body: "hello"}} -> :ok
      end

  One connection is one process. It ends when the connection does, with the reason `{:shutdown, %Gnat.Error{}}`. Functions called
  without a connection return `{:error, %Gnat.Error{reason: :not_connected}}`.

  Telemetry events, each after the function has returned; `latency` in native units:

  | event | measurements | metadata |
  |---|---|---|
  | `[:gnat, :pub]`, `[:gnat, :sub]`, `[:gnat, :request]`, `[:gnat, :request_multi]` | `latency` | `topic` |
  | `[:gnat, :unsub]` | `latency` | |
  | `[:gnat, :message_received]` | `count` (1) | `topic` |
  | `[:gnat, :server_error]` | `count` (1) | `message` |
  """

  alias Gnat.{Command, Connection, Error, Handshake, Headers}

  @type t :: GenServer.server()
  @type headers :: [{binary(), iodata()}]

  @typedoc """
  A message as a subscriber gets it, in `{:msg, message}`.

    * `topic`, `body`: the subject it was published to, and the bytes
    * `reply_to`: where an answer is expected, nil if nowhere
    * `sid`: the subscription (not in answers to requests)
    * `gnat`: the connection process
    * `headers`: only if there are any; names in lower case, in the order of arrival
    * `status`, `description`: with headers, the server's status of the message, such as `"503"`; else nil
  """
  @type message :: %{
          required(:gnat) => pid(),
          required(:topic) => String.t(),
          required(:body) => binary(),
          required(:reply_to) => String.t() | nil,
          optional(:sid) => non_neg_integer(),
          optional(:headers) => [{String.t(), String.t()}],
          optional(:status) => String.t() | nil,
          optional(:description) => String.t() | nil
        }
  @type sent_message :: {:msg, message()}

  @typedoc """
  Where and how to connect. Times in milliseconds.

    * `host` - name or address, default `"localhost"`
    * `port` - default 4222
    * `connection_timeout` - for all of connecting, TLS and logging in; default 3000
    * `ping_interval` - how often the server is pinged; the connection is given up after one to two intervals without any
      data; default 10000
    * `send_timeout` - how long a write may wait for a server that does not read; default 10000
    * `tls` - require TLS; a server that requires it gets it anyway. Default false
    * `ssl_opts` - options for `:ssl.connect/3`, by default the system's authorities and the name of the host are checked
    * `tcp_opts` - options for `:gen_tcp.connect/4`, like `[:inet6]`
    * `username` and `password`, or `token`, or `nkey_seed`, or `jwt` and `nkey_seed`
    * `auth_required` - send credentials even if the server does not ask; default false
    * `no_responders` - a request without any subscriber fails at once; default false
    * `headers` - default true
    * `inbox_prefix` - subject prefix of the answers to requests, default `"_INBOX."`
    * `name` - shown by the server's monitoring
  """
  @type connection_settings :: %{
          optional(:host) => String.t() | charlist() | :inet.ip_address(),
          optional(:port) => :inet.port_number(),
          optional(:connection_timeout) => pos_integer(),
          optional(:ping_interval) => pos_integer(),
          optional(:send_timeout) => pos_integer(),
          optional(:tls) => boolean(),
          optional(:ssl_opts) => [:ssl.tls_client_option()],
          optional(:tcp_opts) => [:gen_tcp.connect_option()],
          optional(:username) => String.t(),
          optional(:password) => String.t(),
          optional(:token) => String.t(),
          optional(:nkey_seed) => String.t(),
          optional(:jwt) => String.t(),
          optional(:auth_required) => boolean(),
          optional(:no_responders) => boolean(),
          optional(:headers) => boolean(),
          optional(:inbox_prefix) => String.t(),
          optional(:name) => String.t()
        }

  @typedoc "INFO as the server sent it last: `version`, `max_payload`, `jetstream`, `headers`, `server_name` and others."
  @type server_info :: %{optional(atom()) => term()}

  @type sid :: non_neg_integer()

  @doc "A connection as a child of a supervisor."
  @spec child_spec(connection_settings()) :: Supervisor.child_spec()
  def child_spec(settings), do: %{id: __MODULE__, start: {__MODULE__, :start_link, [settings]}}

  @doc """
  Connects and logs in, then starts the process of the connection, linked to the caller.

  Returns when the server has accepted the connection, after `connection_timeout` at the latest. A failure is a
  `Gnat.Error` only: no process was started, so no exit signal comes. `opts` are those of
  `GenServer.start_link/3`, such as `:name`.
  """
  @spec start_link(connection_settings(), GenServer.options()) ::
          {:ok, pid()} | {:error, Error.t() | {:already_started, pid()}}
  def start_link(settings \\ %{}, opts \\ []) do
    with {:ok, handshake} <- Handshake.connect(settings), do: Connection.start_link(handshake, opts)
  end

  @doc "Closes the connection."
  @spec stop(t()) :: :ok
  def stop(gnat) do
    _ = call(gnat, :stop)
    :ok
  end

  @doc """
  Subscribes a process to a subject, which may have wildcards (`*` one token, `>` the rest).

  With `queue_group: name` each message goes to one member of the group only. The subscription ends with the process.
  """
  @spec sub(t(), pid(), String.t(), queue_group: String.t()) :: {:ok, sid()} | {:error, Error.t()}
  def sub(gnat, subscriber, topic, opts \\ []) do
    started = System.monotonic_time()
    result = call(gnat, {:sub, subscriber, topic, opts[:queue_group]})
    measure(:sub, started, %{topic: topic})
    result
  end

  @doc """
  Publishes. `:ok` means written to the connection; only a request or JetStream shows whether somebody received it.

    * `reply_to: subject`
    * `headers: [{name, value}]`
  """
  @spec pub(t(), String.t(), iodata(), reply_to: String.t(), headers: headers()) :: :ok | {:error, Error.t()}
  def pub(gnat, topic, message, opts \\ []) do
    started = System.monotonic_time()
    headers = opts[:headers] || []

    result =
      with {:ok, command, size} <- Command.pub(topic, message, opts[:reply_to], headers),
           [result] <- call(gnat, {:pub, [{command, size, headers != []}]}) do
        result
      end

    measure(:pub, started, %{topic: topic})
    result
  end

  @doc """
  Publishes messages in one write, which is most of what a small one costs. Gives their results in the same order. Not in the Hex
  package.
  """
  @spec pub_all(t(), [{String.t(), iodata()}]) :: [:ok | {:error, Error.t()}]
  def pub_all(gnat, messages) do
    started = System.monotonic_time()
    built = for {topic, message} <- messages, do: Command.pub(topic, message, nil, [])
    commands = for {:ok, command, size} <- built, do: {command, size, false}
    sent = if commands == [], do: [], else: call(gnat, {:pub, commands})
    sent = with {:error, _} = error <- sent, do: List.duplicate(error, length(commands))
    for {topic, _message} <- messages, do: measure(:pub, started, %{topic: topic})
    results(built, sent)
  end

  defp results([{:ok, _command, _size} | built], [result | sent]), do: [result | results(built, sent)]
  defp results([error | built], sent), do: [error | results(built, sent)]
  defp results([], []), do: []

  @doc """
  Publishes and waits for one answer.

    * `receive_timeout` - milliseconds, default 60000
    * `headers`

  `{:error, :no_responders}` comes at once if nobody listens and the connection has `no_responders: true`. A late
  answer is dropped and does not stay in the mailbox.
  """
  @spec request(t(), String.t(), iodata(), receive_timeout: timeout(), headers: headers()) ::
          {:ok, message()} | {:error, :timeout | :no_responders | Error.t()}
  def request(gnat, topic, body, opts \\ []) do
    started = System.monotonic_time()

    result =
      with {:ok, [answer]} <- ask(gnat, topic, body, opts, 1) do
        {:ok, answer}
      else
        {:ok, []} -> {:error, :timeout}
        {:error, _} = error -> error
      end

    measure(:request, started, %{topic: topic})
    result
  end

  @doc """
  Publishes and collects answers until the timeout or until there are enough.

    * `receive_timeout` - milliseconds, default 60000
    * `max_messages` - default -1: as many as come
    * `headers`
  """
  @spec request_multi(t(), String.t(), iodata(),
          receive_timeout: timeout(),
          max_messages: integer(),
          headers: headers()
        ) :: {:ok, [message()]} | {:error, :no_responders | Error.t()}
  def request_multi(gnat, topic, body, opts \\ []) do
    started = System.monotonic_time()
    result = ask(gnat, topic, body, opts, Keyword.get(opts, :max_messages, -1))
    measure(:request_multi, started, %{topic: topic})
    result
  end

  @doc """
  Ends a subscription: now, or when it has received `max_messages: n` messages, counted from its beginning.
  An unknown one is not an error.
  """
  @spec unsub(t(), sid() | String.t(), max_messages: pos_integer()) :: :ok | {:error, Error.t()}
  def unsub(gnat, sid, opts \\ []) do
    started = System.monotonic_time()
    result = call(gnat, {:unsub, sid, opts[:max_messages]})
    measure(:unsub, started, %{})
    result
  end

  @doc "The number of subscriptions, including the connection's own for answers to requests."
  @spec active_subscriptions(t()) :: {:ok, pos_integer()} | {:error, Error.t()}
  def active_subscriptions(gnat), do: call(gnat, :active_subscriptions)

  @doc "The server's INFO. Exits without a connection."
  @spec server_info(t()) :: server_info()
  def server_info(gnat), do: GenServer.call(gnat, :server_info, answer_ms())

  @doc """
  Waits until the server has taken everything sent so far. Not in the Hex package.
  """
  @spec flush(t(), timeout()) :: :ok | {:error, Error.t()}
  def flush(gnat, timeout \\ answer_ms()), do: call(gnat, :flush, timeout)

  @doc false
  # How long an answer may take where nothing else is said; tests give it more.
  @spec answer_ms() :: pos_integer()
  def answer_ms, do: Application.get_env(:gnat, :answer_ms, 5_000)

  @doc "Does nothing: the connection pings by itself."
  @deprecated "The connection pings by itself"
  @spec ping(t()) :: :ok
  def ping(_gnat), do: :ok

  # The answers go to the monitor's alias. The demonitor ends it, so late answers are dropped. Every receive matches the
  # reference made here, so a long mailbox is not searched.
  defp ask(gnat, topic, body, opts, max) do
    timeout = Keyword.get(opts, :receive_timeout, 60_000)
    headers = Keyword.get(opts, :headers, [])
    count = if max == 1, do: :one, else: :many

    with :ok <- Command.check(topic),
         {:ok, _block} <- Headers.encode(headers),
         {:ok, pid} <- whereis(gnat) do
      alias = Process.monitor(pid, alias: :demonitor)

      try do
        with {:ok, inbox} <- call(pid, {:request, alias, count, {topic, body, headers}}) do
          result = collect(alias, expiry(timeout), max, [])
          unless answered?(count, result), do: GenServer.cast(pid, {:unsub, inbox})
          result
        end
      after
        Process.demonitor(alias, [:flush])
        drop(alias)
      end
    end
  end

  defp answered?(:one, {:ok, [_]}), do: true
  defp answered?(_count, _result), do: false

  defp collect(_alias, _expiry, 0, answers), do: {:ok, Enum.reverse(answers)}

  defp collect(alias, expiry, left, answers) do
    receive do
      {^alias, %{status: "503"}} -> {:error, :no_responders}
      {^alias, message} -> collect(alias, expiry, left - 1, [message | answers])
      {:DOWN, ^alias, :process, _pid, reason} -> {:error, lost(reason)}
    after
      left(expiry) -> {:ok, Enum.reverse(answers)}
    end
  end

  defp drop(alias) do
    receive do
      {^alias, _message} -> drop(alias)
    after
      0 -> :ok
    end
  end

  defp expiry(:infinity), do: :infinity
  defp expiry(timeout), do: System.monotonic_time(:millisecond) + timeout

  defp left(:infinity), do: :infinity
  defp left(expiry), do: max(expiry - System.monotonic_time(:millisecond), 0)

  defp whereis(gnat) do
    case GenServer.whereis(gnat) do
      pid when is_pid(pid) -> {:ok, pid}
      {_name, _node} = remote -> {:ok, remote}
      nil -> {:error, Error.new(:not_connected)}
    end
  end

  defp call(gnat, request, timeout \\ 30_000) do
    GenServer.call(gnat, request, timeout)
  catch
    :exit, {reason, {GenServer, :call, _}} -> {:error, lost(reason)}
  end

  defp lost({:shutdown, %Error{} = error}), do: error
  defp lost(:timeout), do: Error.new(:timeout)
  defp lost(_noproc_or_other), do: Error.new(:not_connected)

  defp measure(event, started, metadata) do
    :telemetry.execute([:gnat, event], %{latency: System.monotonic_time() - started}, metadata)
  end
end
