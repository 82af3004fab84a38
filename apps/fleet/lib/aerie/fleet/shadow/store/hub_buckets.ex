defmodule Aerie.Fleet.Shadow.Store.HubBuckets do
  @moduledoc """
  The hub's buckets as a leaf node reaches them: requests on `hub.kv.get.…` and `hub.kv.put.…`, of this vehicle's own keys and of plans
  only (`Aerie.Fleet.Bridge.Hub.Accounts`).
  """

  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Nats.JetStream

  @timeout_ms 4_000

  @doc "The subject on which the hub tells what is written to a key."
  @spec news(bucket :: String.t(), key :: String.t()) :: String.t()
  def news(bucket, key), do: "hub.kv.new.#{bucket}.#{key}"

  @doc "The value of a key and its revision, by which `put/5` is safe against others' changes."
  @spec get(Nats.conn(), String.t(), String.t()) ::
          {:ok, binary(), revision :: pos_integer()}
          | {:none, revision :: non_neg_integer()}
          | {:error, String.t()}
  def get(conn, bucket, key) do
    case get_with(conn, bucket, key, "") do
      {:ok, nil, _header, revision} -> {:none, revision}
      {:ok, value, _header, revision} -> {:ok, value, revision}
      error -> error
    end
  end

  @doc "As `get/3`, with a header of the value or its removal (its name in lower case); without a value nil."
  @spec get_with(Nats.conn(), String.t(), String.t(), header :: String.t()) ::
          {:ok, binary() | nil, String.t() | nil, revision :: non_neg_integer()} | {:error, String.t()}
  def get_with(conn, bucket, key, header) do
    case Nats.request(conn, "hub.kv.get.#{bucket}.#{key}", "", receive_timeout: @timeout_ms) do
      {:ok, %{status: "404"}} -> {:ok, nil, nil, 0}
      {:ok, %{headers: headers} = message} -> value(Map.new(headers), message, header)
      {:ok, _other} -> {:error, "the hub's answer is not understood"}
      {:error, reason} -> {:error, text(reason)}
    end
  end

  defp value(%{"nats-sequence" => sequence} = headers, message, header) do
    case {Integer.parse(sequence), headers["kv-operation"]} do
      {{revision, ""}, nil} -> {:ok, IO.iodata_to_binary(message.body), headers[header], revision}
      {{revision, ""}, _deleted} -> {:ok, nil, headers[header], revision}
      _no_number -> {:error, "the hub's answer is not understood"}
    end
  end

  defp value(_headers, _message, _header), do: {:error, "the hub's answer is not understood"}

  @doc "Writes a key if `revision` is still its last one, 0 for none."
  @spec put(Nats.conn(), String.t(), String.t(), iodata(), revision :: non_neg_integer()) ::
          :ok | :lost_race | {:error, String.t()}
  def put(conn, bucket, key, value, revision) do
    options = [expected: revision, timeout: @timeout_ms]

    with {:error, reason} <- JetStream.publish(conn, "hub.kv.put.#{bucket}.#{key}", value, options),
         do: {:error, text(reason)}
  end

  @doc "Writes a key, or removes it (`:delete`), without waiting."
  @spec send(Nats.conn(), String.t(), String.t(), iodata() | :delete, Nats.headers()) ::
          :ok | {:error, term()}
  def send(conn, bucket, key, value, headers \\ [])

  def send(conn, bucket, key, :delete, headers),
    do: Nats.pub(conn, "hub.kv.put.#{bucket}.#{key}", "", headers: [{"KV-Operation", "DEL"} | headers])

  def send(conn, bucket, key, value, headers),
    do: Nats.pub(conn, "hub.kv.put.#{bucket}.#{key}", value, headers: headers)

  defp text(:no_responders), do: "the hub is away, or does not let this vehicle do it"
  defp text(:timeout), do: "the hub does not answer: its network is slow, or no gateway has run there yet"
  defp text(reason), do: Nats.text(reason)
end
