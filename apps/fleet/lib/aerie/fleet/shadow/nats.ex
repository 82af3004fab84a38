defmodule Aerie.Fleet.Shadow.Nats do
  @moduledoc """
  The shadow over NATS: request and reply on `fleet.{environment}.{vehicle}.shadow.{get,update,delete,delta}`.

  Gateways with one NATS share the subjects (queue group): any of them answers for any vehicle, heard or not, because the
  documents are in NATS. `Aerie.Fleet.Shadow.Nats.Request` reads a message, `Aerie.Fleet.Shadow` handles it, each message in a task.

  | what | limit | beyond it |
  |---|---|---|
  | messages that wait here | 1000, and 10,000 for those that claim the signature of a listed key | dropped, counted in `gateway_shadow_requests_dropped_total` |
  | tasks | 64 | answered with rule `busy` |
  | tasks for what claims no signature of a listed key | 32 of them | answered with rule `busy`, unless more than 100 messages wait: then dropped and counted |
  | a message | 60 KiB | answered with rule `size` |
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Fleet.Shadow
  alias Aerie.Fleet.Bridge.Subscriber
  alias Aerie.Fleet.Shadow.Nats.Request
  alias Aerie.Fleet.Shadow.{Metrics, Settings}
  alias Aerie.Base.PubSub

  import Subscriber, only: [refusal: 2, reply: 2, signed?: 2]

  @queue "aerie-shadow"
  @max_waiting 1_000
  @max_waiting_signed 10_000
  @max_tasks 64
  @signed_tasks 32
  @most_answered 100

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :shadow_nats))

  @impl GenServer
  def init(gateway: gateway, settings: settings) do
    Process.set_label({:shadow_nats, gateway})
    :ok = PubSub.subscribe(gateway, :bridge)
    {:ok, tasks} = Task.Supervisor.start_link()

    state = %{
      gateway: gateway,
      environment: settings.bridge.environment,
      tasks: tasks,
      running: %{},
      conn: nil
    }

    {:ok, connect(state)}
  end

  @impl GenServer
  def handle_info({:msg, message}, state) do
    {:message_queue_len, waiting} = Process.info(self(), :message_queue_len)

    signed? = waiting <= @max_waiting_signed and signed?(state.gateway, message)

    cond do
      waiting > @max_waiting and not signed? ->
        Metrics.count(state.gateway, :dropped)
        {:noreply, state}

      map_size(state.running) >= if(signed?, do: @max_tasks, else: @max_tasks - @signed_tasks) ->
        # In a flood nobody waits here for the connection: that would keep the signed ones waiting, too.
        if signed? or waiting <= @most_answered,
          do: reply(message, busy(map_size(state.running))),
          else: Metrics.count(state.gateway, :dropped)

        {:noreply, state}

      true ->
        {:noreply, run(state, message)}
    end
  end

  def handle_info({task, _done}, state) when is_map_key(state.running, task) do
    Process.demonitor(task, [:flush])
    {:noreply, %{state | running: Map.delete(state.running, task)}}
  end

  def handle_info({:DOWN, task, :process, _pid, _crash}, state) when is_map_key(state.running, task) do
    {message, running} = Map.pop!(state.running, task)
    reply(message, refusal("unavailable", "a fault of the gateway ended its work on the request"))
    {:noreply, %{state | running: running}}
  end

  def handle_info({:fleet, :bridge, {:connection, _info}}, state), do: {:noreply, connect(state)}
  def handle_info(_late, state), do: {:noreply, state}

  defp connect(state),
    do: Subscriber.follow(state, "fleet.#{state.environment}.*.shadow.*", queue_group: @queue)

  defp busy(number),
    do: refusal("busy", "#{number} requests are under way, as many as there may be; try again")

  defp run(state, message) do
    gateway = state.gateway
    task = Task.Supervisor.async_nolink(state.tasks, fn -> reply(message, answer(gateway, message)) end)
    %{state | running: Map.put(state.running, task.ref, message)}
  end

  defp answer(gateway, message) do
    case Request.read(message, Policy.Store.get(gateway), System.os_time(:microsecond)) do
      {:ok, request} -> gateway |> obey(request) |> body(request)
      {:refused, rule, reason} -> refusal(rule, reason)
    end
  end

  defp obey(gateway, %{action: :get} = request), do: Shadow.get(gateway, request.vehicle)
  defp obey(gateway, %{action: :delta} = request), do: Shadow.delta(gateway, request.vehicle)

  defp obey(gateway, %{action: :update} = request),
    do: Shadow.update(gateway, request.vehicle, request.object, request.source, "nats")

  defp obey(gateway, %{action: :delete} = request),
    do: Shadow.delete(gateway, request.vehicle, request.object, request.source, "nats")

  defp body({:ok, answer}, _request), do: Map.put(answer, "result", "ok")

  defp body({:error, {rule, _what} = refusal}, request),
    do: rule |> Atom.to_string() |> refusal(Shadow.text(refusal)) |> Map.put("token", request.object["token"])
end
