defmodule Gnat do
  @moduledoc """
  A client for NATS.

      {:ok, gnat} = Gnat.start_link(%{host: "127.0.0.1", port: 4222})
      {:ok, sid} = Gnat.sub(gnat, self(), "fleet.>")
      :ok = Gnat.pub(gnat, "fleet.news", "hello")

      receive do
        {:msg, %{topic: "fleet.news", body: "hello"}} -> :ok
      end

  One connection is one process. It ends when the connection does, with the reason `{:shutdown, %Gnat.Error{}}`.
  Functions called without a connection return `{:error, %Gnat.Error{reason: :not_connected}}`.

  Each error that the server reports is the telemetry event `[:gnat, :server_error]`, with `count: 1` and its text as
  `message`.
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
  def sub(gnat, subscriber, topic, opts \\ []),
    do: call(gnat, {:sub, subscriber, topic, opts[:queue_group]})

  @doc """
  Publishes. `:ok` means written to the connection; only a request or JetStream shows whether somebody received it.

    * `reply_to: subject`
    * `headers: [{name, value}]`
  """
  @spec pub(t(), String.t(), iodata(), reply_to: String.t(), headers: headers()) :: :ok | {:error, Error.t()}
  def pub(gnat, topic, message, opts \\ []) do
    headers = opts[:headers] || []

    with {:ok, command, size} <- Command.pub(topic, message, opts[:reply_to], headers),
         [result] <- call(gnat, {:pub, [{command, size, headers != []}]}),
         do: result
  end

  @doc """
  Publishes messages in one write, which is most of what a small one costs. Gives their results in the same order. Not in the Hex
  package.
  """
  @spec pub_all(t(), [{String.t(), iodata()}]) :: [:ok | {:error, Error.t()}]
  def pub_all(gnat, messages) do
    built = for {topic, message} <- messages, do: Command.pub(topic, message, nil, [])
    commands = for {:ok, command, size} <- built, do: {command, size, false}
    sent = if commands == [], do: [], else: call(gnat, {:pub, commands})
    sent = with {:error, _} = error <- sent, do: List.duplicate(error, length(commands))
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
    timeout = Keyword.get(opts, :receive_timeout, 60_000)
    headers = Keyword.get(opts, :headers, [])

    with :ok <- Command.check(topic),
         {:ok, _block} <- Headers.encode(headers),
         {:ok, pid} <- whereis(gnat) do
      alias = Process.monitor(pid, alias: :demonitor)

      try do
        with {:ok, inbox} <- call(pid, {:request, alias, {topic, body, headers}}),
             do: answer(alias, timeout, pid, inbox)
      after
        Process.demonitor(alias, [:flush])
        drop(alias)
      end
    end
  end

  # The answer goes to the monitor's alias. The demonitor ends it, so a late answer is dropped. Every receive matches
  # the reference made here, so a long mailbox is not searched.
  defp answer(alias, timeout, pid, inbox) do
    receive do
      {^alias, %{status: "503"}} -> {:error, :no_responders}
      {^alias, message} -> {:ok, message}
      {:DOWN, ^alias, :process, _pid, reason} -> {:error, lost(reason)}
    after
      timeout ->
        GenServer.cast(pid, {:forget, inbox})
        {:error, :timeout}
    end
  end

  @doc """
  Ends a subscription. An unknown one is not an error.
  """
  @spec unsub(t(), sid()) :: :ok | {:error, Error.t()}
  def unsub(gnat, sid), do: call(gnat, {:unsub, sid})

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

  defp drop(alias) do
    receive do
      {^alias, _message} -> drop(alias)
    after
      0 -> :ok
    end
  end

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
end
