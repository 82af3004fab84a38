defmodule Gnat.Jetstream.PullConsumerTest do
  use ExUnit.Case, async: true

  import Gnat.Test

  alias Gnat.Jetstream
  alias Gnat.Jetstream.API.{Consumer, Stream}
  alias Gnat.Jetstream.PullConsumer
  alias Gnat.Test.NatsServer

  @moduletag :capture_log

  defmodule Forward do
    use Gnat.Jetstream.PullConsumer, restart: :temporary

    def start_link({test, options}), do: PullConsumer.start_link(__MODULE__, {test, options})

    @impl PullConsumer
    def init(:ignore), do: :ignore
    def init({test, options}), do: {:ok, %{test: test, answer: :ack}, options}

    @impl PullConsumer
    def handle_connected(info, state) do
      send(state.test, {:connected, info.name})
      {:ok, state}
    end

    @impl PullConsumer
    def handle_status(message, state) do
      send(state.test, {:status, message.status})
      {:ok, state}
    end

    @impl PullConsumer
    def handle_message(%{body: body} = message, state) do
      send(state.test, {:message, body, self(), message})

      case body do
        "nack once" ->
          {if(Map.has_key?(state, :nacked), do: :ack, else: :nack), Map.put(state, :nacked, true)}

        "term" ->
          {:term, state}

        "later" ->
          {:noreply, state}

        _other ->
          {state.answer, state}
      end
    end
  end

  defmodule Plain do
    use Gnat.Jetstream.PullConsumer

    @impl Gnat.Jetstream.PullConsumer
    def init({test, options}), do: {:ok, test, options}

    @impl Gnat.Jetstream.PullConsumer
    def handle_message(%{body: body}, test) do
      send(test, {:plain, body})
      {:ack, test}
    end
  end

  setup do
    server = start_supervised!({NatsServer, jetstream: true})
    name = supervised_connection(server)
    stream = unique("S")
    {:ok, _} = Stream.create(name, %Stream{name: stream, subjects: [stream]})
    {:ok, _} = Consumer.create(name, %Consumer{stream_name: stream, durable_name: "d"})
    options = [connection_name: name, stream_name: stream, consumer_name: "d", connection_retry_timeout: 20]
    {:ok, server: server, name: name, stream: stream, options: options}
  end

  defp up(name), do: assert_receive({:telemetry, [:gnat, :connection, :up], _, %{name: ^name}})
  defp publish(name, stream, body), do: {:ok, _} = store(name, stream, body)

  defp settled(name, stream) do
    eventually(fn ->
      match?({:ok, %{num_ack_pending: 0, num_pending: 0}}, Consumer.info(name, stream, "d"))
    end)
  end

  test "handles message after message, with each answer", %{name: name, stream: stream, options: options} do
    start_supervised!({Forward, {self(), options}})
    assert_receive {:connected, "d"}
    for body <- ["a", "nack once", "term", "b"], do: publish(name, stream, body)
    assert_receive {:message, "a", _, _}
    assert_receive {:message, "nack once", _, _}
    assert_receive {:message, "term", _, _}
    assert_receive {:message, "b", _, _}
    assert_receive {:message, "nack once", _, _}
    publish(name, stream, "later")
    assert_receive {:message, "later", _, message}
    assert {:ok, %{num_ack_pending: 1}} = Consumer.info(name, stream, "d")
    :ok = Jetstream.ack(message)
    settled(name, stream)
  end

  test "asks for several at once", %{name: name, stream: stream, options: options} do
    bodies = Enum.map(1..25, &"#{&1}")
    for body <- bodies, do: publish(name, stream, body)
    start_supervised!({Forward, {self(), options ++ [batch_size: 10]}})
    for body <- bodies, do: assert_receive({:message, ^body, _, _})
    settled(name, stream)
  end

  test "asks again when there was nothing", %{name: name, stream: stream, options: options} do
    quick = options ++ [request_expires: 200_000_000]
    start_supervised!({Forward, {self(), quick}})
    assert_receive {:status, "100"}
    assert_receive {:status, "408"}
    assert_receive {:status, "408"}
    publish(name, stream, "after")
    assert_receive {:message, "after", _, _}
  end

  test "goes on after kill -9 of the server, nothing lost", %{server: server} = context do
    %{name: name, stream: stream, options: options} = context
    start_supervised!({Forward, {self(), options ++ [connection_retries: 1_000]}})
    publish(name, stream, "before")
    assert_receive {:message, "before", _, _}
    settled(name, stream)
    :ok = NatsServer.kill(server)
    assert_receive {:telemetry, [:gnat, :connection, :down], _, %{name: ^name}}
    :ok = NatsServer.start(server)
    up(name)
    publish(name, stream, "after")
    assert_receive {:message, "after", _, _}
  end

  test "creates its consumer again after its deletion", %{name: name, stream: stream} do
    consumer = %Consumer{stream_name: stream, durable_name: "own", inactive_threshold: 10_000_000_000}

    options = [
      connection_name: name,
      consumer: consumer,
      connection_retry_timeout: 20,
      request_expires: 200_000_000
    ]

    start_supervised!({Forward, {self(), options}})
    assert_receive {:connected, "own"}
    # Its request has reached the server, so the server reports the deletion.
    assert_receive {:status, "100"}
    :ok = Consumer.delete(name, stream, "own")
    assert_receive {:connected, "own"}
    publish(name, stream, "x")
    assert_receive {:message, "x", _, _}
  end

  test "an ephemeral consumer, a module without the optional callbacks", %{name: name, stream: stream} do
    publish(name, stream, "x")

    {:ok, pid} =
      PullConsumer.start(Plain, {self(), connection_name: name, consumer: %Consumer{stream_name: stream}})

    assert_receive {:plain, "x"}
    ref = Process.monitor(pid)
    assert :ok = PullConsumer.close(pid)
    assert_receive {:DOWN, ^ref, _, _, :shutdown}
  end

  test "an acknowledgement asks for the next message, and idling after it costs nothing but a new request",
       c do
    %{name: name, stream: stream, options: options} = c
    telemetry([:gnat, :jetstream, :pull_consumer, :heartbeat_expired])
    {:ok, _} = Gnat.sub(name, self(), "$JS.ACK.#{stream}.d.>")
    # Heartbeats at half of it; a silence of all of it is a fault.
    start_supervised!({Forward, {self(), options ++ [request_expires: 16_000_000_000]}})
    assert_receive {:connected, "d"}

    for body <- ["a", "b"] do
      publish(name, stream, body)
      assert_receive {:message, ^body, _, _}
      assert_receive {:msg, %{body: "+NXT", reply_to: inbox}} when is_binary(inbox)
      # Heartbeats again: the silence after `+NXT` was not taken for a fault.
      assert_receive {:status, "100"}
    end

    settled(name, stream)
    assert {:ok, %{num_waiting: waiting}} = Consumer.info(name, stream, "d")
    # The request of `+NXT` is not kept beside the new one.
    assert waiting <= 1
    refute_received {:connected, _}
    refute_received {:telemetry, [:gnat, :jetstream, :pull_consumer, :heartbeat_expired], _, _}
  end

  test "a consumer that acknowledges nothing is pulled from message to message", %{name: name, stream: stream} do
    consumer = %Consumer{stream_name: stream, ack_policy: :none}
    {:ok, _pid} = PullConsumer.start_link(Plain, {self(), connection_name: name, consumer: consumer})

    for body <- ["a", "b", "c"] do
      publish(name, stream, body)
      assert_receive {:plain, ^body}
    end
  end

  test "notices that the server has forgotten it", %{server: server, name: name, options: options} do
    telemetry([:gnat, :jetstream, :pull_consumer, :heartbeat_expired])
    start_supervised!({Forward, {self(), options ++ [request_expires: 200_000_000]}})
    assert_receive {:status, "100"}
    :ok = NatsServer.freeze(server)
    assert_receive {:telemetry, _, %{threshold_ms: 200}, %{consumer_name: "d", connection_name: ^name}}
    :ok = NatsServer.thaw(server)
    assert_receive {:connected, "d"}
  end

  test "gives up after the tries it was allowed", %{options: options} do
    Process.flag(:trap_exit, true)

    options =
      Keyword.merge(options, consumer_name: "nobody", connection_retries: 2, connection_retry_timeout: 1)

    {:ok, pid} = PullConsumer.start_link(Forward, {self(), options})
    assert_receive {:EXIT, ^pid, :timeout}
    {:ok, pid} = PullConsumer.start_link(Forward, {self(), Keyword.put(options, :connection_name, :nobody)})
    assert_receive {:EXIT, ^pid, :timeout}
  end

  test "options that cannot work are refused at the start", %{options: options, stream: stream} do
    Process.flag(:trap_exit, true)

    for {bad, text} <- [
          {[stream_name: stream, consumer_name: "d"], "connection_name is missing"},
          {Keyword.delete(options, :consumer_name), "give either"},
          {options ++ [consumer: %Consumer{stream_name: stream}], "give either"},
          {options ++ [nonsense: 1], "nonsense"},
          {options ++ [request_expires: 100, idle_heartbeat: 51], "half of request_expires"},
          {[connection_name: :x, consumer: %Consumer{stream_name: stream, durable_name: "x"}],
           "inactive_threshold"}
        ] do
      assert {:error, {%ArgumentError{message: message}, _}} = PullConsumer.start_link(Forward, {self(), bad})
      assert message =~ text
    end

    assert :ignore = PullConsumer.start_link(Forward, :ignore)
  end
end
