defmodule Gnat.ConsumerSupervisor do
  @moduledoc """
  Keeps subscriptions on a supervised connection and runs a task for every message.

      {Gnat.ConsumerSupervisor,
       %{
         connection_name: MyApp.Nats,
         module: MyApp.Echo,
         subscription_topics: [%{topic: "echo", queue_group: "echo"}]
       }}

    * `connection_name` - the name given to `Gnat.ConnectionSupervisor`
    * `subscription_topics` - maps with `topic` and, if wanted, `queue_group`
    * `module` - a `Gnat.Server`, or `consuming_function: {module, function}`, called with the message

  After a loss of the connection, the subscriptions are renewed on the next one; messages published in between are lost (use
  JetStream against that). A task that crashes affects nothing else. At a shutdown the subscriptions end first, received
  messages are still handled, and the tasks are awaited; give the child enough `shutdown` time.
  """

  use GenServer

  require Logger

  # Often, because looking up a name is cheap.
  @look_again 100

  @type settings :: %{
          required(:connection_name) => GenServer.name(),
          required(:subscription_topics) => [
            %{required(:topic) => String.t(), optional(:queue_group) => String.t()}
          ],
          optional(:module) => module(),
          optional(:consuming_function) => {module(), atom()}
        }

  @spec start_link(settings(), GenServer.options()) :: GenServer.on_start()
  def start_link(settings, options \\ []), do: GenServer.start_link(__MODULE__, settings, options)

  @impl GenServer
  def init(settings) do
    Process.flag(:trap_exit, true)

    with {:ok, consume} <- consume(settings),
         {:ok, tasks} <- Task.Supervisor.start_link() do
      Process.set_label({:gnat_consumer_supervisor, settings.connection_name})

      state = %{
        connection: Map.fetch!(settings, :connection_name),
        topics: Map.fetch!(settings, :subscription_topics),
        consume: consume,
        tasks: tasks,
        gnat: nil,
        monitor: nil,
        sids: []
      }

      {:ok, state, {:continue, :connect}}
    else
      {:error, text} -> {:stop, text}
    end
  end

  @impl GenServer
  def handle_continue(:connect, state), do: {:noreply, connect(state)}

  @impl GenServer
  def handle_info(:connect, state), do: {:noreply, connect(state)}

  def handle_info({:msg, message}, state) do
    run(message, state)
    {:noreply, state}
  end

  def handle_info({:DOWN, ref, :process, _pid, _reason}, %{monitor: ref} = state) do
    {:noreply, connect(%{state | gnat: nil, monitor: nil, sids: []})}
  end

  def handle_info({:EXIT, tasks, reason}, %{tasks: tasks} = state), do: {:stop, reason, state}
  def handle_info(_other, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, %{gnat: nil} = state), do: await_tasks(state.tasks)

  def terminate(_reason, state) do
    Enum.each(state.sids, &Gnat.unsub(state.gnat, &1))

    # After this, everything that the server sent before the end of the subscriptions is in the mailbox.
    _ = Gnat.flush(state.gnat)
    drain(state)
    await_tasks(state.tasks)
  end

  defp connect(%{connection: name} = state) do
    with pid when is_pid(pid) <- GenServer.whereis(name),
         {:ok, sids} <- subscribe(pid, state.topics, []) do
      %{state | gnat: pid, monitor: Process.monitor(pid), sids: sids}
    else
      nil ->
        look_again(state)

      {:error, error} ->
        Logger.warning("NATS: cannot subscribe, retrying: #{Exception.message(error)}")
        look_again(state)
    end
  end

  defp look_again(state) do
    Process.send_after(self(), :connect, @look_again)
    state
  end

  defp subscribe(_pid, [], sids), do: {:ok, sids}

  defp subscribe(pid, [topic | rest], sids) do
    opts = if group = topic[:queue_group], do: [queue_group: group], else: []

    case Gnat.sub(pid, self(), topic.topic, opts) do
      {:ok, sid} ->
        subscribe(pid, rest, [sid | sids])

      {:error, _} = error ->
        Enum.each(sids, &Gnat.unsub(pid, &1))
        error
    end
  end

  defp run(message, %{tasks: tasks, consume: {module, function, args}}) do
    {:ok, _pid} = Task.Supervisor.start_child(tasks, module, function, args ++ [message])
    :ok
  end

  defp drain(state) do
    receive do
      {:msg, message} ->
        run(message, state)
        drain(state)
    after
      0 -> :ok
    end
  end

  defp await_tasks(tasks) do
    for pid <- Task.Supervisor.children(tasks) do
      ref = Process.monitor(pid)
      receive do: ({:DOWN, ^ref, :process, _pid, _reason} -> :ok)
    end

    :ok
  end

  defp consume(%{module: _, consuming_function: _}),
    do: {:error, "give a module or a consuming_function, not both"}

  defp consume(%{module: module}), do: {:ok, {Gnat.Server, :execute, [module]}}
  defp consume(%{consuming_function: {module, function}}), do: {:ok, {module, function, []}}
  defp consume(_neither), do: {:error, "give a module or a consuming_function"}
end
