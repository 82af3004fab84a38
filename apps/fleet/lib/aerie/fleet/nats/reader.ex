defmodule Aerie.Fleet.Nats.Reader do
  @moduledoc """
  Reads the last message of each subject from a stream, and if wanted every message after that, with a consumer that the server
  removes when nobody reads any more. Messages are fetched in batches, so that they wait in NATS while the function is at work.
  """

  alias Aerie.Base.Json
  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Nats.JetStream

  @batch 200
  @second 1_000_000_000
  @expires 20 * @second
  @heartbeat 5 * @second
  # Two heartbeats and a half without a word.
  @silence_ms 12_500

  @doc "Calls `fun` with the last message of each subject, and returns when these are read."
  @spec last(Nats.conn(), stream :: String.t(), subjects :: String.t(), (Nats.message() -> any())) ::
          :ok | {:error, Nats.reason()}
  def last(conn, stream, subjects, fun) do
    with {:ok, consumer, count} <- consumer(conn, stream, subjects),
         {:ok, reader} <- subscribe(conn, stream, consumer, fun, no_wait: true) do
      result = first(reader, count)
      _ = Nats.unsub(conn, reader.sid)
      _ = JetStream.ask(conn, "$JS.API.CONSUMER.DELETE.#{stream}.#{consumer}", "")
      result
    end
  end

  # Records written meanwhile are not waited for.
  defp first(_reader, 0), do: :ok

  defp first(reader, count) do
    case batch(reader, min(count, @batch)) do
      {:ok, 0} -> :ok
      {:ok, read} -> first(reader, count - read)
      error -> error
    end
  end

  @doc """
  Calls `fun` with the messages that were stored from a time on (unix microseconds), the oldest first, but only with the
  `limit` newest ones. Returns how many were left out. What is stored meanwhile is not waited for.
  """
  @spec since(
          Nats.conn(),
          stream :: String.t(),
          subjects :: String.t(),
          from :: integer(),
          limit :: pos_integer(),
          (Nats.message() -> any())
        ) ::
          {:ok, left_out :: non_neg_integer()} | {:error, Nats.reason()}
  def since(conn, stream, subjects, from, limit, fun) do
    start = %{deliver_policy: :by_start_time, opt_start_time: Json.time(from)}

    with {:ok, consumer, count} <- consumer(conn, stream, subjects, start),
         skip = max(count - limit, 0),
         skipped = :counters.new(1, []),
         taken = &if(:counters.get(skipped, 1) < skip, do: :counters.add(skipped, 1, 1), else: fun.(&1)),
         {:ok, reader} <- subscribe(conn, stream, consumer, taken, no_wait: true) do
      result = first(reader, count)
      _ = Nats.unsub(conn, reader.sid)
      _ = JetStream.ask(conn, "$JS.API.CONSUMER.DELETE.#{stream}.#{consumer}", "")
      with :ok <- result, do: {:ok, skip}
    end
  end

  @doc """
  Calls `fun` with the last message of each subject and then with every later one, in a process that is linked to the caller. The
  process ends with its connection, or when the consumer is gone.
  """
  @spec follow(Nats.conn(), stream :: String.t(), subjects :: String.t(), (Nats.message() -> any())) ::
          {:ok, pid()} | {:error, Nats.reason()}
  def follow(conn, stream, subjects, fun) do
    with {:ok, consumer, _count} <- consumer(conn, stream, subjects) do
      Task.start_link(fn ->
        Process.set_label({:nats_reader, stream})
        pull = [expires: @expires, idle_heartbeat: @heartbeat]

        {:error, reason} =
          with {:ok, reader} <- subscribe(conn, stream, consumer, fun, pull), do: endlessly(reader)

        exit({:shutdown, reason})
      end)
    end
  end

  defp endlessly(reader), do: with({:ok, _read} <- batch(reader, @batch), do: endlessly(reader))

  defp consumer(conn, stream, subjects, start \\ %{deliver_policy: :last_per_subject}) do
    config = %{
      ack_policy: :none,
      filter_subject: subjects,
      inactive_threshold: 60 * @second,
      # It goes with its connection, so its place need not be written at each message.
      mem_storage: true
    }

    body = JSON.encode_to_iodata!(%{stream_name: stream, config: Map.merge(config, start)})

    case JetStream.ask(conn, "$JS.API.CONSUMER.CREATE.#{stream}", body) do
      {:ok, %{"name" => name, "num_pending" => count}} when is_binary(name) and is_integer(count) ->
        {:ok, name, count}

      {:ok, _other} ->
        {:error, "an answer that is not understood"}

      error ->
        error
    end
  end

  defp subscribe(conn, stream, consumer, fun, pull) do
    inbox = "_INBOX.aerie-#{Base.encode16(:crypto.strong_rand_bytes(9), case: :lower)}"

    with {:ok, sid} <- Nats.sub(conn, self(), inbox) do
      next = "$JS.API.CONSUMER.MSG.NEXT.#{stream}.#{consumer}"
      monitor = Process.monitor(conn)

      {:ok,
       %{conn: conn, sid: sid, inbox: inbox, next: next, pull: Map.new(pull), monitor: monitor, fun: fun}}
    end
  end

  # How many messages came, `size` at most.
  defp batch(reader, size) do
    body = JSON.encode!(Map.put(reader.pull, :batch, size))
    with :ok <- Nats.pub(reader.conn, reader.next, body, reply_to: reader.inbox), do: read(reader, size, 0)
  end

  defp read(_reader, size, size), do: {:ok, size}

  defp read(%{sid: sid, monitor: monitor} = reader, size, read) do
    receive do
      {:msg, %{sid: ^sid, status: "100"}} ->
        read(reader, size, read)

      # No message, or none any more until the request expired.
      {:msg, %{sid: ^sid, status: status}} when status in ["404", "408"] ->
        {:ok, read}

      {:msg, %{sid: ^sid, status: status} = message} when is_binary(status) and status != "" ->
        {:error, message[:description] || status}

      {:msg, %{sid: ^sid} = message} ->
        reader.fun.(message)
        read(reader, size, read + 1)

      {:DOWN, ^monitor, :process, _conn, _reason} ->
        {:error, "the connection to NATS was lost"}
    after
      @silence_ms -> {:error, :timeout}
    end
  end
end
