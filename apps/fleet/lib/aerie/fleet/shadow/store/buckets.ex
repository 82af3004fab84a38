defmodule Aerie.Fleet.Shadow.Store.Buckets do
  @moduledoc """
  The shadow's buckets in NATS, read and written with compare-and-set.

  | bucket | key | value |
  |---|---|---|
  | `fleet_desired` | `{env}.{vehicle}` | the desired document (`Aerie.Fleet.Shadow.Document.Sealed`) |
  | `fleet_reported` | `{env}.{vehicle}` | the reported document (`Aerie.Fleet.Shadow.Document.Report`) |
  | `fleet_leases` | `{env}.gateways.{name}` | the heartbeat of a gateway |
  | | `{env}.vehicles.{vehicle}` | the name of the gateway that acts on it |
  | `fleet_commands` | `{env}.{vehicle}.{id}` | the gateway that sends a command, and what became of it (`Aerie.Fleet.Remote`) |
  | `fleet_plans` | SHA-256 of the file | a `.plan` file |

  Sizes, ages, history and copies are in the configuration (`shadow.buckets`, `nats.streams.replicas`). A bucket that differs is changed on
  the embedded server. On another server it is left as it is and the difference is reported, because an operator may have set it.
  """

  alias Aerie.Fleet.Bridge.Streams
  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Nats.KV
  alias Aerie.Fleet.Shadow.Document
  alias Aerie.Fleet.Shadow.Document.Sealed
  alias Aerie.Fleet.Shadow.Document.Report
  alias Aerie.Fleet.Shadow.Keys
  alias Aerie.Fleet.Shadow.Store.LeaseSeal
  alias Gnat.Jetstream.API.Stream

  @desired "fleet_desired"
  @reported "fleet_reported"
  @leases "fleet_leases"
  @plans "fleet_plans"
  @commands "fleet_commands"
  @mb 1_048_576
  # A name and who was heard, with the headers of the message.
  @lease_bytes 1_024
  @timeout_ms 2_000
  # Attempts at one update while others keep writing to the same document.
  @races 20

  @type kept :: %{environment: String.t(), keys: Keys.t()}

  @doc "The buckets of desired documents and of leases."
  @spec desired() :: String.t()
  def desired, do: @desired

  @spec leases() :: String.t()
  def leases, do: @leases

  @doc "The names of all buckets."
  @spec names() :: [String.t()]
  def names, do: [@desired, @reported, @leases, @commands, @plans]

  @doc "The space that the server reserves for them, in megabytes."
  @spec reserved_mb(limits :: map()) :: pos_integer()
  def reserved_mb(limits),
    do: div(Enum.sum(for stream <- wanted(limits, 1), do: stream.max_bytes), @mb)

  defp wanted(limits, replicas) do
    for {bucket, limits} <- [
          {@desired,
           max_msgs_per_subject: limits.desired_history,
           max_bytes: limits.desired_max_mb * @mb,
           max_msg_size: 2 * Document.max_bytes()},
          {@reported,
           max_bytes: limits.reported_max_mb * @mb,
           max_msg_size: 2 * Report.max_bytes(),
           max_age: nanoseconds(limits.reported_max_age_days)},
          {@leases, max_bytes: 4 * @mb, max_msg_size: @lease_bytes},
          # As long as a ledger knows a command. The oldest go if there are too many.
          {@commands,
           discard: :old, max_bytes: 16 * @mb, max_msg_size: @lease_bytes * 2, max_age: nanoseconds(1)},
          {@plans, max_bytes: limits.plans_max_mb * @mb, max_age: nanoseconds(limits.plans_max_age_days)}
        ],
        do: KV.stream(bucket, [num_replicas: replicas] ++ limits)
  end

  defp nanoseconds(days), do: round(days * 86_400 * 1_000_000_000)

  @typedoc "`made`: names of buckets that were missing; `differs`: what is not as configured, as texts."
  @type report :: %{made: [String.t()], differs: [String.t()]}

  @doc "Creates missing buckets, and brings those of the embedded server to the configured limits (`shadow.buckets`)."
  @spec ensure(Nats.conn(), Aerie.Fleet.Bridge.Settings.t(), limits :: map()) ::
          {:ok, report()} | {:error, String.t()}
  def ensure(conn, %{nats: nats}, limits) do
    Enum.reduce_while(wanted(limits, nats.streams.replicas), {:ok, %{made: [], differs: []}}, fn wanted,
                                                                                                 {:ok, report} ->
      "KV_" <> bucket = wanted.name

      case ensure_one(conn, wanted, nats.mode) do
        :made ->
          {:cont, {:ok, %{report | made: [bucket | report.made]}}}

        {:there, differs} ->
          {:cont,
           {:ok, %{report | differs: report.differs ++ for(text <- differs, do: "#{bucket}: #{text}")}}}

        {:error, reason} ->
          {:halt, {:error, "the bucket #{bucket} cannot be made: #{Nats.text(reason)}"}}
      end
    end)
  end

  defp ensure_one(conn, wanted, mode) do
    with {:error, _none} <- Nats.call(conn, fn -> Stream.info(conn, wanted.name) end),
         {:ok, _info} <- Nats.call(conn, fn -> Stream.create(conn, wanted) end) do
      :made
    else
      {:ok, %{config: there}} -> {:there, compare(conn, adapted(there, wanted), there, mode)}
      error -> error
    end
  end

  defp compare(conn, wanted, there, mode) do
    # On another server only what guards vehicles from each other is changed.
    change = if mode == :embedded, do: wanted, else: Streams.guarded(there, wanted)

    with [_ | _] <- Streams.differences(wanted, there),
         false <- change == there,
         {:ok, _info} <- Nats.call(conn, fn -> Stream.update(conn, change) end) do
      Streams.differences(wanted, change)
    else
      [] -> []
      _unchanged -> Streams.differences(wanted, there)
    end
  end

  # Settings that are not configured stay as they are.
  defp adapted(there, wanted) do
    keys =
      ~w(max_msgs_per_subject max_bytes max_msg_size max_age num_replicas allow_direct allow_rollup_hdrs duplicate_window)a

    struct!(there, for({key, value} <- Map.take(wanted, keys), value != nil, do: {key, value}))
  end

  @doc """
  The desired document of a vehicle: `:none`, `{:error, text}` if NATS does not answer, or `{:refused, text}` if no gateway with our key
  wrote it. The revision is for `write/4`.
  """
  @spec read(Nats.conn(), kept(), String.t()) ::
          {:ok, Document.t(), revision :: pos_integer()}
          | {:none, revision :: non_neg_integer()}
          | {:refused, String.t(), revision :: pos_integer()}
          | {:error, String.t()}
  def read(conn, kept, vehicle) do
    case KV.get(conn, @desired, "#{kept.environment}.#{vehicle}") do
      {:ok, value, revision} ->
        case Sealed.decode(value, kept.environment, vehicle, kept.keys) do
          {:ok, document} -> {:ok, document, revision}
          {:former, document} -> reseal(conn, kept, document, revision)
          {:error, why} -> {:refused, why, revision}
        end

      {:none, revision} ->
        {:none, revision}

      {:error, reason} ->
        {:error, Nats.text(reason)}
    end
  end

  # Sealed with the vehicle's own key it has another revision. If somebody else was faster, it is read again.
  defp reseal(conn, kept, document, revision) do
    case write(conn, kept, document, revision) do
      {:error, _why} -> {:ok, document, revision}
      _written_or_lost_race -> read(conn, kept, document.vehicle)
    end
  end

  @doc """
  Writes a document if `revision` is still the last one of its key. The time for it is short, because the gateway's lease is renewed by the
  process that repairs a bucket.
  """
  @spec write(Nats.conn(), kept(), Document.t(), revision :: non_neg_integer()) ::
          :ok | :lost_race | {:error, String.t()}
  def write(conn, kept, document, revision), do: write(conn, kept, document, revision, timeout: @timeout_ms)

  defp write(conn, kept, document, revision, options) do
    text = Sealed.encode(document, kept.environment, kept.keys)
    options = [expected: revision] ++ options

    with {:error, reason} <- KV.put(conn, @desired, "#{kept.environment}.#{document.vehicle}", text, options),
         do: {:error, Nats.text(reason)}
  end

  @doc """
  Changes a document by `fun` with compare-and-set: after a lost race it tries again with the new value. `copy` is the last document
  known here; it is used if the bucket has none, an older one, or one that no gateway wrote.
  """
  @spec change(Nats.conn(), kept(), Document.t(), (Document.t() -> {:ok, Document.t()} | error), (-> :ok)) ::
          {:ok, Document.t()} | error | {:error, {:unavailable, String.t()}}
        when error: {:error, {:role | :conflict | :limit, String.t()}}
  def change(conn, kept, copy, fun, on_race), do: change(conn, kept, copy, fun, on_race, @races)

  defp change(_conn, _kept, _copy, _fun, _on_race, 0),
    do: {:error, {:unavailable, "others change the document all the time; try again"}}

  defp change(conn, kept, copy, fun, on_race, races) do
    with {:ok, base, revision} <- base(conn, kept, copy),
         {:ok, document} <- fun.(base) do
      # No lease waits for it.
      case write(conn, kept, document, revision, []) do
        :ok ->
          {:ok, document}

        :lost_race ->
          on_race.()
          change(conn, kept, copy, fun, on_race, races - 1)

        {:error, why} ->
          if stored?(conn, kept, document),
            do: {:ok, document},
            else: {:error, {:unavailable, "NATS did not store it: #{why}"}}
      end
    end
  end

  # The answer may have come too late, and a client that tries again would make the change twice.
  defp stored?(conn, kept, document) do
    %{environment: environment, keys: keys} = kept
    text = Sealed.encode(document, environment, keys)

    # As it is read: times are stored in milliseconds.
    with {:ok, %{history: history} = ours} <- Sealed.decode(text, environment, document.vehicle, keys),
         {:ok, found, _revision} <- read(conn, kept, document.vehicle) do
      # Others may have changed it since.
      found == ours or (history != [] and hd(history) in found.history)
    else
      _refused_or_none -> false
    end
  end

  defp base(conn, kept, copy) do
    case read(conn, kept, copy.vehicle) do
      {:ok, document, revision} -> {:ok, Enum.max_by([document, copy], & &1.version), revision}
      {:refused, _why, revision} -> {:ok, copy, revision}
      {:none, revision} -> {:ok, copy, revision}
      {:error, why} -> {:error, {:unavailable, "NATS does not answer: #{why}"}}
    end
  end

  @doc "Publishes a reported document without waiting; it is published again after a lost connection."
  @spec report(Nats.conn(), String.t(), String.t(), map()) :: :ok | {:error, term()}
  def report(conn, environment, vehicle, report),
    do: Nats.pub(conn, "$KV.#{@reported}.#{environment}.#{vehicle}", JSON.encode_to_iodata!(report))

  @doc "The reported document in the bucket, or nil."
  @spec reported(Nats.conn(), String.t(), String.t()) :: map() | nil
  def reported(conn, environment, vehicle) do
    with {:ok, value, _revision} <- KV.get(conn, @reported, "#{environment}.#{vehicle}"),
         {:ok, %{} = report} <- JSON.decode(value),
         do: report,
         else: (_none -> nil)
  end

  @doc "Stores a plan file."
  @spec put_plan(Nats.conn(), hash :: String.t(), binary()) :: :ok | {:error, String.t()}
  def put_plan(conn, hash, text) do
    conn |> KV.put(@plans, hash, text) |> written()
  end

  @doc "Reads a plan file."
  @spec plan(Nats.conn(), hash :: String.t()) :: {:ok, binary()} | :error
  def plan(conn, hash) do
    with {:ok, value, _revision} <- KV.get(conn, @plans, hash), do: {:ok, value}, else: (_none -> :error)
  end

  @doc "Writes this gateway's heartbeat with its seal (`Aerie.Fleet.Shadow.Store.LeaseSeal`)."
  @spec renew(Nats.conn(), String.t(), instance :: String.t(), value :: binary(), seal :: Nats.headers()) ::
          :ok | {:error, String.t()}
  def renew(conn, environment, instance, value, seal) do
    key = "#{environment}.gateways.#{instance}"
    conn |> KV.put(@leases, key, value, timeout: @timeout_ms, headers: seal) |> written()
  end

  @doc "The seal of the last word in the bucket of leases, nil if it has none or is not known."
  @spec last_seal(Nats.conn()) :: String.t() | nil
  def last_seal(conn) do
    with {:ok, _value, seal, _revision} <- KV.get_with(conn, @leases, ">", LeaseSeal.header()),
         do: seal,
         else: (_unknown -> nil)
  end

  # No revision was expected, so a race is not lost.
  defp written(:ok), do: :ok
  defp written({:error, reason}), do: {:error, Nats.text(reason)}

  @doc "The owner of a vehicle, nil for nobody, with the seal of that word and the key's revision."
  @spec owner(Nats.conn(), String.t(), String.t()) ::
          {:ok, String.t() | nil, seal :: String.t() | nil, revision :: non_neg_integer()}
          | {:error, String.t()}
  def owner(conn, environment, vehicle) do
    with {:error, reason} <- KV.get_with(conn, @leases, owned(environment, vehicle), LeaseSeal.header()),
         do: {:error, Nats.text(reason)}
  end

  @doc "Makes this gateway a vehicle's owner, if nobody wrote the key since `revision`."
  @spec own(Nats.conn(), String.t(), String.t(), instance :: String.t(), Nats.headers(), non_neg_integer()) ::
          :ok | {:error, String.t()}
  def own(conn, environment, vehicle, instance, seal, revision) do
    options = [expected: revision, timeout: @timeout_ms, headers: seal]

    case KV.put(conn, @leases, owned(environment, vehicle), instance, options) do
      :ok -> :ok
      :lost_race -> {:error, "another gateway was faster"}
      {:error, reason} -> {:error, Nats.text(reason)}
    end
  end

  @doc "Says that nobody owns a vehicle, if nobody wrote the key since `revision`. If this fails, the others wait."
  @spec disown(Nats.conn(), String.t(), String.t(), Nats.headers(), revision :: non_neg_integer()) :: :ok
  def disown(conn, environment, vehicle, seal, revision) do
    options = [expected: revision, timeout: @timeout_ms, headers: seal]
    _ = KV.delete(conn, @leases, owned(environment, vehicle), options)
    :ok
  end

  defp owned(environment, vehicle), do: "#{environment}.vehicles.#{vehicle}"

  @doc "Claims a command by its vehicle and id: `{:taken, value}` if somebody did before."
  @spec claim_command(
          Nats.conn(),
          String.t(),
          {String.t(), String.t()},
          iodata(),
          timeout_ms :: pos_integer()
        ) ::
          :ok | {:taken, binary()} | {:error, String.t()}
  def claim_command(conn, environment, command, value, timeout_ms) do
    "$KV.#{@commands}." <> key = command_subject(environment, command)

    case KV.put(conn, @commands, key, value, expected: 0, timeout: timeout_ms) do
      :ok -> :ok
      :lost_race -> claimed(KV.get(conn, @commands, key, timeout: timeout_ms))
      {:error, reason} -> {:error, Nats.text(reason)}
    end
  end

  defp claimed({:ok, value, _revision}), do: {:taken, value}
  defp claimed({:none, _revision}), do: {:taken, ""}
  defp claimed({:error, reason}), do: {:error, Nats.text(reason)}

  @doc "The subject of a command's key. An id is any text."
  @spec command_subject(String.t(), {vehicle :: String.t(), id :: String.t()}) :: String.t()
  def command_subject(environment, {vehicle, id}),
    do: "$KV.#{@commands}.#{environment}.#{vehicle}.#{Base.url_encode64(id, padding: false)}"

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
end
