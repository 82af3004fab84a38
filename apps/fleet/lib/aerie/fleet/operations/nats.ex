defmodule Aerie.Fleet.Operations.Nats do
  @moduledoc """
  Operations over NATS: request and reply on `fleet.{environment}.{gateway}.operation.{begin,stop,get,list}`, `gateway` being the name that
  the gateway's own events have.

  To begin or stop one takes a signature as a command does (`Aerie.Control.Policy.Signature`), and an `id`: so a copy that is sent again is the
  same operation. Requests are handled one by one, because none of them waits for a vehicle; 200 may wait, and 5,000 for those that
  claim the signature of a listed key. Further ones are dropped.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Fleet.{Bridge, Operations}
  alias Aerie.Fleet.Bridge.Subscriber
  alias Aerie.Control.Policy.Sources
  alias Aerie.Base.PubSub

  import Subscriber, only: [refusal: 2, reply: 2, signed?: 2]

  @max_waiting 200
  @max_waiting_signed 5_000
  @max_bytes 131_072

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :operations_nats))

  @impl GenServer
  def init(gateway: gateway) do
    Process.set_label({:operations_nats, gateway})
    :ok = PubSub.subscribe(gateway, :bridge)
    {:ok, connect(%{gateway: gateway, conn: nil})}
  end

  @impl GenServer
  def handle_info({:msg, message}, state) do
    {:message_queue_len, waiting} = Process.info(self(), :message_queue_len)

    if waiting <= @max_waiting or (waiting <= @max_waiting_signed and signed?(state.gateway, message)),
      do: reply(message, answer(state.gateway, message))

    {:noreply, state}
  end

  def handle_info({:fleet, :bridge, {:connection, _info}}, state), do: {:noreply, connect(state)}
  def handle_info(_late, state), do: {:noreply, state}

  defp connect(%{gateway: gateway} = state),
    do: Subscriber.follow(state, "fleet.#{Bridge.environment(gateway)}.#{Bridge.name(gateway)}.operation.*")

  defp answer(gateway, %{topic: topic, body: body} = message) do
    action = topic |> String.split(".") |> List.last()

    with {:ok, object} <- decode(body),
         {:ok, source} <- who(gateway, action, message),
         do: act(gateway, action, object, source)
  end

  defp act(gateway, "begin", %{"id" => _id} = object, source),
    do: gateway |> Operations.begin(object, source, "nats") |> body()

  defp act(_gateway, "begin", _object, _source),
    do: refusal("malformed", "id: an operation over NATS has one, so that a copy of it is the same one")

  defp act(gateway, "stop", %{"id" => id}, source) when is_binary(id),
    do: gateway |> Operations.stop(id, source) |> body()

  defp act(gateway, "get", %{"id" => id}, _source) when is_binary(id),
    do: gateway |> Operations.get(id) |> body()

  defp act(gateway, "list", _object, _source),
    do: %{"result" => "ok", "operations" => Operations.list(gateway)}

  defp act(_gateway, action, _object, _source) when action in ["get", "stop"],
    do: refusal("malformed", "id: the id of an operation")

  defp act(_gateway, _other, _object, _source),
    do: refusal("malformed", "the last word of the subject must be begin, stop, get or list")

  defp decode(body) when byte_size(body) > @max_bytes,
    do: refusal("size", "the body has more than #{@max_bytes} bytes")

  defp decode(""), do: {:ok, %{}}

  defp decode(body) do
    with {:ok, %{} = object} <- JSON.decode(body),
         do: {:ok, object},
         else: (_other -> refusal("malformed", "the body is not a JSON object"))
  end

  defp who(gateway, action, message) when action in ["begin", "stop"] do
    signature = Map.new(message[:headers] || [])["aerie-signature"]

    case Policy.Store.get(gateway) do
      nil ->
        refusal("policy", "the gateway has no policy, so nobody may change anything")

      policy ->
        with {:error, reason} <-
               Sources.identify(policy, signature, message.topic, message.body, System.os_time(:microsecond)),
             do: refusal("signature", reason)
    end
  end

  defp who(_gateway, _reads, _message), do: {:ok, nil}

  defp body({:ok, operation}), do: Map.put(operation, "result", "ok")

  defp body({:error, {rule, _what} = refused}),
    do: rule |> Atom.to_string() |> refusal(Operations.text(refused))
end
