defmodule Aerie.Fleet.Nats do
  @moduledoc """
  The only way to NATS: what Aerie uses of the client `Gnat`, with the same results from the one in `packages/` and from
  the Hex package (`AERIE_PACKAGES`).

  Nothing here exits: without a connection, or if it ends meanwhile, the result is an error. Reasons are terms of the
  client; `text/1` says them to a person. A program may want `:timeout`, `:no_responders`, `{:too_large, bytes, max}`
  and the maps of JetStream (`"err_code"`).
  """

  @timeout_ms 5_000
  # The client in `packages/`, not the one from Hex.
  @ours Code.ensure_loaded?(Gnat) and function_exported?(Gnat, :pub_all, 2)

  @type conn :: pid()
  @type reason :: :timeout | :no_responders | {:too_large, pos_integer(), pos_integer()} | map() | term()
  @type headers :: [{String.t(), String.t()}]
  @typedoc """
  `topic`, `body`, `reply_to`, `headers` (lower case; only if there are any), `status` (with headers), `sid`, `gnat`.
  """
  @type message :: Gnat.message()

  @doc """
  Connects, and links the connection to the caller, who must trap exits. A refused login may show only in its end.
  """
  @spec connect(map()) :: {:ok, conn()} | {:error, reason()}
  def connect(settings), do: safely(fn -> Gnat.start_link(settings) end)

  @doc "Publishes: `reply_to`, `headers`."
  @spec pub(conn(), String.t(), iodata(), reply_to: String.t(), headers: headers()) ::
          :ok | {:error, reason()}
  def pub(conn, subject, body, options \\ []) do
    safely(fn -> with :ok <- fits(conn, body, options), do: Gnat.pub(conn, subject, body, options) end)
  end

  @doc """
  Publishes several messages, each as by `pub/4`, in one write if the client can. Gives their results in the same order.
  """
  @spec pub_all(conn(), [{String.t(), iodata()}]) :: [:ok | {:error, reason()}]
  if @ours do
    def pub_all(conn, messages), do: conn |> Gnat.pub_all(messages) |> Enum.map(&result/1)
  else
    def pub_all(conn, messages), do: Enum.map(messages, fn {subject, body} -> pub(conn, subject, body) end)
  end

  @doc "Subscribes a process, which gets `{:msg, message}`: `queue_group`."
  @spec sub(conn(), pid(), String.t(), queue_group: String.t()) :: {:ok, sid :: term()} | {:error, reason()}
  def sub(conn, subscriber, subject, options \\ []),
    do: safely(fn -> Gnat.sub(conn, subscriber, subject, options) end)

  @doc "Ends a subscription."
  @spec unsub(conn(), sid :: term()) :: :ok | {:error, reason()}
  def unsub(conn, sid), do: safely(fn -> Gnat.unsub(conn, sid) end)

  @doc "Asks, and waits for one answer: `receive_timeout` (ms), `headers`."
  @spec request(conn(), String.t(), iodata(), receive_timeout: pos_integer(), headers: headers()) ::
          {:ok, message()} | {:error, reason()}
  def request(conn, subject, body, options) do
    timeout = Keyword.get(options, :receive_timeout, @timeout_ms)

    with :ok <- safely(fn -> fits(conn, body, options) end),
         do: call(conn, fn -> Gnat.request(conn, subject, body, options) end, timeout + @timeout_ms)
  end

  @doc """
  Calls a function of the client that waits for the server, such as those of `Gnat.Jetstream.API.Stream`, in a process
  of its own: a client may wait on when its connection has ended, and leave a late answer in the caller's mailbox.
  `timeout` in ms.
  """
  @spec call(conn(), (-> result), timeout :: pos_integer()) :: result | {:error, reason()} when result: term()
  def call(conn, fun, timeout \\ @timeout_ms) do
    connection = Process.monitor(conn)
    {pid, call} = spawn_monitor(fn -> exit({:answer, safely(fun)}) end)

    receive do
      {:DOWN, ^call, :process, ^pid, reason} ->
        Process.demonitor(connection, [:flush])
        with {:answer, answer} <- reason, do: answer, else: (crash -> {:error, crash})

      {:DOWN, ^connection, :process, _conn, reason} ->
        given_up(pid, call, lost(reason))
    after
      timeout ->
        Process.demonitor(connection, [:flush])
        given_up(pid, call, :timeout)
    end
  end

  defp given_up(pid, call, reason) do
    Process.demonitor(call, [:flush])
    Process.exit(pid, :kill)
    {:error, reason}
  end

  defp safely(fun) do
    result(fun.())
  catch
    :exit, {reason, {GenServer, :call, _call}} -> {:error, lost(reason)}
    :exit, reason -> {:error, lost(reason)}
  end

  defp result({:error, %{reason: {:payload_too_large, bytes, max}}}), do: {:error, {:too_large, bytes, max}}
  defp result(result), do: result

  defp lost(reason) when reason in [:noproc, :normal, :killed, :shutdown],
    do: "the connection to NATS was lost"

  defp lost(reason), do: reason

  # A server ends the connection of a client that sends more, so the message would be sent again and again. The client
  # in `packages/` knows the limit; for the one from Hex it is asked for.
  if @ours do
    defp fits(_conn, _body, _options), do: :ok
  else
    defp fits(conn, body, options) do
      headers = for {name, value} <- options[:headers] || [], do: byte_size(name) + byte_size(value) + 4
      bytes = IO.iodata_length(body) + Enum.sum(headers)

      case Gnat.server_info(conn) do
        %{max_payload: max} when bytes > max -> {:error, {:too_large, bytes, max}}
        _fits -> :ok
      end
    end
  end

  @doc "A reason as text."
  @spec text(reason()) :: String.t()
  def text(%{"description" => description}), do: description
  def text(:no_responders), do: "the server has no JetStream"
  def text(:timeout), do: "no answer"

  def text({:too_large, bytes, max}),
    do: "the message has #{bytes} bytes, the NATS server takes #{max} at most"

  def text({:shutdown, reason}), do: text(reason)
  # A crash of the client.
  def text({{:badmatch, {:error, reason}}, [_ | _]}), do: text(reason)

  # The error of the client in `packages/`, without its "cannot connect to the NATS server".
  def text(%{reason: {:connect, reason}}), do: text(reason)

  def text({:tls_alert, {_alert, text}}),
    do: "TLS failed: #{text |> to_string() |> String.replace(~r/\s+/, " ")}"

  def text(text) when is_binary(text), do: text
  def text(exception) when is_exception(exception), do: Exception.message(exception)
  def text(posix) when is_atom(posix), do: posix |> :inet.format_error() |> to_string()
  def text(_other), do: "an unknown answer"
end
