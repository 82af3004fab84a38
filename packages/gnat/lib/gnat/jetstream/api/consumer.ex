defmodule Gnat.Jetstream.API.Consumer do
  @moduledoc """
  Consumers: positions in a stream, kept by the server.

  With a `durable_name` a consumer stays until it is deleted (or unused for `inactive_threshold`); otherwise it ends by itself.
  With a `deliver_subject` the server pushes messages there; otherwise they are pulled (`request_next_message/6`,
  `Gnat.Jetstream.PullConsumer`).

  Times (`ack_wait`, `backoff`, `idle_heartbeat`, `inactive_threshold`, `max_expires`) are in nanoseconds, -1 means
  unlimited, fields that are nil are left to the server. `domain` is the JetStream domain, not part of the consumer.
  """

  alias Gnat.Error
  alias Gnat.Jetstream.API.Util

  @enforce_keys [:stream_name]
  defstruct [
    :stream_name,
    :backoff,
    :deliver_group,
    :deliver_subject,
    :description,
    :domain,
    :durable_name,
    :filter_subject,
    :flow_control,
    :headers_only,
    :idle_heartbeat,
    :inactive_threshold,
    :max_batch,
    :max_expires,
    :max_waiting,
    :opt_start_seq,
    :opt_start_time,
    :rate_limit_bps,
    :sample_freq,
    ack_policy: :explicit,
    ack_wait: 30_000_000_000,
    deliver_policy: :all,
    max_ack_pending: 20_000,
    max_deliver: -1,
    replay_policy: :instant
  ]

  @ack_policies [:none, :all, :explicit]
  @deliver_policies [:all, :last, :new, :by_start_sequence, :by_start_time, :last_per_subject]
  @replay_policies [:instant, :original]

  # The fields of the server's configuration; `stream_name` and `domain` go elsewhere.
  @config ~w(ack_policy ack_wait backoff deliver_group deliver_policy deliver_subject description durable_name
             filter_subject flow_control headers_only idle_heartbeat inactive_threshold max_ack_pending max_batch
             max_deliver max_expires max_waiting opt_start_seq opt_start_time rate_limit_bps replay_policy sample_freq)a

  @type ack_policy :: :none | :all | :explicit
  @type deliver_policy :: :all | :last | :new | :by_start_sequence | :by_start_time | :last_per_subject

  @type t :: %__MODULE__{
          stream_name: String.t(),
          domain: nil | String.t(),
          ack_policy: ack_policy(),
          ack_wait: nil | non_neg_integer(),
          backoff: nil | [non_neg_integer()],
          deliver_group: nil | String.t(),
          deliver_policy: deliver_policy(),
          deliver_subject: nil | String.t(),
          description: nil | String.t(),
          durable_name: nil | String.t(),
          filter_subject: nil | String.t(),
          flow_control: nil | boolean(),
          headers_only: nil | boolean(),
          idle_heartbeat: nil | non_neg_integer(),
          inactive_threshold: nil | non_neg_integer(),
          max_ack_pending: nil | integer(),
          max_batch: nil | integer(),
          max_deliver: nil | integer(),
          max_expires: nil | non_neg_integer(),
          max_waiting: nil | integer(),
          opt_start_seq: nil | non_neg_integer(),
          opt_start_time: nil | DateTime.t(),
          rate_limit_bps: nil | non_neg_integer(),
          replay_policy: :instant | :original,
          sample_freq: nil | String.t()
        }

  @typedoc "The configuration as a map with the fields of the struct, without `stream_name` and `domain`."
  @type config :: %{atom() => term()}

  @type position :: %{consumer_seq: non_neg_integer(), stream_seq: non_neg_integer()}

  @type info :: %{
          ack_floor: position(),
          cluster: nil | map(),
          config: config(),
          created: DateTime.t() | nil,
          delivered: position(),
          name: String.t(),
          num_ack_pending: non_neg_integer(),
          num_pending: non_neg_integer(),
          num_redelivered: non_neg_integer(),
          num_waiting: non_neg_integer(),
          push_bound: nil | boolean(),
          stream_name: String.t()
        }

  @type consumers :: %{
          consumers: [String.t()],
          limit: non_neg_integer(),
          offset: non_neg_integer(),
          total: non_neg_integer()
        }

  @type error :: {:error, String.t() | Util.api_error() | :timeout | :no_responders | Error.t()}

  @doc "Creates a consumer; a durable one may already exist with the same configuration."
  @spec create(Gnat.t(), t()) :: {:ok, info()} | error()
  def create(conn, %__MODULE__{} = consumer) do
    with :ok <- validate(consumer),
         payload = JSON.encode_to_iodata!(%{stream_name: consumer.stream_name, config: config(consumer)}),
         {:ok, answer} <- Util.request(conn, create_subject(consumer), payload) do
      to_info(answer)
    end
  end

  @doc "Deletes it."
  @spec delete(Gnat.t(), String.t(), String.t(), nil | String.t()) :: :ok | error()
  def delete(conn, stream, consumer, domain \\ nil) do
    with {:ok, _answer} <- ask(conn, domain, "DELETE", stream, consumer), do: :ok
  end

  @doc "Configuration and position."
  @spec info(Gnat.t(), String.t(), String.t(), nil | String.t()) :: {:ok, info()} | error()
  def info(conn, stream, consumer, domain \\ nil) do
    with {:ok, answer} <- ask(conn, domain, "INFO", stream, consumer), do: to_info(answer)
  end

  @doc "The names of a stream's consumers, a page at a time: `offset`, `domain`."
  @spec list(Gnat.t(), String.t(), offset: non_neg_integer(), domain: nil | String.t()) ::
          {:ok, consumers()} | error()
  def list(conn, stream, params \\ []) do
    payload = Util.encode(%{offset: params[:offset] || 0})

    with :ok <- Util.check_name(stream, "stream_name"),
         {:ok, answer} <- Util.request(conn, "#{Util.api(params[:domain])}.CONSUMER.NAMES.#{stream}", payload) do
      {:ok,
       %{
         consumers: answer["consumers"] || [],
         limit: answer["limit"],
         offset: answer["offset"],
         total: answer["total"]
       }}
    end
  end

  @doc """
  Requests the next messages of a pull consumer; they are sent to `reply_to`.

    * `batch` - how many, default 1
    * `expires` - how long the server keeps the request, in ns; default: until it is fulfilled
    * `no_wait` - true: only messages that are there, else a message of status 404
    * `idle_heartbeat` - how often (ns) a message of status 100 comes while there is no other; at most half of `expires`
  """
  @spec request_next_message(Gnat.t(), String.t(), String.t(), String.t(), nil | String.t(), keyword()) ::
          :ok | {:error, Error.t()}
  def request_next_message(conn, stream, consumer, reply_to, domain \\ nil, opts \\ []) do
    payload = Util.encode(Map.merge(%{batch: 1}, Map.new(Keyword.take(opts, request_options()))))
    subject = "#{Util.api(domain)}.CONSUMER.MSG.NEXT.#{stream}.#{consumer}"
    Gnat.pub(conn, subject, payload, reply_to: reply_to)
  end

  defp request_options, do: [:batch, :expires, :no_wait, :idle_heartbeat]

  defp create_subject(%{durable_name: nil, domain: domain, stream_name: stream}) do
    "#{Util.api(domain)}.CONSUMER.CREATE.#{stream}"
  end

  defp create_subject(%{durable_name: durable, domain: domain, stream_name: stream}) do
    "#{Util.api(domain)}.CONSUMER.DURABLE.CREATE.#{stream}.#{durable}"
  end

  defp ask(conn, domain, operation, stream, consumer) do
    with :ok <- Util.check_name(stream, "stream_name"),
         :ok <- Util.check_name(consumer, "consumer name") do
      Util.request(conn, "#{Util.api(domain)}.CONSUMER.#{operation}.#{stream}.#{consumer}", "")
    end
  end

  defp config(consumer) do
    consumer |> Map.take(@config) |> Map.reject(fn {_field, value} -> value == nil end)
  end

  defp validate(consumer) do
    with :ok <- Util.check_name(consumer.stream_name, "stream_name"),
         :ok <-
           if(consumer.durable_name, do: Util.check_name(consumer.durable_name, "durable_name"), else: :ok),
         :ok <- one_of(consumer.ack_policy, @ack_policies, "ack policy"),
         :ok <- one_of(consumer.deliver_policy, @deliver_policies, "deliver policy") do
      one_of(consumer.replay_policy, @replay_policies, "replay policy")
    end
  end

  defp one_of(value, known, what) do
    if value in known, do: :ok, else: {:error, "invalid #{what}: #{inspect(value)}"}
  end

  defp to_info(%{"config" => %{} = config, "name" => name} = answer) do
    {:ok,
     %{
       ack_floor: position(answer["ack_floor"]),
       cluster: answer["cluster"],
       config: Map.new(@config, &{&1, value(&1, config[Atom.to_string(&1)])}),
       created: Util.to_datetime(answer["created"]),
       delivered: position(answer["delivered"]),
       name: name,
       num_ack_pending: answer["num_ack_pending"],
       num_pending: answer["num_pending"],
       num_redelivered: answer["num_redelivered"],
       num_waiting: answer["num_waiting"],
       push_bound: answer["push_bound"],
       stream_name: answer["stream_name"]
     }}
  end

  defp to_info(_other), do: {:error, Error.new({:protocol, "a consumer without configuration or name"})}

  defp value(:ack_policy, text), do: Util.to_atom(text, @ack_policies)
  defp value(:deliver_policy, text), do: Util.to_atom(text, @deliver_policies)
  defp value(:replay_policy, text), do: Util.to_atom(text, @replay_policies)
  defp value(:opt_start_time, text), do: Util.to_datetime(text)
  defp value(_field, value), do: value

  defp position(%{"consumer_seq" => consumer, "stream_seq" => stream}) do
    %{consumer_seq: consumer, stream_seq: stream}
  end

  defp position(_none), do: %{consumer_seq: 0, stream_seq: 0}
end
