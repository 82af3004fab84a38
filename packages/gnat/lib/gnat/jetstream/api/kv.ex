defmodule Gnat.Jetstream.API.KV do
  @moduledoc """
  Buckets of keys and values, which are streams in which the last message of a subject is the value of a key.

      {:ok, _} = KV.create_bucket(gnat, "fleet_desired", history: 5)
      :ok = KV.put_value(gnat, "fleet_desired", "prod.VID-001", "{}")
      "{}" = KV.get_value(gnat, "fleet_desired", "prod.VID-001")

  Keys are subjects: tokens with dots between them, of letters, digits and `-/_=`. Every change of a bucket has a
  revision, a number that grows.
  """

  alias Gnat.Error
  alias Gnat.Jetstream.API.{Stream, Util}
  alias Gnat.Jetstream.API.KV.{Entry, Watcher}
  alias Gnat.Jetstream.Pager

  @two_minutes 120_000_000_000

  @type bucket_option ::
          {:history, 1..64}
          | {:ttl, non_neg_integer()}
          | {:limit_marker_ttl, non_neg_integer()}
          | {:max_bucket_size, integer()}
          | {:max_value_size, integer()}
          | {:description, String.t()}
          | {:replicas, pos_integer()}
          | {:storage, :file | :memory}
          | {:placement, Stream.placement()}

  @type key :: String.t()
  @type error :: {:error, String.t() | :wrong_revision | term()}

  @doc """
  Creates a bucket; it may already exist with the same options.

    * `history` - values kept for each key, default 1, at most 64
    * `ttl` - nanoseconds after which a value expires
    * `limit_marker_ttl` - nanoseconds for which a marker shows that a value has expired
    * `max_bucket_size`, `max_value_size` - bytes, default -1: unlimited
    * `description`, `replicas`, `storage` (`:file` or `:memory`, default `:file`), `placement`
  """
  @spec create_bucket(Gnat.t(), String.t(), [bucket_option()]) :: {:ok, Stream.info()} | error()
  def create_bucket(conn, bucket, params \\ []) do
    ttl = params[:ttl] || 0

    with :ok <- Util.check_name(bucket, "bucket name") do
      Stream.create(conn, %Stream{
        name: stream_name(bucket),
        subjects: [prefix(bucket) <> ">"],
        description: params[:description],
        max_msgs_per_subject: params[:history] || 1,
        discard: :new,
        deny_delete: true,
        allow_direct: true,
        allow_rollup_hdrs: true,
        max_age: ttl,
        max_bytes: params[:max_bucket_size] || -1,
        max_msg_size: params[:max_value_size] || -1,
        num_replicas: params[:replicas] || 1,
        storage: params[:storage] || :file,
        placement: params[:placement],
        # The server refuses a window that is longer than the age limit.
        duplicate_window: if(ttl > 0, do: min(ttl, @two_minutes), else: @two_minutes),
        allow_msg_ttl: if(params[:limit_marker_ttl], do: true),
        subject_delete_marker_ttl: params[:limit_marker_ttl]
      })
    end
  end

  @doc "Deletes a bucket with its content."
  @spec delete_bucket(Gnat.t(), String.t()) :: :ok | error()
  def delete_bucket(conn, bucket), do: Stream.delete(conn, stream_name(bucket))

  @doc """
  Writes a key that has no value: never written, deleted or purged. `{:error, :wrong_revision}` if it has one.
  """
  @spec create_key(Gnat.t(), String.t(), key(), iodata(), timeout: timeout()) :: :ok | error()
  def create_key(conn, bucket, key, value, opts \\ []) do
    with {:error, :wrong_revision} <- write(conn, bucket, key, value, expected(0), opts),
         {:ok, %Entry{operation: operation, revision: revision}} when operation != :put <-
           entry(conn, bucket, key) do
      write(conn, bucket, key, value, expected(revision), opts)
    else
      {:ok, %Entry{}} -> {:error, :wrong_revision}
      other -> other
    end
  end

  defp expected(revision), do: [{"Nats-Expected-Last-Subject-Sequence", Integer.to_string(revision)}]

  @doc "Writes a value. `timeout` in ms, default 5000."
  @spec put_value(Gnat.t(), String.t(), key(), iodata(), timeout: timeout()) :: :ok | error()
  def put_value(conn, bucket, key, value, opts \\ []), do: write(conn, bucket, key, value, [], opts)

  @doc "Deletes a key; its history stays. Options as in `put_value/5`."
  @spec delete_key(Gnat.t(), String.t(), key(), timeout: timeout()) :: :ok | error()
  def delete_key(conn, bucket, key, opts \\ []),
    do: write(conn, bucket, key, "", [{"KV-Operation", "DEL"}], opts)

  @doc "Deletes a key and its history. Options as in `put_value/5`."
  @spec purge_key(Gnat.t(), String.t(), key(), timeout: timeout()) :: :ok | error()
  def purge_key(conn, bucket, key, opts \\ []),
    do: write(conn, bucket, key, "", [{"KV-Operation", "PURGE"}, {"Nats-Rollup", "sub"}], opts)

  @doc "The value of a key; nil if it was deleted, an error with `\"code\" => 404` if it was never written."
  @spec get_value(Gnat.t(), String.t(), key()) :: binary() | nil | error()
  def get_value(conn, bucket, key) do
    case entry(conn, bucket, key) do
      {:ok, %Entry{operation: :put, value: value}} -> value
      {:ok, %Entry{}} -> nil
      {:error, _} = error -> error
    end
  end

  @doc "All keys that have a value, with it. `batch` (default 250), `domain`."
  @spec contents(Gnat.t(), String.t(), batch: pos_integer(), domain: nil | String.t()) ::
          {:ok, %{key() => binary()}} | error()
  def contents(conn, bucket, opts \\ []) do
    read(conn, bucket, [], opts, %{}, fn
      %Entry{operation: :put, key: key, value: value}, all -> Map.put(all, key, value)
      %Entry{key: key}, all -> Map.delete(all, key)
    end)
  end

  @doc "All keys that have a value, sorted. `batch` (default 250), `domain`."
  @spec keys(Gnat.t(), String.t(), batch: pos_integer(), domain: nil | String.t()) :: {:ok, [key()]} | error()
  def keys(conn, bucket, opts \\ []) do
    result =
      read(conn, bucket, [headers_only: true], opts, MapSet.new(), fn
        %Entry{operation: :put, key: key}, all -> MapSet.put(all, key)
        %Entry{key: key}, all -> MapSet.delete(all, key)
      end)

    with {:ok, keys} <- result, do: {:ok, Enum.sort(keys)}
  end

  @doc "The stream of a bucket: `domain`."
  @spec info(Gnat.t(), String.t(), domain: nil | String.t()) :: {:ok, Stream.info()} | error()
  def info(conn, bucket, opts \\ []), do: Stream.info(conn, stream_name(bucket), opts[:domain])

  @doc """
  Calls `handler` with every value the bucket has and then with every change, until `unwatch/1`.

  It is called as `handler.(action, key, value)` with `:key_added`, `:key_deleted` or `:key_purged`, in the process of
  the watcher, which is linked to the caller (`Gnat.Jetstream.API.KV.Watcher`).
  """
  @spec watch(Gnat.t(), String.t(), Watcher.handler()) :: GenServer.on_start()
  def watch(conn, bucket, handler), do: Watcher.start_link(conn: conn, bucket_name: bucket, handler: handler)

  @doc "Ends a watcher."
  @spec unwatch(pid()) :: :ok
  def unwatch(pid), do: Watcher.stop(pid)

  @doc "Whether a stream of this name is a bucket."
  @spec kv_bucket_stream?(String.t()) :: boolean()
  def kv_bucket_stream?(name), do: String.starts_with?(name, "KV_")

  @doc "The former name of `kv_bucket_stream?/1`."
  @deprecated "Use Gnat.Jetstream.API.KV.kv_bucket_stream?/1 instead"
  @spec is_kv_bucket_stream?(String.t()) :: boolean()
  def is_kv_bucket_stream?(name), do: kv_bucket_stream?(name)

  @doc "The names of the buckets; the first page of streams, up to 1024."
  @spec list_buckets(Gnat.t()) :: {:ok, [String.t()]} | error()
  def list_buckets(conn) do
    with {:ok, %{streams: streams}} <- Stream.list(conn) do
      {:ok, for("KV_" <> bucket <- streams, do: bucket)}
    end
  end

  @doc false
  @spec stream_name(String.t()) :: String.t()
  def stream_name(bucket), do: "KV_" <> bucket

  @doc false
  @spec subject_to_key(String.t(), String.t()) :: key()
  def subject_to_key(subject, bucket), do: String.replace_prefix(subject, prefix(bucket), "")

  @doc false
  @spec prefix(String.t()) :: String.t()
  def prefix(bucket), do: "$KV." <> bucket <> "."

  defp write(conn, bucket, key, value, headers, opts) do
    options = [headers: headers, receive_timeout: opts[:timeout] || Gnat.answer_ms()]

    with :ok <- check(bucket, key),
         {:ok, %{"seq" => _revision}} <- Util.request(conn, prefix(bucket) <> key, value, options) do
      :ok
    else
      {:error, %{"err_code" => 10_071}} -> {:error, :wrong_revision}
      {:ok, _other} -> {:error, Error.new({:protocol, "the answer to a publish is no acknowledgement"})}
      {:error, _} = error -> error
    end
  end

  defp entry(conn, bucket, key) do
    with :ok <- check(bucket, key),
         {:ok, message} <-
           Stream.get_message(conn, stream_name(bucket), %{last_by_subj: prefix(bucket) <> key}) do
      {:ok, Entry.from_stored(message, bucket)}
    end
  end

  defp read(conn, bucket, pager_opts, opts, acc, fun) do
    with :ok <- Util.check_name(bucket, "bucket name") do
      pager_opts =
        [
          domain: opts[:domain],
          batch: opts[:batch] || 250,
          deliver_policy: :last_per_subject,
          # The server wants one for :last_per_subject, even if it is the whole stream.
          filter_subject: prefix(bucket) <> ">"
        ] ++ pager_opts

      Pager.reduce(conn, stream_name(bucket), pager_opts, acc, fn message, acc ->
        case Entry.from_message(message, bucket) do
          {:ok, entry} -> fun.(entry, acc)
          :ignore -> acc
        end
      end)
    end
  end

  # A key with a wildcard or a blank would be another subject, and one with an empty token would be invalid.
  defp check(bucket, key) do
    with :ok <- Util.check_name(bucket, "bucket name") do
      if is_binary(key) and byte_size(key) <= 512 and key =~ ~r{\A[-/_=a-zA-Z0-9]+(\.[-/_=a-zA-Z0-9]+)*\z} do
        :ok
      else
        {:error, Error.new({:invalid_subject, key})}
      end
    end
  end
end
