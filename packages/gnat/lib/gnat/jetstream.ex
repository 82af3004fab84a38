defmodule Gnat.Jetstream do
  @moduledoc "Acknowledging what consumers deliver."

  alias Gnat.Error

  @doc "Acknowledges a message."
  @spec ack(Gnat.message()) :: :ok | {:error, String.t() | Error.t()}
  def ack(message), do: acknowledge(message, "", [])

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
