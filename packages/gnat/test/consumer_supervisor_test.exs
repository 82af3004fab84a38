defmodule Gnat.ConsumerSupervisorTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog
  import Gnat.Test

  alias Gnat.ConsumerSupervisor
  alias Gnat.Test.NatsServer

  @moduletag :capture_log

  defmodule Echo do
    use Gnat.Server

    @impl Gnat.Server
    def request(%{body: "raise"}), do: raise("no")
    def request(%{body: "error"}), do: {:error, :no}
    def request(%{body: "nonsense"}), do: :nonsense
    def request(%{body: "quiet"}), do: :ok
    def request(%{body: body}), do: {:reply, ["echo ", body]}
  end

  defmodule Careful do
    use Gnat.Server

    @impl Gnat.Server
    def request(%{body: "worse"}), do: raise("worse")
    def request(_message), do: raise("no")

    @impl Gnat.Server
    def error(%{body: "worse"}, _error), do: raise("worse still")
    def error(_message, %RuntimeError{message: text}), do: {:reply, "error: " <> text}
  end

  def consume(%{body: body} = message) do
    [pid, ref] = String.split(body, " ")
    pid = pid |> String.to_charlist() |> :erlang.list_to_pid()
    send(pid, {:consuming, ref, self(), message.topic})
    receive do: (:go -> send(pid, {:consumed, ref}))
  end

  setup do
    server = start_supervised!(NatsServer)
    name = supervised_connection(server)
    {:ok, gnat} = Gnat.start_link(NatsServer.settings(server, %{no_responders: true}))
    {:ok, server: server, name: name, gnat: gnat, topic: unique("topic")}
  end

  defp consumer(name, more) do
    start_supervised!({ConsumerSupervisor, Map.merge(%{connection_name: name}, more)})
  end

  # The subscription is made after the start; until then a request has no responder.
  defp ask(gnat, topic, body) do
    eventually(fn ->
      case Gnat.request(gnat, topic, body, receive_timeout: 60_000) do
        {:ok, %{body: answer}} -> answer
        {:error, :no_responders} -> nil
      end
    end)
  end

  test "a server answers, its failures cost one message each", %{name: name, gnat: gnat, topic: topic} do
    consumer(name, %{module: Echo, subscription_topics: [%{topic: topic, queue_group: "q"}]})
    assert ask(gnat, topic, "hi") == "echo hi"

    for body <- ~w(raise error nonsense quiet), do: :ok = Gnat.pub(gnat, topic, body, reply_to: "nowhere")
    :ok = Gnat.pub(gnat, topic, "without reply_to")
    assert ask(gnat, topic, "still there") == "echo still there"
    assert :ok = stop_supervised(ConsumerSupervisor)
  end

  test "what fails is logged with the topic", %{gnat: gnat} do
    message = %{topic: "a.b", gnat: gnat, reply_to: nil}

    for {body, text} <- [raise: "no", error: ":no", nonsense: ":nonsense", other: "has no reply_to"] do
      log = capture_log(fn -> Gnat.Server.execute(Echo, Map.put(message, :body, "#{body}")) end)
      assert log =~ "Echo failed on a request to a.b" and log =~ text
    end
  end

  test "a server may answer its errors itself", %{name: name, gnat: gnat, topic: topic} do
    consumer(name, %{module: Careful, subscription_topics: [%{topic: topic}]})
    assert ask(gnat, topic, "x") == "error: no"
    :ok = Gnat.pub(gnat, topic, "worse")
    assert ask(gnat, topic, "x") == "error: no"
    assert :ok = stop_supervised(ConsumerSupervisor)
  end

  test "subscribes again after kill -9 of the server", %{name: name, server: server, topic: topic} do
    consumer(name, %{module: Echo, subscription_topics: [%{topic: topic}]})
    Process.flag(:trap_exit, true)
    :ok = NatsServer.kill(server)
    assert_receive {:telemetry, [:gnat, :connection, :down], _, %{name: ^name}}
    :ok = NatsServer.start(server)
    assert_receive {:telemetry, [:gnat, :connection, :up], _, %{name: ^name}}
    {:ok, gnat} = Gnat.start_link(NatsServer.settings(server, %{no_responders: true}))
    assert ask(gnat, topic, "again") == "echo again"
  end

  test "a shutdown ends the subscriptions and awaits the tasks", %{name: name, gnat: gnat, topic: topic} do
    consumer =
      consumer(name, %{consuming_function: {__MODULE__, :consume}, subscription_topics: [%{topic: topic}]})

    eventually(fn -> :sys.get_state(consumer, 60_000).gnat end)
    # The messages come by another connection: they must not overtake the subscription.
    :ok = Gnat.flush(name)
    me = self() |> :erlang.pid_to_list() |> to_string()
    for n <- 1..3, do: :ok = Gnat.pub(gnat, topic, "#{me} #{n}")
    workers = for _ <- 1..3, do: receive(do: ({:consuming, _, pid, ^topic} -> pid))

    # Released only when the subscriptions have ended: from then on the tasks are all there is to wait for.
    releasing =
      Task.async(fn ->
        eventually(fn -> match?({:ok, 1}, Gnat.active_subscriptions(name)) end)
        Enum.each(workers, &send(&1, :go))
      end)

    assert :ok = stop_supervised(ConsumerSupervisor)
    assert :ok = Task.await(releasing, 60_000)
    for _ <- 1..3, do: assert_received({:consumed, _})
  end

  test "needs one of module and consuming_function", %{name: name} do
    Process.flag(:trap_exit, true)
    settings = %{connection_name: name, subscription_topics: []}
    assert {:error, "give a module or" <> _} = ConsumerSupervisor.start_link(settings)
    both = Map.merge(settings, %{module: Echo, consuming_function: {__MODULE__, :consume}})
    assert {:error, "give a module or a consuming_function, not both"} = ConsumerSupervisor.start_link(both)
  end
end
