defmodule Aerie.Fleet.Bridge.Commands do
  @moduledoc """
  Commands over NATS: request and reply on `fleet.{environment}.{vehicle}.cmd.{type}`, in no stream.

  The gateway listens for the vehicles that it has heard, so a request for any other one is answered by the server (no
  responders). If several gateways hear the same vehicle, the one that holds it listens
  (`Aerie.Control.Commands.Gateways`); the others leave it.

  So are requests for parameters, plans, files and logs (`Aerie.Fleet.Bridge.Commands.Operation`), on subjects with
  their own area in the place of `cmd`.

  Each message is handled in a task, once `Aerie.Fleet.Bridge.Commands.Queue` has a place for it;
  `Aerie.Fleet.Bridge.Commands.Request` says who commands what, `Aerie.Control.Commands` does the rest. The type
  `cancel` with the id of a command, or of a reading, cancels that one. Progress is published on
  `….cmd.{type}.progress.{id}`.

  | what | limit | beyond it |
  |---|---|---|
  | messages that wait here | 1000; those that claim the signature of a listed key have the limits of `Queue` | dropped, counted in `gateway_nats_commands_dropped_total` |
  | tasks | those of `Aerie.Fleet.Bridge.Commands.Queue` | answered with rule `busy` |
  | what nobody has signed who may | a rate (`Lanes`) | dropped, counted in `gateway_nats_commands_unread_total` |
  | a message | 16 KiB, of other areas 1 MB | answered with rule `size` |
  """
  use GenServer

  alias Aerie.Fleet.Bridge.Commands.{Operation, Request, Workers}
  alias Aerie.Fleet.Bridge.{Connection, Settings}
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Base.{Json, Names, Store}
  alias Aerie.Control.{Commands, Policy}
  alias Aerie.Fleet.Nats
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Control.Policy.Intent
  alias Aerie.Base.PubSub

  @queue "aerie-commands"

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_commands))

  @doc "The vehicles whose commands it listens to."
  @spec vehicles(Names.gateway()) :: [String.t()]
  def vehicles(gateway), do: GenServer.call(Names.via(gateway, :bridge_commands), :vehicles, :infinity)

  @doc """
  Leaves vehicles to other gateways, by their ids, until the same reason is given again: `:heard`, others hear them,
  so they are left while this one's links have lost them; `:holder`, this one does not hold them.
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
    server = self()

    state = %{
      gateway: gateway,
      environment: options[:settings].environment,
      tables: tables,
      workers: Workers.new(gateway, &work(gateway, tables, server, &1, &2, &3)),
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

  # From a task whose message had a valid signature: whether it may continue.
  def handle_call({:verified, type, signature}, {pid, _tag}, state) do
    {answer, workers} = Workers.verified(state.workers, pid, signature, type in Intent.ending())
    {:reply, answer, %{state | workers: workers}}
  end

  @impl GenServer
  def handle_cast({:leave, why, ids}, %{left: left} = state) do
    named = MapSet.union(ids, Map.get(left, why, MapSet.new()))
    {:noreply, Enum.reduce(named, %{state | left: Map.put(left, why, ids)}, &follow_vehicle/2)}
  end

  @impl GenServer
  def handle_info({:msg, message}, state) do
    {_vehicle, type} = Request.subject(message.topic)

    case Workers.arrive(state.workers, message, :source, type in Intent.ending()) do
      {:ok, workers} ->
        Tables.count(state.tables, :received, subject: label(type))
        {:noreply, %{state | workers: workers}}

      {:drop, what} ->
        Tables.count(state.tables, :"commands_#{what}")
        {:noreply, state}
    end
  end

  def handle_info({:command_progress, topic, id, progress}, state) do
    body = Json.encode!(Map.put(progress, "id", id))
    # Progress that does not arrive is followed by more of it, or by the result.
    _ = if state.conn, do: Nats.pub(state.conn, "#{topic}.progress.#{id}", body)
    {:noreply, state}
  end

  def handle_info({task, _done}, state) when is_reference(task) do
    {_message, workers} = Workers.ended(state.workers, task)
    {:noreply, %{state | workers: workers}}
  end

  def handle_info({:DOWN, task, :process, _pid, _crash}, state) do
    {message, workers} = Workers.ended(state.workers, task)
    reason = "a fault of the gateway ended its work on the message; the command may have been sent"
    if message, do: reply(state.tables, message, %{"id" => nil, "result" => "unknown", "reason" => reason})
    {:noreply, %{state | workers: workers}}
  end

  # Told again after each look at the streams.
  def handle_info({:bridge, :up, conn}, %{conn: conn} = state), do: {:noreply, state}
  def handle_info({:bridge, :up, conn}, state), do: {:noreply, connected(state, conn)}
  def handle_info({:bridge, :down}, state), do: {:noreply, %{state | conn: nil, subscribed: %{}}}
  def handle_info({:fleet, :roster, id}, state), do: {:noreply, follow_vehicle(id, state)}
  def handle_info(_late, state), do: {:noreply, state}

  defp connected(state, conn) do
    state = %{state | conn: conn, subscribed: %{}}
    Enum.reduce(Store.vehicles(state.gateway), state, &follow_vehicle(&1.id, &2))
  end

  defp follow_vehicle(_id, %{conn: nil} = state), do: state

  defp follow_vehicle(id, state) do
    vehicle = Store.vehicle(state.gateway, id)

    case {if(not left?(state, vehicle), do: vehicle), state.subscribed} do
      {nil, %{^id => sids}} ->
        for sid <- sids, do: _ = Nats.unsub(state.conn, sid)
        %{state | subscribed: Map.delete(state.subscribed, id)}

      {%{}, subscribed} when not is_map_key(subscribed, id) ->
        areas = ["cmd" | Operation.areas()]

        sids =
          for area <- areas,
              subject = "fleet.#{state.environment}.#{id}.#{area}.*",
              # Otherwise the connection is lost; the next one subscribes.
              {:ok, sid} <- [Aerie.Fleet.Nats.sub(state.conn, self(), subject, queue_group: @queue)],
              do: sid

        if length(sids) == length(areas),
          do: %{state | subscribed: Map.put(subscribed, id, sids)},
          else: state

      _as_it_was ->
        state
    end
  end

  defp left?(_state, nil), do: false

  defp left?(%{left: left}, %{id: id, status: status}) do
    left?(left, :holder, id) or (status == :lost and left?(left, :heard, id))
  end

  defp left?(left, why, id), do: id in Map.get(left, why, MapSet.new())

  # Messages counted by subject.
  defp label("cancel"), do: "cmd.cancel"

  defp label(type) do
    case String.split(type, ".") do
      [area, _action] ->
        if Operation.known?(type), do: type, else: area <> ".unknown"

      [type] ->
        "cmd." <> if(match?({:ok, _type}, Command.Types.fetch(type)), do: type, else: "unknown")
    end
  end

  defp work(_gateway, tables, _server, message, :busy, under_way), do: reply(tables, message, busy(under_way))

  defp work(gateway, tables, server, message, _phase, _under_way) do
    body =
      with {:ok, request} <- Request.read(message, Policy.Store.get(gateway), System.os_time(:microsecond)),
           :ok <- admitted(server, request, Request.signature(message)) do
        obey(gateway, server, message.topic, request)
      else
        {:refused, envelope, denial} -> turn_away(gateway, envelope, denial)
        {:busy, number} -> busy(number)
      end

    reply(tables, message, body)
  end

  defp busy(number), do: refusal(%{}, Refusal.deny(:busy_nats, n: number))

  # An unsigned one has its place already.
  defp admitted(_server, _request, nil), do: :ok

  defp admitted(server, request, signature),
    do: GenServer.call(server, {:verified, request.type, signature}, :infinity)

  defp obey(gateway, _server, _topic, %{type: "cancel", envelope: %{"id" => id}} = request)
       when is_binary(id) do
    case Commands.cancel(gateway, request.vehicle, id, request.source, "nats") do
      :ok -> accepted(id)
      {:error, :unknown, reason} -> cancel_read(gateway, request.vehicle, id, reason)
      {:error, :role, reason} -> %{"id" => id, "result" => "denied", "rule" => "role", "reason" => reason}
      {:error, _why, reason} -> %{"id" => id, "result" => "rejected", "reason" => reason}
    end
  end

  defp obey(gateway, server, topic, %{type: type} = request) do
    # No command has a dot in its name.
    if String.contains?(type, "."),
      do: Operation.answer(gateway, type, request.envelope, request.source, {server, topic}),
      else: command(gateway, server, topic, request)
  end

  # A read is not a command: everyone who may read may cancel it.
  defp cancel_read(gateway, vehicle, id, reason) do
    case Aerie.Control.Transfers.cancel(gateway, vehicle, id) do
      :ok -> accepted(id)
      {:error, _none} -> %{"id" => id, "result" => "rejected", "reason" => reason}
    end
  end

  defp accepted(id), do: %{"id" => id, "result" => "accepted", "reason" => nil}

  defp command(gateway, server, topic, request) do
    case Commands.submit(gateway, request.envelope, request.source, via: "nats", progress: {server, topic}) do
      {:ok, result} ->
        Result.plain(result)

      {:pending, id} ->
        %{"id" => id, "result" => nil, "reason" => "it is under way"}

      {:error, errors} ->
        request.envelope
        |> refusal({:deny, :malformed, Enum.join(errors, "; ")})
        |> Map.put("errors", for(error <- errors, do: Map.take(plain(error), ["key", "expected", "got"])))
    end
  end

  defp plain(error), do: %{"key" => error.key, "expected" => error.expected, "got" => error.got}

  defp turn_away(gateway, envelope, denial) do
    Commands.turned_away(gateway, envelope, nil, "nats", denial)
    refusal(envelope, denial)
  end

  defp refusal(envelope, denial) do
    id = with id when not is_binary(id) or byte_size(id) > 64 <- envelope["id"], do: nil
    "" |> Refusal.result(denial) |> Result.plain() |> Map.put("id", id)
  end

  defp reply(_tables, %{reply_to: nil}, _body), do: :ok

  defp reply(tables, message, body) do
    with {:error, _lost} <- Nats.pub(message.gnat, message.reply_to, Json.encode_to_iodata!(body)),
         do: Tables.count(tables, :publish_errors)

    :ok
  end
end
