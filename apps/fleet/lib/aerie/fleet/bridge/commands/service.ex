defmodule Aerie.Fleet.Bridge.Commands.Service do
  @moduledoc """
  Answers requests over NATS for the operations of an area, such as `shadow.get`: on
  `fleet.{environment}.{target}.{area}.{action}`, `target` being a vehicle or a gateway. Each message is handled in a
  task, once `Aerie.Fleet.Bridge.Commands.Queue` has a place for it.

  Reading needs no signature: every user of NATS sees the buckets and events anyway. A change is made in the name of the
  key that signed the message, as for commands (`Aerie.Control.Policy.Roles.Signature`), and has the field without which
  a copy of it would be another change (`once` of `Aerie.Control.Operations.Operation`).

  | what | limit | beyond it |
  |---|---|---|
  | messages that wait here | 1000; that of `Queue` for a listed key's | dropped and counted |
  | tasks | those of `Queue`; a read has the place of an unsigned request | answered with rule `busy` |
  | what nobody has signed who may | a rate (`Queue`) | dropped and counted |
  | a message | `:max_bytes` | answered with rule `size` |
  """
  use GenServer

  alias Aerie.Base.{Names, PubSub}
  alias Aerie.Control.Operations.{Operation, Table}
  alias Aerie.Control.Policy
  alias Aerie.Fleet.Bridge.Commands.{Request, Workers}
  alias Aerie.Fleet.Bridge.Connection.Subscriber
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Fleet.Nats
  alias Aerie.Vehicle.Command.Refusal

  @enforce_keys [:gateway, :name, :operations, :subject, :max_bytes]
  defstruct [:gateway, :name, :operations, :subject, :queue_group, :max_bytes, :dropped, :workers, :conn]

  @typedoc """
    * `:name` - that of the process; `:operations` - what it answers
    * `:subject`, `:queue_group` - what it subscribes to; gateways with one queue group share the messages
    * `:max_bytes` - the largest body; `:dropped` - counts a dropped message besides the bridge
  """
  @type option ::
          {:gateway, Names.gateway()}
          | {:name, atom()}
          | {:operations, [Operation.t(), ...]}
          | {:subject, String.t()}
          | {:queue_group, String.t()}
          | {:max_bytes, pos_integer()}
          | {:dropped, (-> term())}

  @doc "Starts it; the options are `t:option/0`."
  @spec start_link([option()]) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], options[:name]))

  @impl GenServer
  def init(options) do
    state = struct!(__MODULE__, options)
    Process.set_label({state.name, state.gateway})
    :ok = PubSub.subscribe(state.gateway, :bridge)
    server = self()
    {:ok, connect(%{state | workers: Workers.new(state.gateway, &work(state, server, &1, &2, &3))})}
  end

  @impl GenServer
  # From a task whose message had a valid signature: whether it may continue.
  def handle_call({:verified, signature}, {pid, _tag}, state) do
    {answer, workers} = Workers.verified(state.workers, pid, signature, false)
    {:reply, answer, %{state | workers: workers}}
  end

  @impl GenServer
  def handle_info({:msg, message}, state) do
    need = if match?({:ok, %{changes?: true}}, operation(state, message)), do: :source, else: :nothing

    case Workers.arrive(state.workers, message, need, false) do
      {:ok, workers} ->
        {:noreply, %{state | workers: workers}}

      {:drop, what} ->
        Tables.count(Tables.get(state.gateway), :"commands_#{what}")
        if state.dropped, do: state.dropped.()
        {:noreply, state}
    end
  end

  def handle_info({task, _done}, state) when is_reference(task) do
    {_message, workers} = Workers.ended(state.workers, task)
    {:noreply, %{state | workers: workers}}
  end

  def handle_info({:DOWN, task, :process, _pid, _crash}, state) do
    {message, workers} = Workers.ended(state.workers, task)

    _ =
      if message,
        do: reply(message, refusal(Refusal.deny(:request_broken)))

    {:noreply, %{state | workers: workers}}
  end

  def handle_info({:fleet, :bridge, {:connection, _info}}, state), do: {:noreply, connect(state)}
  def handle_info(_late, state), do: {:noreply, state}

  defp connect(state) do
    options = if state.queue_group, do: [queue_group: state.queue_group], else: []
    Subscriber.follow(state, state.subject, options)
  end

  defp operation(%{operations: operations}, %{topic: topic}) do
    [_fleet, _environment, _target, area, action] = String.split(topic, ".")

    with :error <- Table.fetch(operations, area <> "." <> action) do
      actions = for %{name: name} <- operations, do: String.replace_prefix(name, area <> ".", "")
      Refusal.deny(:no_action, actions: Enum.join(actions, ", "))
    end
  end

  defp work(_state, _server, message, :busy, number),
    do: reply(message, refusal(Refusal.deny(:busy_requests, n: number)))

  defp work(state, server, message, _phase, _number), do: reply(message, answer(state, server, message))

  defp answer(state, server, message) do
    signature = Request.signature(message)

    with {:ok, operation} <- operation(state, message),
         {:ok, object} <- decode(message.body, state.max_bytes),
         {:ok, source} <- source(operation, state.gateway, signature, message),
         :ok <- admitted(server, source, signature),
         :ok <- once(operation.once, signature, object) do
      operation |> run(state.gateway, message, object, source) |> body(operation, object)
    else
      {:busy, number} -> refusal(Refusal.deny(:busy_requests, n: number))
      denial -> refusal(denial)
    end
  end

  # Many reads have no keys.
  defp decode("", _max), do: {:ok, %{}}
  defp decode(body, max), do: Request.decode(body, max)

  defp source(%{changes?: false}, _gateway, _signature, _message), do: {:ok, nil}

  defp source(_changes, gateway, signature, %{topic: topic, body: body}),
    do: Policy.signer(gateway, signature, topic, body)

  defp admitted(_server, source, signature) when source == nil or signature == nil, do: :ok
  defp admitted(server, _source, signature), do: GenServer.call(server, {:verified, signature}, :infinity)

  defp once({key, :signed, reason}, signature, object) when signature != nil, do: given(object[key], reason)
  defp once({key, :always, reason}, _signature, object), do: given(object[key], reason)
  defp once(_copies_are_harmless, _signature, _object), do: :ok

  defp given(nil, reason), do: {:deny, :malformed, reason}
  defp given(_value, _reason), do: :ok

  defp run(operation, gateway, message, object, source) do
    [_fleet, _environment, target | _action] = String.split(message.topic, ".")

    with {:ok, input} <- Operation.parse(operation, object) do
      context = %{
        gateway: gateway,
        vehicle: target,
        source: source,
        via: "nats",
        by: nil,
        options: [],
        format: "json",
        max_bytes: nil
      }

      operation.module.run(input, context)
    end
  end

  defp body({:ok, answer}, _operation, _object), do: Map.put(answer, "result", "ok")

  # The token of a change is in its answer.
  defp body({:error, refused}, %{answer: %{token: _token}}, object),
    do: refused |> refusal() |> Map.put("token", object["token"])

  defp body({:error, refused}, _operation, _object), do: refusal(refused)

  defp refusal({rule, [_ | _] = errors}), do: refusal({:deny, rule, Enum.join(errors, "; ")})
  defp refusal({rule, reason}), do: refusal({:deny, rule, reason})
  defp refusal([_ | _] = errors), do: refusal({:malformed, errors})

  defp refusal({:deny, rule, reason}),
    do: %{"result" => "refused", "rule" => Atom.to_string(rule), "reason" => reason}

  # A message without a reply subject is ignored; a client without an answer asks again.
  defp reply(%{reply_to: nil}, _body), do: :ok
  defp reply(message, body), do: Nats.pub(message.gnat, message.reply_to, JSON.encode_to_iodata!(body))
end
