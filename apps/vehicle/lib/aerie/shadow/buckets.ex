defmodule Aerie.Shadow.Buckets do
  @moduledoc """
  The shadow's buckets in NATS, read and written with compare-and-set.

  | bucket | key | value | history |
  |---|---|---|---|
  | `fleet_desired` | `{env}.{vehicle}` | the desired document (`Aerie.Shadow.SealedDocument`) | 5 |
  | `fleet_reported` | `{env}.{vehicle}` | the reported document (`Aerie.Shadow.Report`) | 1 |
  | `fleet_leases` | `{env}.gateways.{name}` | the heartbeat of a gateway | 1 |
  | | `{env}.vehicles.{vehicle}` | the name of the gateway that acts on it | 1 |
  | `fleet_plans` | SHA-256 of the file | a `.plan` file | 1 |
  """

  alias Aerie.Secret
  alias Aerie.Shadow.{Document, Report, SealedDocument}
  alias Gnat.Jetstream.API.KV

  @desired "fleet_desired"
  @reported "fleet_reported"
  @leases "fleet_leases"
  @plans "fleet_plans"
  @mb 1_048_576
  @timeout_ms 2_000
  # Attempts at one update while others keep writing to the same document.
  @races 20

  @type kept :: %{environment: String.t(), key: Secret.t()}

  @doc "The buckets of desired documents and of leases."
  @spec desired() :: String.t()
  def desired, do: @desired

  @spec leases() :: String.t()
  def leases, do: @leases

  @doc "The space that the server reserves for them, in megabytes."
  @spec reserved_mb() :: pos_integer()
  def reserved_mb,
    do: div(Enum.sum(for {_bucket, options} <- wanted(), do: options[:max_bucket_size]), @mb)

  defp wanted do
    [
      {@desired, history: 5, max_bucket_size: 64 * @mb, max_value_size: 2 * Document.max_bytes()},
      {@reported, history: 1, max_bucket_size: 32 * @mb, max_value_size: 2 * Report.max_bytes()},
      {@leases, history: 1, max_bucket_size: 1 * @mb},
      {@plans, history: 1, max_bucket_size: 32 * @mb}
    ]
  end

  @doc "Creates missing buckets, and returns their names. `replicas`: copies in a cluster."
  @spec ensure(Gnat.t(), replicas :: pos_integer()) :: {:ok, made :: [String.t()]} | {:error, String.t()}
  def ensure(conn, replicas) do
    Enum.reduce_while(wanted(), {:ok, []}, fn {bucket, options}, {:ok, made} ->
      # An existing bucket is not changed: an operator may have given it other limits.
      with {:error, _none} <- KV.info(conn, bucket),
           {:ok, _info} <- KV.create_bucket(conn, bucket, [replicas: replicas] ++ options) do
        {:cont, {:ok, [bucket | made]}}
      else
        {:ok, _there} -> {:cont, {:ok, made}}
        {:error, reason} -> {:halt, {:error, "the bucket #{bucket} cannot be made: #{text(reason)}"}}
      end
    end)
  end

  @doc "The desired document of a vehicle: `:none`, `{:error, text}` if NATS does not answer, or `{:refused, text}` if no gateway with our key wrote it."
  @spec read(Gnat.t(), kept(), String.t()) ::
          {:ok, Document.t(), revision :: pos_integer()}
          | :none
          | {:refused, String.t(), revision :: pos_integer()}
          | {:error, String.t()}
  def read(conn, kept, vehicle) do
    case KV.get_entry(conn, @desired, "#{kept.environment}.#{vehicle}") do
      {:ok, entry} ->
        case SealedDocument.decode(entry.value, kept.environment, vehicle, kept.key) do
          {:ok, document} -> {:ok, document, entry.revision}
          {:error, why} -> {:refused, why, entry.revision}
        end

      {:error, :not_found} ->
        :none

      {:error, reason} ->
        {:error, text(reason)}
    end
  end

  @doc "Writes a document if `revision` is still the last one of its key, or `:none` and the key has none."
  @spec write(Gnat.t(), kept(), Document.t(), revision :: pos_integer() | :none) ::
          :ok | :lost_race | {:error, String.t()}
  def write(conn, kept, document, revision) do
    key = "#{kept.environment}.#{document.vehicle}"
    text = SealedDocument.encode(document, kept.environment, kept.key)

    result =
      if revision == :none,
        do: KV.create_key(conn, @desired, key, text, timeout: @timeout_ms),
        else: KV.update_value(conn, @desired, key, text, revision, timeout: @timeout_ms)

    case result do
      :ok -> :ok
      {:ok, _revision} -> :ok
      {:error, :wrong_revision} -> :lost_race
      {:error, reason} -> {:error, text(reason)}
    end
  end

  @doc """
  Changes a document by `fun` with compare-and-set: after a lost race it tries again with the new value. `copy` is the last document
  known here; it is used if the bucket has none, an older one, or one that no gateway wrote.
  """
  @spec change(Gnat.t(), kept(), Document.t(), (Document.t() -> {:ok, Document.t()} | error), (-> :ok)) ::
          {:ok, Document.t()} | error | {:error, {:unavailable, String.t()}}
        when error: {:error, {:role | :conflict | :limit, String.t()}}
  def change(conn, kept, copy, fun, on_race), do: change(conn, kept, copy, fun, on_race, @races)

  defp change(_conn, _kept, _copy, _fun, _on_race, 0),
    do: {:error, {:unavailable, "others change the document all the time; try again"}}

  defp change(conn, kept, copy, fun, on_race, races) do
    with {:ok, base, revision} <- base(conn, kept, copy),
         {:ok, document} <- fun.(base) do
      case write(conn, kept, document, revision) do
        :ok ->
          {:ok, document}

        :lost_race ->
          on_race.()
          change(conn, kept, copy, fun, on_race, races - 1)

        {:error, why} ->
          {:error, {:unavailable, "NATS did not store it: #{why}"}}
      end
    end
  end

  defp base(conn, kept, copy) do
    case read(conn, kept, copy.vehicle) do
      {:ok, document, revision} -> {:ok, Enum.max_by([document, copy], & &1.version), revision}
      {:refused, _why, revision} -> {:ok, copy, revision}
      :none -> {:ok, copy, :none}
      {:error, why} -> {:error, {:unavailable, "NATS does not answer: #{why}"}}
    end
  end

  @doc "Publishes a reported document without waiting; it is published again after a lost connection."
  @spec report(Gnat.t(), String.t(), String.t(), map()) :: :ok | {:error, term()}
  def report(conn, environment, vehicle, report),
    do: Gnat.pub(conn, "$KV.#{@reported}.#{environment}.#{vehicle}", JSON.encode_to_iodata!(report))

  @doc "The reported document in the bucket, or nil."
  @spec reported(Gnat.t(), String.t(), String.t()) :: map() | nil
  def reported(conn, environment, vehicle) do
    with {:ok, entry} <- KV.get_entry(conn, @reported, "#{environment}.#{vehicle}"),
         {:ok, %{} = report} <- JSON.decode(entry.value),
         do: report,
         else: (_none -> nil)
  end

  @doc "Stores a plan file."
  @spec put_plan(Gnat.t(), hash :: String.t(), binary()) :: :ok | {:error, String.t()}
  def put_plan(conn, hash, text) do
    with {:error, reason} <- KV.put_value(conn, @plans, hash, text), do: {:error, text(reason)}
  catch
    :exit, _gone -> {:error, "the connection to NATS was lost"}
  end

  @doc "Reads a plan file."
  @spec plan(Gnat.t(), hash :: String.t()) :: {:ok, binary()} | :error
  def plan(conn, hash) do
    case KV.get_entry(conn, @plans, hash) do
      {:ok, entry} -> {:ok, entry.value}
      {:error, _none} -> :error
    end
  catch
    :exit, _gone -> :error
  end

  @doc "Writes this gateway's heartbeat."
  @spec renew(Gnat.t(), String.t(), instance :: String.t(), name :: String.t()) :: :ok | {:error, String.t()}
  def renew(conn, environment, instance, name) do
    with {:error, reason} <-
           KV.put_value(
             conn,
             @leases,
             "#{environment}.gateways.#{instance}",
             JSON.encode!(%{"gateway" => name}),
             timeout: @timeout_ms
           ),
         do: {:error, text(reason)}
  end

  @doc """
  Makes this gateway a vehicle's owner if nobody is, or if `gone?` is true for the present owner: `:mine`, or the owner.
  """
  @spec claim(Gnat.t(), String.t(), String.t(), instance :: String.t(), (String.t() -> boolean())) ::
          :mine | {:other, String.t()} | {:error, String.t()}
  def claim(conn, environment, vehicle, instance, gone?) do
    key = "#{environment}.vehicles.#{vehicle}"

    case KV.get_entry(conn, @leases, key) do
      {:ok, %{value: ^instance}} ->
        :mine

      {:ok, entry} ->
        if gone?.(entry.value), do: take(conn, key, instance, entry.revision), else: {:other, entry.value}

      {:error, :not_found} ->
        take(conn, key, instance, :none)

      {:error, reason} ->
        {:error, text(reason)}
    end
  end

  defp take(conn, key, instance, revision) do
    result =
      if revision == :none,
        do: KV.create_key(conn, @leases, key, instance, timeout: @timeout_ms),
        else: KV.update_value(conn, @leases, key, instance, revision, timeout: @timeout_ms)

    case result do
      {:error, :wrong_revision} -> {:error, "another gateway was faster"}
      {:error, reason} -> {:error, text(reason)}
      _written -> :mine
    end
  end

  @doc "Gives a vehicle up if this gateway owns it."
  @spec release(Gnat.t(), String.t(), String.t(), instance :: String.t()) :: :ok
  def release(conn, environment, vehicle, instance) do
    key = "#{environment}.vehicles.#{vehicle}"

    # If this fails, the others wait until the lease has expired.
    _ =
      with {:ok, %{value: ^instance, revision: revision}} <- KV.get_entry(conn, @leases, key),
           do: KV.delete_key(conn, @leases, key, expected_revision: revision, timeout: @timeout_ms)

    :ok
  end

  @doc "The subject of a key in the bucket of leases, in an environment."
  @spec lease(String.t(), String.t()) :: {:gateway | :vehicle, String.t()} | nil
  def lease(key, environment) do
    case String.split(key, ".") do
      [^environment, "gateways", instance] -> {:gateway, instance}
      [^environment, "vehicles", vehicle] -> {:vehicle, vehicle}
      _of_others -> nil
    end
  end

  @doc "The vehicle of a document's key in an environment; nil for another environment's key."
  @spec vehicle(String.t(), String.t()) :: String.t() | nil
  def vehicle(key, environment) do
    case String.split(key, ".") do
      [^environment, vehicle] -> vehicle
      _of_others -> nil
    end
  end

  defp text(reason), do: Aerie.Bridge.Streams.text(reason)
end
