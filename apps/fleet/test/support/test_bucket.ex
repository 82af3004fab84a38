defmodule Aerie.TestBucket do
  @moduledoc "Buckets as an administrator of NATS sees them, without the checks of Aerie: for tests that look into them or forge something."

  alias Aerie.Fleet.Nats.{KV, Reader}
  alias Gnat.Jetstream.API.Stream

  @spec info(pid(), String.t()) :: {:ok, map()} | {:error, term()}
  def info(conn, bucket), do: Stream.info(conn, "KV_" <> bucket)

  @doc "As other clients make it."
  @spec create_bucket(pid(), String.t(), keyword()) :: {:ok, map()} | {:error, term()}
  def create_bucket(conn, bucket, fields) do
    theirs = [allow_rollup_hdrs: true, duplicate_window: 120_000_000_000]
    Stream.create(conn, KV.stream(bucket, theirs ++ fields))
  end

  @spec delete_bucket(pid(), String.t()) :: :ok | {:error, term()}
  def delete_bucket(conn, bucket), do: Stream.delete(conn, "KV_" <> bucket)

  @doc "The value, or nil."
  @spec get_value(pid(), String.t(), String.t()) :: binary() | nil | {:error, term()}
  def get_value(conn, bucket, key) do
    case KV.get(conn, bucket, key) do
      {:ok, value, _revision} -> value
      {:none, _revision} -> nil
      error -> error
    end
  end

  @spec put_value(pid(), String.t(), String.t(), iodata()) :: :ok | {:error, term()}
  def put_value(conn, bucket, key, value), do: KV.put(conn, bucket, key, value)

  @spec delete_key(pid(), String.t(), String.t()) :: :ok | {:error, term()}
  def delete_key(conn, bucket, key), do: KV.delete(conn, bucket, key)

  @doc "All keys that have a value, with it."
  @spec contents(pid(), String.t()) :: {:ok, %{String.t() => binary()}} | {:error, term()}
  def contents(conn, bucket) do
    prefix = "$KV.#{bucket}."
    collector = self()
    ref = make_ref()

    with :ok <- Reader.last(conn, "KV_" <> bucket, prefix <> ">", &send(collector, {ref, &1})) do
      {:ok, collect(ref, prefix, %{})}
    end
  end

  defp collect(ref, prefix, values) do
    receive do
      {^ref, message} ->
        removed? = List.keymember?(Map.get(message, :headers, []), "kv-operation", 0)
        key = String.replace_prefix(message.topic, prefix, "")
        collect(ref, prefix, if(removed?, do: values, else: Map.put(values, key, message.body)))
    after
      0 -> values
    end
  end
end
