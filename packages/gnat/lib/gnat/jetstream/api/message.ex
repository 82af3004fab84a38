defmodule Gnat.Jetstream.API.Message do
  @moduledoc "The origin of a delivered message, which JetStream writes into its reply address."

  defmodule Metadata do
    @moduledoc """
    `stream_seq` and `consumer_seq` count from 1; `num_delivered` is 1 the first time; `num_pending` is how many
    remain for this consumer; `timestamp` is when the stream stored the message.
    """

    defstruct ~w(stream_seq consumer_seq num_pending num_delivered timestamp stream consumer domain)a

    @type t :: %__MODULE__{
            stream_seq: pos_integer(),
            consumer_seq: pos_integer(),
            num_pending: non_neg_integer(),
            num_delivered: pos_integer(),
            timestamp: DateTime.t(),
            stream: String.t(),
            consumer: String.t(),
            domain: String.t() | nil
          }
  end

  @doc "Reads the reply address. Any message that is not JetStream's is an error."
  @spec metadata(Gnat.message()) ::
          {:ok, Metadata.t()} | {:error, :no_jetstream_message | :invalid_ack_reply_to}
  def metadata(%{reply_to: "$JS.ACK." <> rest}), do: rest |> String.split(".") |> read()
  def metadata(_message), do: {:error, :no_jetstream_message}

  # $JS.ACK.<stream>.<consumer>.<delivered>.<stream seq>.<consumer seq>.<time>.<pending>
  defp read([stream, consumer | numbers]) when length(numbers) == 5 do
    with [delivered, stream_seq, consumer_seq, time, pending] <- Enum.flat_map(numbers, &integer/1),
         {:ok, timestamp} <- DateTime.from_unix(time, :nanosecond) do
      {:ok,
       %Metadata{
         stream: stream,
         consumer: consumer,
         num_delivered: delivered,
         stream_seq: stream_seq,
         consumer_seq: consumer_seq,
         timestamp: timestamp,
         num_pending: pending
       }}
    else
      _bad -> {:error, :invalid_ack_reply_to}
    end
  end

  # $JS.ACK.<domain or _>.<account hash>.<the same seven>[.<random>]
  defp read([domain, _account, stream, consumer | numbers]) when length(numbers) in 5..6 do
    with {:ok, metadata} <- read([stream, consumer | Enum.take(numbers, 5)]) do
      {:ok, %{metadata | domain: if(domain != "_", do: domain)}}
    end
  end

  defp read(_other), do: {:error, :invalid_ack_reply_to}

  defp integer(digits) do
    case Integer.parse(digits) do
      {number, ""} when number >= 0 -> [number]
      _bad -> []
    end
  end
end
