defmodule Aerie.Fleet.Client.RawMessage do
  @component 190

  @moduledoc """
  Sends one MAVLink message in the name of somebody who proved who he is, and gives what was answered.

  It goes the way of every client's message: a process of its own becomes a client endpoint of the router for a moment, so filters, the
  gate for commands, the policy and the audit log hold for it as for a ground station's. It comes from the gateway's system id and component
  #{@component}, so that answers find their way back.
  """

  alias Aerie.Base.Principal
  alias Aerie.Control.Policy.Roles
  alias MavRouter.Router
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Client.LocalEndpoint
  alias MavRouter.Endpoints.Counters
  alias MavCodec.{Frame, Parser}
  alias MavCodec.Message.EncodeError

  @wait_ms 1_500
  @max_answers 16
  @grace_ms 5_000

  @typedoc """
  `outcome`: `:sent` to so many endpoints' networks; `:no_route` (nobody with the target's ids is known), `:denied` (by the policy or the
  gate; the answers say why). `answers`: frames that came for us within a second and a half.
  """
  @type result :: %{outcome: :sent | :no_route | :denied, bytes: binary(), answers: [Frame.t()]}

  @doc "Sends a message on a network (its name) or on `:all`. Viewers may send nothing. Options: `:wait_ms` for answers."
  @spec send(Aerie.Base.Names.gateway(), Roles.source(), struct(), String.t() | :all, keyword()) ::
          {:ok, result()} | {:error, String.t()}
  def send(gateway, source, message, network, options \\ [])

  def send(_gateway, %{role: :viewer}, _message, _network, _options),
    do: {:error, "a viewer may not send messages"}

  def send(gateway, source, message, network, options) do
    with %{system: system} when is_integer(system) <- Router.identity(gateway),
         {:ok, bytes} <- encode(message, system) do
      wait_ms = Keyword.get(options, :wait_ms, @wait_ms)
      task = Task.async(fn -> exchange(gateway, source, bytes, network, wait_ms) end)

      case Task.yield(task, wait_ms + @grace_ms) || Task.shutdown(task, :brutal_kill) do
        {:ok, result} -> result
        _none -> {:error, "the router did not take the message"}
      end
    else
      %{system: nil} -> {:error, "the gateway does not know its own system id yet"}
      {:error, text} -> {:error, text}
    end
  end

  defp encode(message, system) do
    {:ok, MavCodec.encode(message, system: system, component: @component)}
  rescue
    error in EncodeError -> {:error, Exception.message(error)}
  end

  defp exchange(gateway, source, bytes, network, wait_ms) do
    Process.set_label({:raw_message, gateway})
    principal = struct!(%Principal{kind: :user, name: source.name}, Map.take(source, [:role, :permissions]))
    networks = if network == :all, do: [], else: [networks: [network]]
    id = "message-#{System.unique_integer([:positive])}"

    # Broadcasts are not for us: only what has our ids as target is an answer.
    case LocalEndpoint.attach(
           gateway,
           [id: id, kind: :message, text: source.name, principal: principal, broadcasts: false, sign: true] ++
             networks
         ) do
      {:ok, endpoint} ->
        {frames, _parser} = Parser.push_datagram(Parser.new(), bytes, System.os_time(:microsecond))
        _outcome = LocalEndpoint.ingress(endpoint, frames)
        answers = answers(endpoint, [], System.monotonic_time(:millisecond) + wait_ms)
        counters = Counters.read(endpoint.counters)
        LocalEndpoint.detach(endpoint)
        {:ok, %{outcome: outcome(counters, answers), bytes: bytes, answers: answers}}

      {:error, :not_running} ->
        {:error, "the router does not run"}

      {:error, text} ->
        {:error, text}
    end
  end

  defp outcome(%{no_route: n}, _answers) when n > 0, do: :no_route
  defp outcome(%{denied: n, withheld: k}, _answers) when n + k > 0, do: :denied
  defp outcome(_counters, _answers), do: :sent

  defp answers(endpoint, found, until) do
    receive do
      {:forward, frames, _class} ->
        Endpoint.taken(endpoint, length(frames))
        new = Enum.flat_map(frames, &parse/1)
        found = Enum.take(found ++ new, @max_answers)
        if length(found) == @max_answers, do: found, else: answers(endpoint, found, until)
    after
      max(until - System.monotonic_time(:millisecond), 0) -> found
    end
  end

  defp parse(bytes), do: Parser.new() |> Parser.push_datagram(bytes, System.os_time(:microsecond)) |> elem(0)
end
