defmodule Gnat.Jetstream.Pager do
  @moduledoc """
  Reads the present messages of a stream in pages, with a temporary consumer.

      {:ok, count} = Pager.reduce(gnat, "FLEET_EVENTS", [from_seq: 1], 0, fn _message, n -> n + 1 end)

    * `batch` - messages in a page, default 10
    * `from_seq` or `from_datetime` - where to begin, default the first message
    * `filter_subject`, `headers_only`, `domain`
    * `deliver_policy` - instead of the two above; `:last_per_subject` reads the newest message of each subject
    * `timeout` - ms without any message until reading is given up, default 5000

  Reading ends at the message that was the last one when it began, even if others are written meanwhile.
  """

  alias Gnat.Error
  alias Gnat.Jetstream.API.{Consumer, Message, Util}

  @opaque pager :: map()
  @type opt ::
          {:batch, pos_integer()}
          | {:domain, nil | String.t()}
          | {:from_seq, pos_integer()}
          | {:from_datetime, DateTime.t()}
          | {:filter_subject, String.t()}
          | {:headers_only, boolean()}
          | {:deliver_policy, Consumer.deliver_policy()}
          | {:timeout, pos_integer()}

  @type error :: {:error, term()}

  # After a crash of the reader, the server removes the consumer: 30 s.
  @inactive_threshold 30_000_000_000

  @doc "Starts reading. The same process must end it with `cleanup/1`."
  @spec init(Gnat.t(), String.t(), [opt()]) :: {:ok, pager()} | error()
  def init(conn, stream, opts) do
    inbox = Util.reply_inbox()

    consumer = %Consumer{
      stream_name: stream,
      domain: opts[:domain],
      ack_policy: :none,
      ack_wait: nil,
      max_ack_pending: nil,
      max_deliver: nil,
      filter_subject: opts[:filter_subject],
      headers_only: opts[:headers_only],
      inactive_threshold: @inactive_threshold
    }

    with {:ok, info} <- Consumer.create(conn, start_at(consumer, opts)),
         {:ok, sid} <- Gnat.sub(conn, self(), inbox) do
      {:ok,
       %{
         conn: conn,
         stream: stream,
         consumer: info.name,
         domain: opts[:domain],
         inbox: inbox,
         sid: sid,
         batch: opts[:batch] || 10,
         total: info.num_pending,
         timeout: opts[:timeout] || Gnat.answer_ms()
       }}
    end
  end

  @doc "The next page; `:done` with the last one, which may be empty."
  @spec page(pager()) :: {:page | :done, [Gnat.message()]} | error()
  def page(%{total: 0}), do: {:done, []}

  def page(pager) do
    opts = [batch: pager.batch, no_wait: true]

    with :ok <-
           Consumer.request_next_message(
             pager.conn,
             pager.stream,
             pager.consumer,
             pager.inbox,
             pager.domain,
             opts
           ) do
      collect(pager, pager.batch, [])
    end
  end

  @doc "Ends the subscription and the consumer."
  @spec cleanup(pager()) :: :ok | error()
  def cleanup(pager) do
    _ = Gnat.unsub(pager.conn, pager.sid)
    drop(pager.sid)
    Consumer.delete(pager.conn, pager.stream, pager.consumer, pager.domain)
  end

  @doc "Reduces all messages with `fun`, and cleans up."
  @spec reduce(Gnat.t(), String.t(), [opt()], acc, (Gnat.message(), acc -> acc)) :: {:ok, acc} | error()
        when acc: term()
  def reduce(conn, stream, opts, acc, fun) do
    with {:ok, pager} <- init(conn, stream, opts) do
      try do
        pages(pager, acc, fun)
      after
        cleanup(pager)
      end
    end
  end

  defp pages(pager, acc, fun) do
    case page(pager) do
      {:page, messages} -> pages(pager, Enum.reduce(messages, acc, fun), fun)
      {:done, messages} -> {:ok, Enum.reduce(messages, acc, fun)}
      {:error, _} = error -> error
    end
  end

  defp collect(_pager, 0, messages), do: {:page, Enum.reverse(messages)}

  defp collect(%{sid: sid, timeout: timeout} = pager, count, messages) do
    receive do
      # No message is left, or the consumer is gone. Any other status says nothing about messages.
      {:msg, %{sid: ^sid, status: status}} when status in ["404", "408", "409"] ->
        {:done, Enum.reverse(messages)}

      {:msg, %{sid: ^sid, status: status}} when is_binary(status) ->
        collect(pager, count, messages)

      {:msg, %{sid: ^sid} = message} ->
        if last?(pager, message) do
          {:done, Enum.reverse([message | messages])}
        else
          collect(pager, count - 1, [message | messages])
        end
    after
      timeout -> {:error, Error.new(:timeout)}
    end
  end

  # Without acknowledgements nothing is delivered twice, so the consumer's sequence counts the messages.
  defp last?(%{total: total}, message) do
    case Message.metadata(message) do
      {:ok, %{num_pending: pending, consumer_seq: count}} -> pending == 0 or count >= total
      {:error, _} -> false
    end
  end

  defp start_at(consumer, opts) do
    cond do
      seq = opts[:from_seq] -> %{consumer | deliver_policy: :by_start_sequence, opt_start_seq: seq}
      time = opts[:from_datetime] -> %{consumer | deliver_policy: :by_start_time, opt_start_time: time}
      true -> %{consumer | deliver_policy: opts[:deliver_policy] || :all}
    end
  end

  defp drop(sid) do
    receive do
      {:msg, %{sid: ^sid}} -> drop(sid)
    after
      0 -> :ok
    end
  end
end
