defmodule Gnat.Jetstream.API.KV.Entry do
  @moduledoc """
  One change of a key: `operation` is `:put`, `:delete` or `:purge` (an expired value is a `:delete`).

  `revision` is the number of the change in its bucket, `created` its time, `delta` how many changes came after it
  when it was sent (nil where that is not known).
  """

  alias Gnat.{Headers, Jetstream.API.KV, Jetstream.API.Message}

  defstruct ~w(bucket key value operation revision created delta)a

  @type operation :: :put | :delete | :purge
  @type t :: %__MODULE__{
          bucket: String.t(),
          key: String.t(),
          value: binary(),
          operation: operation(),
          revision: pos_integer() | nil,
          created: DateTime.t() | nil,
          delta: non_neg_integer() | nil
        }

  @doc "Reads a message that a consumer of the bucket's stream delivered; `:ignore` if it is not a change of this bucket."
  @spec from_message(Gnat.message(), bucket :: String.t()) :: {:ok, t()} | :ignore
  def from_message(%{status: status}, _bucket) when is_binary(status), do: :ignore

  def from_message(%{topic: topic} = message, bucket) do
    prefix = KV.prefix(bucket)

    if String.starts_with?(topic, prefix) do
      entry = %__MODULE__{
        bucket: bucket,
        key: String.replace_prefix(topic, prefix, ""),
        value: Map.get(message, :body, ""),
        operation: operation(Map.get(message, :headers, []))
      }

      {:ok, place(entry, Message.metadata(message))}
    else
      :ignore
    end
  end

  @doc "The same from a stored message of the stream."
  @spec from_stored(Gnat.Jetstream.API.Stream.message_response(), bucket :: String.t()) :: t()
  def from_stored(stored, bucket) do
    %{headers: headers} = Headers.decode(stored.hdrs || "")

    %__MODULE__{
      bucket: bucket,
      key: KV.subject_to_key(stored.subject, bucket),
      value: stored.data || "",
      operation: operation(headers),
      revision: stored.seq,
      created: stored.time
    }
  end

  defp place(entry, {:ok, %{stream_seq: seq, timestamp: created, num_pending: pending}}) do
    %{entry | revision: seq, created: created, delta: pending}
  end

  defp place(entry, {:error, _}), do: entry

  defp operation(headers) do
    Enum.find_value(headers, :put, fn
      {"kv-operation", "DEL"} -> :delete
      {"kv-operation", "PURGE"} -> :purge
      {"nats-marker-reason", _reason} -> :delete
      _other -> nil
    end)
  end
end
