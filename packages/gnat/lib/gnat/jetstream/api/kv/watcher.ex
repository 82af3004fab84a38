defmodule Gnat.Jetstream.API.KV.Watcher do
  @moduledoc """
  The process behind `Gnat.Jetstream.API.KV.watch/3`.

  It reads the bucket with its own consumer, in order and without gaps. After a missing number, a missing heartbeat or a lost
  connection, it starts a new consumer behind the last revision that the handler saw. So the handler sees no change twice,
  and misses none that the bucket still has. A bucket that was deleted and created again is read from its beginning.

  Given a connection's name, it outlives the connection and resumes with the next one. Given a pid, it ends with the
  connection.

    * `conn`, `bucket_name`, `handler` - required
    * `domain`
    * `idle_heartbeat` - ms, default 5000; after two and a half of them without any message, a new consumer is created
  """

  use GenServer, restart: :temporary

  alias Gnat.Backoff
  alias Gnat.Jetstream.API.{Consumer, KV, Message, Util}
  alias Gnat.Jetstream.API.KV.Entry

  @type handler :: (:key_added | :key_deleted | :key_purged, key :: String.t(), value :: binary() -> any())
  @type option ::
          {:conn, Gnat.t()}
          | {:bucket_name, String.t()}
          | {:handler, handler()}
          | {:domain, nil | String.t()}
          | {:idle_heartbeat, pos_integer()}

  @doc "Starts a watcher. Without the bucket or a connection it returns an error and does not exit."
  @spec start_link([option()]) :: GenServer.on_start()
  def start_link(opts) do
    with {:ok, _info} <- KV.info(opts[:conn], opts[:bucket_name], domain: opts[:domain]) do
      GenServer.start_link(__MODULE__, opts)
    end
  end

  @doc "Ends a watcher and its consumer."
  @spec stop(GenServer.server()) :: :ok
  def stop(watcher), do: GenServer.stop(watcher)

  @impl GenServer
  def init(opts) do
    bucket = Keyword.fetch!(opts, :bucket_name)
    Process.set_label({:gnat_kv_watcher, bucket})

    {:ok,
     subscribe(%{
       conn: Keyword.fetch!(opts, :conn),
       bucket: bucket,
       handler: Keyword.fetch!(opts, :handler),
       domain: opts[:domain],
       heartbeat: opts[:idle_heartbeat] || 5_000,
       revision: 0,
       backoff: Backoff.reset(Backoff.new(100, 5_000)),
       gnat: nil,
       monitor: nil,
       sid: nil,
       consumer: nil,
       consumer_seq: 0,
       timer: nil
     })}
  end

  @impl GenServer
  def handle_info({:msg, %{sid: sid} = message}, %{sid: sid} = state) do
    {:noreply, state |> await_heartbeat() |> message(message)}
  end

  def handle_info({:silent, timer}, %{timer: {timer, _ref}} = state), do: {:noreply, restart(state)}
  def handle_info(:subscribe, %{sid: nil} = state), do: {:noreply, subscribe(state)}

  def handle_info({:DOWN, ref, :process, _pid, _reason}, %{monitor: ref, conn: conn} = state)
      when is_pid(conn) do
    {:stop, {:shutdown, :not_connected}, state}
  end

  def handle_info({:DOWN, ref, :process, _pid, _reason}, %{monitor: ref} = state) do
    {:noreply, retry(%{state | gnat: nil, monitor: nil, sid: nil, consumer: nil})}
  end

  # Messages of a former subscription.
  def handle_info(_other, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, state), do: give_up(state)

  # Flow control: the server waits for this answer before it sends more.
  defp message(state, %{status: "100", reply_to: reply_to}) when is_binary(reply_to) do
    _ = Gnat.pub(state.gnat, reply_to, "")
    state
  end

  defp message(state, %{status: "100", headers: headers}) do
    headers = Map.new(headers)
    # An answer may be lost with the connection, because the next connection gets a new consumer.
    _ = if stalled = headers["nats-consumer-stalled"], do: Gnat.pub(state.gnat, stalled, "")

    case Integer.parse(headers["nats-last-consumer"] || "") do
      {last, ""} when last > state.consumer_seq -> restart(state)
      _up_to_date -> state
    end
  end

  # The consumer is gone.
  defp message(state, %{status: status}) when is_binary(status), do: restart(state)

  defp message(%{consumer_seq: seen} = state, message) do
    case Message.metadata(message) do
      {:ok, %{consumer_seq: seq}} when seq > seen + 1 ->
        restart(state)

      {:ok, %{consumer_seq: seq, stream_seq: revision}} ->
        with {:ok, entry} <- Entry.from_message(message, state.bucket) do
          state.handler.(action(entry.operation), entry.key, entry.value)
        end

        %{state | consumer_seq: seq, revision: revision}

      {:error, _foreign} ->
        state
    end
  end

  defp action(:put), do: :key_added
  defp action(:delete), do: :key_deleted
  defp action(:purge), do: :key_purged

  defp restart(state), do: state |> give_up() |> subscribe()

  defp give_up(%{gnat: nil} = state), do: state

  defp give_up(state) do
    if state.monitor, do: Process.demonitor(state.monitor, [:flush])

    # Both also end with the connection, which may be lost; the server removes an idle consumer by itself.
    _ = if state.sid, do: Gnat.unsub(state.gnat, state.sid)

    _ =
      if state.consumer,
        do: Consumer.delete(state.gnat, KV.stream_name(state.bucket), state.consumer, state.domain)

    %{cancel(state) | gnat: nil, monitor: nil, sid: nil, consumer: nil}
  end

  defp subscribe(state) do
    with gnat when is_pid(gnat) <- GenServer.whereis(state.conn),
         state = %{state | gnat: gnat, monitor: Process.monitor(gnat)},
         {:ok, %{state: %{last_seq: last}}} <- KV.info(gnat, state.bucket, domain: state.domain),
         inbox = Util.reply_inbox(),
         {:ok, sid} <- Gnat.sub(gnat, self(), inbox),
         state = %{state | sid: sid, consumer_seq: 0},
         {:ok, %{name: name}} <- Consumer.create(gnat, consumer(state, inbox, last)) do
      await_heartbeat(%{state | consumer: name, backoff: Backoff.reset(state.backoff)})
    else
      _not_now -> state |> give_up() |> retry()
    end
  end

  defp consumer(state, inbox, last) do
    start =
      if state.revision in 1..last//1 do
        %{deliver_policy: :by_start_sequence, opt_start_seq: state.revision + 1}
      else
        %{deliver_policy: :last_per_subject}
      end

    struct!(
      %Consumer{
        stream_name: KV.stream_name(state.bucket),
        domain: state.domain,
        deliver_subject: inbox,
        # The server wants one for :last_per_subject, even if it is the whole stream.
        filter_subject: KV.prefix(state.bucket) <> ">",
        ack_policy: :none,
        ack_wait: nil,
        max_ack_pending: nil,
        max_deliver: nil,
        flow_control: true,
        idle_heartbeat: state.heartbeat * 1_000_000
      },
      start
    )
  end

  defp retry(state) do
    {wait, backoff} = Backoff.next(state.backoff, :rand.uniform())
    Process.send_after(self(), :subscribe, wait)
    %{cancel(state) | backoff: backoff}
  end

  # Each timer has its own number, so that one that fires while it is cancelled is not mistaken for the next.
  defp await_heartbeat(state) do
    timer = make_ref()
    after_ms = div(state.heartbeat * 5, 2)
    %{cancel(state) | timer: {timer, Process.send_after(self(), {:silent, timer}, after_ms)}}
  end

  defp cancel(%{timer: nil} = state), do: state

  defp cancel(%{timer: {_timer, ref}} = state) do
    _ = Process.cancel_timer(ref)
    %{state | timer: nil}
  end
end
