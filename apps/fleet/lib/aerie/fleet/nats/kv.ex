defmodule Aerie.Fleet.Nats.KV do
  @moduledoc """
  Buckets of keys and values with compare-and-set. A bucket is a stream; the last message of a subject is the value of a key, its
  number the key's revision. Options of all functions: `timeout` (ms).
  """

  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Nats.{JetStream, Reader}
  alias Gnat.Jetstream.API.Stream

  @doc "A bucket as a stream. Fields of the stream that are not those of every bucket: history, sizes, age, copies."
  @spec stream(bucket :: String.t(), keyword()) :: struct()
  def stream(bucket, fields) do
    every = %Stream{
      name: "KV_" <> bucket,
      subjects: ["$KV.#{bucket}.>"],
      storage: :file,
      retention: :limits,
      discard: :new,
      max_msgs_per_subject: 1,
      # Values have no ids; with one, they would be dropped as copies of others.
      duplicate_window: JetStream.no_window(),
      deny_delete: true,
      # A roll-up of one key could empty the bucket (`Nats-Rollup: all`). A key is removed with a delete, not with a purge.
      allow_rollup_hdrs: false,
      # A vehicle's leaf node reads with direct requests.
      allow_direct: true
    }

    struct!(every, fields)
  end

  @doc "The value of a key and its revision; the revision of its removal if it was removed, 0 if it never had one."
  @spec get(Nats.conn(), String.t(), String.t(), timeout: pos_integer()) ::
          {:ok, binary(), revision :: pos_integer()}
          | {:none, revision :: non_neg_integer()}
          | {:error, Nats.reason()}
  def get(conn, bucket, key, options \\ []) do
    case JetStream.stored(conn, "KV_" <> bucket, %{"last_by_subj" => subject(bucket, key)}, options) do
      {:ok, message} -> if removed?(message), do: {:none, message.seq}, else: {:ok, message.body, message.seq}
      :none -> {:none, 0}
      error -> error
    end
  end

  @doc "As `get/4`, with a header of the value or of its removal, nil for none; the value is nil if there is none."
  @spec get_with(Nats.conn(), String.t(), String.t(), header :: String.t()) ::
          {:ok, binary() | nil, String.t() | nil, revision :: non_neg_integer()} | {:error, Nats.reason()}
  def get_with(conn, bucket, key, header) do
    case JetStream.stored(conn, "KV_" <> bucket, %{"last_by_subj" => subject(bucket, key)}) do
      {:ok, message} ->
        value = if removed?(message), do: nil, else: message.body
        {:ok, value, JetStream.header(message, header), message.seq}

      :none ->
        {:ok, nil, nil, 0}

      error ->
        error
    end
  end

  # Deleted by a client, or by the server because of its age.
  defp removed?(message),
    do: (JetStream.header(message, "KV-Operation") || JetStream.header(message, "Nats-Marker-Reason")) != nil

  @doc "Writes a value. With `expected` only if that is the key's last revision, 0 for none. `headers` go with it."
  @spec put(Nats.conn(), String.t(), String.t(), iodata(),
          expected: non_neg_integer(),
          timeout: pos_integer(),
          headers: Nats.headers()
        ) ::
          :ok | :lost_race | {:error, Nats.reason()}
  def put(conn, bucket, key, value, options \\ []),
    do: JetStream.publish(conn, subject(bucket, key), value, options)

  @doc "Removes a key. Options as those of `put/5`."
  @spec delete(Nats.conn(), String.t(), String.t(),
          expected: non_neg_integer(),
          timeout: pos_integer(),
          headers: Nats.headers()
        ) :: :ok | :lost_race | {:error, Nats.reason()}
  def delete(conn, bucket, key, options \\ []) do
    removal = [{"KV-Operation", "DEL"}]
    options = Keyword.update(options, :headers, removal, &(removal ++ &1))
    JetStream.publish(conn, subject(bucket, key), "", options)
  end

  @doc """
  Calls `fun` with the last value of each key and then with every change, in a process that is linked to the caller. It ends with its
  connection, or if it may have missed something; the next one begins with the last values again. A function of
  three also gets the headers, by their names in lower case.
  """
  @spec watch(
          Nats.conn(),
          String.t(),
          (key :: String.t(), change -> any())
          | (key :: String.t(), change, %{String.t() => String.t()} -> any())
        ) :: {:ok, pid()} | {:error, Nats.reason()}
        when change: {:put, binary()} | :removed
  def watch(conn, bucket, fun) do
    prefix = "$KV.#{bucket}."

    Reader.follow(conn, "KV_" <> bucket, prefix <> ">", fn message ->
      headers = Map.new(Map.get(message, :headers, []))
      removed? = is_map_key(headers, "kv-operation") or is_map_key(headers, "nats-marker-reason")
      key = String.replace_prefix(message.topic, prefix, "")
      change = if removed?, do: :removed, else: {:put, message.body}
      if is_function(fun, 3), do: fun.(key, change, headers), else: fun.(key, change)
    end)
  end

  defp subject(bucket, key), do: "$KV.#{bucket}.#{key}"
end
