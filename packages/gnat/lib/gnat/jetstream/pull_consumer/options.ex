defmodule Gnat.Jetstream.PullConsumer.Options do
  @moduledoc "The options of a pull consumer, checked and with their defaults."

  alias Gnat.Jetstream.API.Consumer

  @seconds 1_000_000_000

  @defaults [
    stream_name: nil,
    consumer_name: nil,
    consumer: nil,
    domain: nil,
    inbox_prefix: nil,
    connection_retry_timeout: 1_000,
    connection_retries: 10,
    batch_size: 1,
    request_expires: 5 * @seconds,
    idle_heartbeat: nil,
    heartbeat_check_interval: nil
  ]

  @enforce_keys [:connection_name | Keyword.keys(@defaults)]
  defstruct @enforce_keys

  @type t :: %__MODULE__{}

  @doc "Raises `ArgumentError` for options that cannot work."
  @spec new!(keyword()) :: t()
  def new!(options) do
    options = Keyword.validate!(options, [:connection_name | @defaults])
    Keyword.has_key?(options, :connection_name) || raise ArgumentError, "connection_name is missing"
    options = struct!(__MODULE__, options)
    options = %{options | idle_heartbeat: options.idle_heartbeat || div(options.request_expires, 2)}

    if options.idle_heartbeat * 2 > options.request_expires do
      raise ArgumentError,
            "idle_heartbeat must be at most half of request_expires, or the server refuses to serve"
    end

    consumer(options)
  end

  defp consumer(%{consumer: %Consumer{} = consumer, stream_name: nil, consumer_name: nil} = options) do
    if consumer.durable_name && consumer.inactive_threshold == nil do
      raise ArgumentError,
            "a durable consumer that is created here needs an inactive_threshold, or nothing removes it"
    end

    %{options | stream_name: consumer.stream_name, domain: options.domain || consumer.domain}
  end

  defp consumer(%{consumer: nil, stream_name: stream, consumer_name: name} = options)
       when is_binary(stream) and is_binary(name),
       do: options

  defp consumer(_options) do
    raise ArgumentError,
          "give either stream_name and consumer_name, or consumer: %Gnat.Jetstream.API.Consumer{}"
  end
end
