defmodule Gnat.Jetstream.PullConsumer do
  @moduledoc """
  A process that pulls the messages of a consumer and handles them one after the other.

      defmodule MyApp.Events do
        use Gnat.Jetstream.PullConsumer

        def start_link(arg), do: Gnat.Jetstream.PullConsumer.start_link(__MODULE__, arg)

        @impl true
        def init(_arg) do
          {:ok, nil, connection_name: MyApp.Nats, stream_name: "FLEET_EVENTS", consumer_name: "my_app"}
        end

        @impl true
        def handle_message(message, state) do
          IO.inspect(message.body)
          {:ack, state}
        end
      end

  With a `batch_size` of 1 a message is acknowledged with `+NXT`, which also requests the next one.

  It waits for the connection and pulls again if the server has no message. It starts over (with the same durable consumer, or
  a new ephemeral one) if the connection is lost, the consumer is gone, or no heartbeat comes.

  Options that `c:init/1` returns:

    * `connection_name` - required; a name or a pid
    * `stream_name` and `consumer_name` of a durable consumer that exists, or `consumer`, a
      `Gnat.Jetstream.API.Consumer` to create
    * `domain`, `inbox_prefix`
    * `connection_retry_timeout` - ms between tries to start, default 1000; `connection_retries` - how many of them may
      fail in a row before the process stops with `:timeout`, default 10
    * `batch_size` - messages requested at once, default 1
    * `request_expires` - ns a request for messages stays with the server, default 5 s; `idle_heartbeat` - ns, default
      and maximum: half of it. After twice that without any message it starts over
      (`[:gnat, :jetstream, :pull_consumer, :heartbeat_expired]`)
  """

  alias Gnat.Jetstream.API.Consumer
  alias Gnat.Jetstream.PullConsumer.Server

  @type consumer :: GenServer.server()
  @type connection_option ::
          {:connection_name, Gnat.t()}
          | {:stream_name, String.t()}
          | {:consumer_name, String.t()}
          | {:consumer, Consumer.t()}
          | {:connection_retry_timeout, non_neg_integer()}
          | {:connection_retries, non_neg_integer()}
          | {:domain, nil | String.t()}
          | {:inbox_prefix, nil | String.t()}
          | {:batch_size, pos_integer()}
          | {:request_expires, pos_integer()}
          | {:idle_heartbeat, pos_integer()}
          | {:heartbeat_check_interval, pos_integer()}
  @type connection_options :: [connection_option()]

  @doc "Returns the first state and the options above."
  @callback init(arg :: term()) ::
              {:ok, state :: term(), connection_options()} | :ignore | {:stop, reason :: term()}

  @doc """
  Handles a message. `:ack` acknowledges it, `:nack` asks for it again, `:term` ends its delivery, and after `:noreply` it is
  acknowledged later (`Gnat.Jetstream.ack/1`).
  """
  @callback handle_message(Gnat.message(), state) :: {:ack | :nack | :term | :noreply, state}
            when state: term()

  @doc "The consumer is ready, also after each reconnection."
  @callback handle_connected(Consumer.info(), state) :: {:ok, state} when state: term()

  @doc "A status message of the server: a heartbeat, an empty stream, a new leader."
  @callback handle_status(Gnat.message(), state) :: {:ok, state} when state: term()

  @optional_callbacks handle_connected: 2, handle_status: 2

  defmacro __using__(opts) do
    quote location: :keep, bind_quoted: [opts: opts] do
      @behaviour Gnat.Jetstream.PullConsumer

      @doc "A child specification that calls `start_link/1`."
      def child_spec(arg) do
        Supervisor.child_spec(
          %{id: __MODULE__, start: {__MODULE__, :start_link, [arg]}},
          unquote(Macro.escape(opts))
        )
      end

      defoverridable child_spec: 1
    end
  end

  @doc "Starts it, linked; `options` are those of `GenServer.start_link/3`."
  @spec start_link(module(), term(), GenServer.options()) :: GenServer.on_start()
  def start_link(module, arg, options \\ []), do: GenServer.start_link(Server, {module, arg}, options)

  @doc "Starts it without a link."
  @spec start(module(), term(), GenServer.options()) :: GenServer.on_start()
  def start(module, arg, options \\ []), do: GenServer.start(Server, {module, arg}, options)

  @doc "Ends the process with `:shutdown`, after the current message. The server keeps the consumer."
  @spec close(consumer()) :: :ok
  def close(consumer), do: GenServer.call(consumer, :close, :infinity)
end
