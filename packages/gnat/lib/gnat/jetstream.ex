defmodule Gnat.Jetstream do
  @moduledoc """
  Publishing into streams with an acknowledgement, and acknowledging what consumers deliver.

  The functions `ack/1` to `ack_term/1` are those of the Hex package; `publish/4` and `ack_sync/2` are not in it. What
  has to run with both asks with `Gnat.request/4` and the headers of `headers/1`.
  """

  alias Gnat.Error
  alias Gnat.Jetstream.API.Util

  @typedoc """
  The server has stored the message in `stream` as number `seq`. With `duplicate` it already had a message of that id; `seq` is
  the number of that one.
  """
  @type pub_ack :: %{
          stream: String.t(),
          seq: non_neg_integer(),
          duplicate: boolean(),
          domain: String.t() | nil
        }

  @type publish_option ::
          {:msg_id, String.t()}
          | {:expected_stream, String.t()}
          | {:expected_last_seq, non_neg_integer()}
          | {:expected_last_subject_seq, non_neg_integer()}
          | {:expected_last_msg_id, String.t()}
          | {:ttl, String.t()}
          | {:headers, Gnat.headers()}
          | {:timeout, timeout()}

  @doc """
  Publishes and waits until the server has stored the message.

    * `msg_id` - a second message with the same id within the stream's duplicate window is not stored (`Nats-Msg-Id`)
    * `expected_last_subject_seq` - only if the last message of this subject has that sequence, 0 for none
    * `expected_last_seq`, `expected_last_msg_id`, `expected_stream` - the same for the stream
    * `ttl` - how long to keep it, like `"10s"`, in streams that allow it
    * `headers`, `timeout` (ms, default 5000)

  A refusal by the server is a map with `"code"`, `"err_code"` (10071: a wrong last sequence) and `"description"`;
  `:no_responders` or `:timeout` mean that no stream has the subject, or that JetStream is off.
  """
  @spec publish(Gnat.t(), String.t(), iodata(), [publish_option()]) ::
          {:ok, pub_ack()} | {:error, Util.api_error() | :timeout | :no_responders | Error.t()}
  def publish(conn, subject, payload, opts \\ []) do
    request = [headers: headers(opts), receive_timeout: opts[:timeout] || 5_000]
    with {:ok, answer} <- Util.request(conn, subject, payload, request), do: pub_ack(answer)
  end

  @doc "The headers for the options of `publish/4`."
  @spec headers([publish_option()]) :: Gnat.headers()
  def headers(opts) do
    Enum.flat_map(opts, fn
      {:msg_id, id} -> [{"Nats-Msg-Id", id}]
      {:expected_stream, name} -> [{"Nats-Expected-Stream", name}]
      {:expected_last_seq, seq} -> [{"Nats-Expected-Last-Sequence", Integer.to_string(seq)}]
      {:expected_last_subject_seq, seq} -> [{"Nats-Expected-Last-Subject-Sequence", Integer.to_string(seq)}]
      {:expected_last_msg_id, id} -> [{"Nats-Expected-Last-Msg-Id", id}]
      {:ttl, ttl} -> [{"Nats-TTL", ttl}]
      {:headers, headers} -> headers
      {:timeout, _ms} -> []
    end)
  end

  defp pub_ack(%{"stream" => stream, "seq" => seq} = answer) when is_binary(stream) and is_integer(seq) do
    {:ok, %{stream: stream, seq: seq, duplicate: answer["duplicate"] == true, domain: answer["domain"]}}
  end

  defp pub_ack(_other), do: {:error, Error.new({:protocol, "the answer to a publish is no acknowledgement"})}

  @doc "Acknowledges a message."
  @spec ack(Gnat.message()) :: :ok | {:error, String.t() | Error.t()}
  def ack(message), do: acknowledge(message, "", [])

  @doc "Like `ack/1`, but waits until the server has the acknowledgement."
  @spec ack_sync(Gnat.message(), timeout()) ::
          :ok | {:error, String.t() | :timeout | :no_responders | Error.t()}
  def ack_sync(message, timeout \\ 5_000)

  def ack_sync(%{gnat: gnat, reply_to: reply_to}, timeout) when is_binary(reply_to) do
    with {:ok, _answer} <- Gnat.request(gnat, reply_to, "+ACK", receive_timeout: timeout), do: :ok
  end

  def ack_sync(message, _timeout), do: acknowledge(message, "", [])

  @doc "Acknowledges a message and requests the next one (of a pull consumer) at `consumer_subject`."
  @spec ack_next(Gnat.message(), String.t()) :: :ok | {:error, String.t() | Error.t()}
  def ack_next(message, consumer_subject), do: acknowledge(message, "+NXT", reply_to: consumer_subject)

  @doc "Asks for the message to be delivered again."
  @spec nack(Gnat.message()) :: :ok | {:error, String.t() | Error.t()}
  def nack(message), do: acknowledge(message, "-NAK", [])

  @doc "Still in progress: the time to acknowledge starts again."
  @spec ack_progress(Gnat.message()) :: :ok | {:error, String.t() | Error.t()}
  def ack_progress(message), do: acknowledge(message, "+WPI", [])

  @doc "The message cannot be handled: never deliver it again."
  @spec ack_term(Gnat.message()) :: :ok | {:error, String.t() | Error.t()}
  def ack_term(message), do: acknowledge(message, "+TERM", [])

  defp acknowledge(%{gnat: gnat, reply_to: reply_to}, word, opts) when is_binary(reply_to) do
    Gnat.pub(gnat, reply_to, word, opts)
  end

  defp acknowledge(_message, _word, _opts), do: {:error, "Cannot ack message with no reply-to"}
end
