defmodule Aerie.Bridge.Commands do
  @moduledoc """
  Commands by NATS: request and reply on `fleet.{environment}.{vehicle}.cmd.{type}`, in no stream.

  The gateway listens for the vehicles that it has heard, so a request for any other one is answered by the server (no
  responders). Of several gateways that hear the same vehicle the one that holds it listens (`Aerie.Shadow.Holder`); the others leave it.

  So are requests for parameters, plans, files and logs (`Aerie.Bridge.Commands.Transfers`), on subjects with their own area in the place of
  `cmd`.

  Each message is handled in a task; `Aerie.Bridge.Commands.Request` says who commands what, `Aerie.Commands` does the rest. The type
  `cancel` with the id of a command, or of a reading, cancels that one. Progress is published on `….cmd.{type}.progress.{id}`.

  | what | limit | beyond it |
  |---|---|---|
  | messages that wait here | 1000 | dropped, counted in `gateway_nats_commands_dropped_total` |
  | tasks | 512, and 64 for what holds a vehicle or brings it down | answered with rule `busy` |
  | a message | 16 KiB, of other areas 1 MB | answered with rule `size` |
  """
  use GenServer

  alias Aerie.Bridge.Commands.{Request, Transfers}
  alias Aerie.Bridge.{Connection, Settings, Tables}
  alias Aerie.{Command, Commands, Names, Nats, Policy, Store}
  alias Aerie.Command.{Error, Result}
  alias Aerie.Commands.Record
  alias Aerie.Policy.Facts
  alias Aerie.Store.PubSub

  @queue "aerie-commands"
  @max_waiting 1_000
  @max_tasks 512
  @reserve 64

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_commands))

  @doc "The vehicles whose commands it listens to."
  @spec vehicles(Names.gateway()) :: [String.t()]
  def vehicles(gateway), do: GenServer.call(Names.via(gateway, :bridge_commands), :vehicles, :infinity)

  @doc """
  Leaves vehicles to other gateways, by their ids, until the same reason is given again: `:heard`, this one's links have lost them, and
  others hear them; `:holder`, this one does not hold them.
  """
  @spec leave(Names.gateway(), :heard | :holder, MapSet.t(String.t())) :: :ok
  def leave(gateway, why, ids),
    do: GenServer.cast(Names.via(gateway, :bridge_commands), {:leave, why, ids})

  @impl GenServer
  def init(options) do
    gateway = options[:gateway]
    Process.set_label({:bridge_commands, gateway})
    :ok = PubSub.subscribe(gateway, :roster)
    tables = Tables.get(gateway)
    {:ok, tasks} = Task.Supervisor.start_link()

    state = %{
      gateway: gateway,
      environment: options[:settings].environment,
      tables: tables,
      tasks: tasks,
      running: %{},
      conn: nil,
      subscribed: %{},
      left: %{}
    }

    case Connection.current(tables) do
      %{conn: conn} -> {:ok, connected(state, conn)}
      nil -> {:ok, state}
    end
  end

  @impl GenServer
  def handle_call(:vehicles, _from, state), do: {:reply, Enum.sort(Map.keys(state.subscribed)), state}

  @impl GenServer
  def handle_cast({:leave, why, ids}, %{left: left} = state) do
    changed = MapSet.symmetric_difference(ids, Map.get(left, why, MapSet.new()))
    {:noreply, Enum.reduce(changed, %{state | left: Map.put(left, why, ids)}, &look/2)}
  end

  @impl GenServer
  def handle_info({:msg, message}, state) do
    {_vehicle, type} = Request.subject(message.topic)
    Tables.count(state.tables, :received, subject: label(type))
    {:message_queue_len, waiting} = Process.info(self(), :message_queue_len)

    cond do
      waiting > @max_waiting -> Tables.count(state.tables, :commands_dropped)
      map_size(state.running) >= @max_tasks + reserve(type) -> busy(state, message)
      true -> :run
    end
    |> case do
      :run -> {:noreply, run(state, message)}
      :ok -> {:noreply, state}
    end
  end

  def handle_info({:command_progress, topic, id, progress}, state) do
    body = JSON.encode!(Map.put(progress, "id", id))
    # Progress that does not arrive is followed by more of it, or by the result.
    _ = if state.conn, do: Nats.pub(state.conn, "#{topic}.progress.#{id}", body)
    {:noreply, state}
  end

  def handle_info({task, _done}, state) when is_map_key(state.running, task) do
    Process.demonitor(task, [:flush])
    {:noreply, %{state | running: Map.delete(state.running, task)}}
  end

  def handle_info({:DOWN, task, :process, _pid, _crash}, state) when is_map_key(state.running, task) do
    {message, running} = Map.pop!(state.running, task)
    reason = "a fault of the gateway ended its work on the message; the command may have been sent"
    reply(state.tables, message, %{"id" => nil, "result" => "unknown", "reason" => reason})
    {:noreply, %{state | running: running}}
  end

  # Told again after each look at the streams.
  def handle_info({:bridge, :up, conn}, %{conn: conn} = state), do: {:noreply, state}
  def handle_info({:bridge, :up, conn}, state), do: {:noreply, connected(state, conn)}
  def handle_info({:bridge, :down}, state), do: {:noreply, %{state | conn: nil, subscribed: %{}}}
  def handle_info({:fleet, :roster, id}, state), do: {:noreply, look(id, state)}
  def handle_info(_late, state), do: {:noreply, state}

  defp connected(state, conn) do
    state = %{state | conn: conn, subscribed: %{}}
    Enum.reduce(Store.vehicles(state.gateway), state, &look(&1.id, &2))
  end

  defp look(_id, %{conn: nil} = state), do: state

  defp look(id, state) do
    left? = Enum.any?(state.left, fn {_why, ids} -> id in ids end)

    case {if(not left?, do: Store.vehicle(state.gateway, id)), state.subscribed} do
      {nil, %{^id => sids}} ->
        for sid <- sids, do: _ = Nats.unsub(state.conn, sid)
        %{state | subscribed: Map.delete(state.subscribed, id)}

      {%{}, subscribed} when not is_map_key(subscribed, id) ->
        sids =
          for area <- ["cmd" | Transfers.areas()],
              subject = "fleet.#{state.environment}.#{id}.#{area}.*",
              # Otherwise the connection is lost; the next one subscribes.
              {:ok, sid} <- [Aerie.Nats.sub(state.conn, self(), subject, queue_group: @queue)],
              do: sid

        if length(sids) > length(Transfers.areas()),
          do: %{state | subscribed: Map.put(subscribed, id, sids)},
          else: state

      _as_it_was ->
        state
    end
  end

  defp reserve(type), do: if(type in Facts.ending(), do: @reserve, else: 0)

  # Of what is counted by its subject.
  defp label("cancel"), do: "cmd.cancel"

  defp label(type) do
    case String.split(type, ".") do
      [area, operation] ->
        if Transfers.known?(area, operation), do: type, else: area <> ".unknown"

      [type] ->
        "cmd." <> if(match?({:ok, _type}, Command.Types.fetch(type)), do: type, else: "unknown")
    end
  end

  defp run(state, message) do
    %{gateway: gateway, tables: tables} = state
    face = self()
    task = Task.Supervisor.async_nolink(state.tasks, fn -> answer(gateway, tables, face, message) end)
    %{state | running: Map.put(state.running, task.ref, message)}
  end

  defp busy(state, message) do
    reason = "#{map_size(state.running)} commands by NATS are under way, as many as there may be; try again"
    reply(state.tables, message, refusal(%{}, :busy, reason))
  end

  defp answer(gateway, tables, face, message) do
    body =
      case Request.read(message, Policy.Store.get(gateway), System.os_time(:microsecond)) do
        {:ok, request} -> obey(gateway, face, message.topic, request)
        {:refused, envelope, {rule, reason}} -> turn_away(gateway, envelope, rule, reason)
      end

    reply(tables, message, body)
  end

  defp obey(gateway, _face, _topic, %{type: "cancel", envelope: %{"id" => id}} = request)
       when is_binary(id) do
    case Commands.cancel(gateway, request.vehicle, id, request.source, "nats") do
      :ok -> accepted(id)
      {:error, :unknown, reason} -> cease(gateway, request.vehicle, id, reason)
      {:error, :role, reason} -> %{"id" => id, "result" => "denied", "rule" => "role", "reason" => reason}
      {:error, _why, reason} -> %{"id" => id, "result" => "rejected", "reason" => reason}
    end
  end

  defp obey(gateway, face, topic, %{type: type} = request) do
    case String.split(type, ".") do
      [area, operation] ->
        Transfers.answer(gateway, {area, operation}, request.envelope, request.source, {face, topic})

      [_command] ->
        command(gateway, face, topic, request)
    end
  end

  # A reading is no command: whoever may read may end it.
  defp cease(gateway, vehicle, id, reason) do
    case Aerie.Transfers.cancel(gateway, vehicle, id) do
      :ok -> accepted(id)
      {:error, _none} -> %{"id" => id, "result" => "rejected", "reason" => reason}
    end
  end

  defp accepted(id), do: %{"id" => id, "result" => "accepted", "reason" => nil}

  defp command(gateway, face, topic, request) do
    case Commands.submit(gateway, request.envelope, request.source, via: "nats", progress: {face, topic}) do
      {:ok, result} ->
        Result.plain(result)

      {:pending, id} ->
        %{"id" => id, "result" => nil, "reason" => "it is under way"}

      {:error, errors} ->
        request.envelope
        |> refusal(:malformed, Error.text(errors))
        |> Map.put("errors", for(error <- errors, do: Map.take(plain(error), ["key", "expected", "got"])))
    end
  end

  defp plain(error), do: %{"key" => error.key, "expected" => error.expected, "got" => error.got}

  defp turn_away(gateway, envelope, rule, reason) do
    Record.turned_away(gateway, envelope, nil, "nats", rule, reason)
    refusal(envelope, rule, reason)
  end

  defp refusal(envelope, rule, reason) do
    id = with id when not is_binary(id) or byte_size(id) > 64 <- envelope["id"], do: nil
    result = if rule in [:malformed, :size], do: "rejected", else: "denied"
    %{"id" => id, "result" => result, "rule" => Atom.to_string(rule), "reason" => reason}
  end

  defp reply(_tables, %{reply_to: nil}, _body), do: :ok

  defp reply(tables, message, body) do
    with {:error, _lost} <- Nats.pub(message.gnat, message.reply_to, JSON.encode_to_iodata!(body)),
         do: Tables.count(tables, :publish_errors)

    :ok
  end
end
