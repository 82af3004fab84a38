defmodule Aerie.EndpointCase do
  @moduledoc """
  Tests of the router's rules: a gateway with nothing but its router, and processes of the test as endpoints.

  `say/2` delivers frames by an endpoint, `got/1` gives what has come to endpoints.
  """
  use ExUnit.CaseTemplate

  import Aerie.LinkCase

  alias MavRouter.Router
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Client.LocalEndpoint
  alias MavCodec.Messages
  alias MavCodec.Parser

  using do
    quote do
      use Aerie.LinkCase

      import Aerie.EndpointCase

      alias MavRouter.Router
      alias MavRouter.Endpoints.Endpoint
      alias MavRouter.Client.LocalEndpoint
      alias MavCodec.Messages
    end
  end

  setup do
    {:ok, gateway: start_parts(%{mavlink: %{system_id: 245, component_id: 191}})}
  end

  @doc "A process that is an endpoint; the options are those of `MavRouter.Client.LocalEndpoint.attach/2`."
  @spec endpoint(term, String.t(), keyword) :: map
  def endpoint(gateway, name, options) do
    test = self()

    pid =
      start_supervised!(
        {Task,
         fn ->
           {:ok, endpoint} = LocalEndpoint.attach(gateway, [id: name] ++ options)
           send(test, {:attached, name, endpoint})
           relay(test, name, endpoint, nil)
         end},
        id: name
      )

    assert_receive {:attached, ^name, endpoint}
    %{pid: pid, name: name, endpoint: endpoint}
  end

  defp relay(test, name, endpoint, cache) do
    receive do
      {:forward, bytes, class} ->
        Endpoint.taken(endpoint, length(bytes))
        for one <- bytes, do: send(test, {name, one, class})
        relay(test, name, endpoint, cache)

      {:ingress, bytes} ->
        {frames, _} =
          Parser.push_datagram(Parser.new(), bytes, System.os_time(:microsecond))

        {outcome, cache} = LocalEndpoint.ingress(endpoint, frames, cache)
        send(test, {:done, name, outcome})
        relay(test, name, endpoint, cache)
    end
  end

  @doc "Delivers bytes by an endpoint; afterwards everything that goes anywhere is on its way."
  @spec say(map, iodata) :: Router.outcome()
  def say(endpoint, bytes) do
    name = endpoint.name
    send(endpoint.pid, {:ingress, IO.iodata_to_binary(bytes)})
    assert_receive {:done, ^name, outcome}
    outcome
  end

  @doc "Bytes of a message."
  @spec message(struct, non_neg_integer, 0..255, keyword) :: binary
  def message(struct, system, component, options \\ []),
    do: MavCodec.encode(struct, [system: system, component: component] ++ options)

  @doc "What has come to the endpoints, by name. Each says nothing first, so that nothing is on its way any more."
  @spec got(map | [map]) :: %{String.t() => [binary]}
  def got(endpoints) do
    Map.new(List.wrap(endpoints), fn %{name: name} = endpoint ->
      say(endpoint, [])
      {name, drain(name)}
    end)
  end

  defp drain(name) do
    receive do
      {^name, bytes, _class} -> [bytes | drain(name)]
    after
      0 -> []
    end
  end

  @doc "An endpoint that has said an autopilot's heartbeat."
  @spec vehicle(term, String.t(), non_neg_integer, keyword) :: map
  def vehicle(gateway, name, system, options \\ []) do
    endpoint = endpoint(gateway, name, [side: :vehicle] ++ options)
    say(endpoint, heartbeat(system))
    endpoint
  end

  @doc "An endpoint that has said a ground station's heartbeat."
  @spec client(term, String.t(), non_neg_integer, keyword) :: map
  def client(gateway, name, system, options \\ []) do
    endpoint = endpoint(gateway, name, options)
    say(endpoint, gcs(system))
    endpoint
  end

  @doc "A ground station's heartbeat."
  @spec gcs(non_neg_integer) :: binary
  def gcs(system), do: heartbeat(system, type: 6, autopilot: 8, component: 190)

  @doc "A command."
  @spec command(non_neg_integer, 0..255, non_neg_integer) :: struct
  def command(target, component \\ 1, id \\ 400),
    do: %Messages.CommandLong{target_system: target, target_component: component, command: id}

  @doc "What the router says of an endpoint; nil when it is gone."
  @spec counted(term, String.t()) :: map | nil
  def counted(gateway, name), do: Enum.find(Router.endpoints(gateway), &(&1.id == {name, :self}))

  @doc "The frames of bytes."
  @spec parse(binary) :: [MavCodec.Frame.t()]
  def parse(bytes), do: elem(Parser.push(Parser.new(), bytes, 5), 0)

  @doc "Delivers frames by an endpoint, from the calling process."
  @spec deliver(term, String.t(), [MavCodec.Frame.t()]) :: Router.outcome()
  def deliver(gateway, id, frames),
    do: Aerie.Reader.deliver(gateway, %{id: id, network: "main", peer: :self}, frames)
end
