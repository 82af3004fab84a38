defmodule Aerie.Api.WebSocket.Handler do
  @moduledoc """
  One WebSocket client. MAVLink frames are binary messages without an envelope: one unchanged frame in each message to the
  client, one or more in each message from it.

  Access is decided before the upgrade (`Aerie.Access.HTTP.Admission`). A page needs an allowed origin. Everybody needs a key in the
  header `X-Aerie-Key`, or a ticket (`POST /api/tickets`) as `?ticket=TICKET` or as a second subprotocol `ticket.TICKET`
  beside `mavlink`, which the server selects.

  Further parameters: `network=NAME` (several with commas; default all), `access=read` (nothing that the client sends is
  forwarded, as for a key with the role viewer).

  A client that does not answer a ping for a minute, or whose connection takes nothing for ten seconds, is disconnected. Until
  then the oldest frames of the least important class are dropped (`MavRouter.Client.Connection`).
  """

  @behaviour :cowboy_websocket

  alias Aerie.Base.Principal
  alias MavRouter.Router
  alias MavRouter.Client.Connection
  alias Aerie.Base.{Names, PubSub, Store}
  alias Aerie.Base.Net.Address
  alias Aerie.Access.HTTP.{Admission, Error, Request}
  alias Aerie.Access.{KeyRing, Principals, Tickets}
  alias Aerie.Api.WebSocket.Capacity

  @ping_ms 20_000
  @idle_ms 60_000
  @max_message 65_536
  @max_networks 16

  @impl :cowboy_websocket
  def init(request, %{gateway: gateway} = settings) do
    with :ok <- upgrade(request),
         {:ok, requester} <- admit(request, settings),
         {:ok, options} <- options(request, gateway),
         :ok <- reserve(request, gateway) do
      {address, port} = :cowboy_req.peer(request)
      text = "#{requester.name}@#{Address.format(address, port)}"

      options =
        if Principals.role(requester) == :viewer, do: Keyword.put(options, :role, :read_only), else: options

      state = %{
        gateway: gateway,
        requester: requester,
        options:
          [text: text, kind: :websocket, principal: principal(requester), sign: settings.sign] ++ options,
        pipe: nil
      }

      {:cowboy_websocket, chosen(request), state,
       %{idle_timeout: @idle_ms, max_frame_size: @max_message, compress: false}}
    else
      {:error, %Error{} = error} ->
        Store.count_if_running(gateway, {:clients, :websocket, error.code})
        {:ok, Error.refuse(error, request), settings}
    end
  end

  defp upgrade(request) do
    case Request.header(request, "upgrade") do
      text when is_binary(text) and byte_size(text) < 100 ->
        if String.downcase(text) =~ "websocket", do: :ok, else: no_upgrade()

      _absent ->
        no_upgrade()
    end
  end

  defp no_upgrade,
    do:
      {:error, Error.new(:upgrade_required, "this port serves WebSockets only", %{"upgrade" => "websocket"})}

  defp admit(request, %{gateway: gateway} = settings) do
    policy = KeyRing.admit(%{settings.policy | ports: [Aerie.Api.Listener.port(gateway)]}, gateway)
    facts = Request.facts(request)

    case ticket(request) do
      nil ->
        Admission.decide(policy, facts)

      ticket ->
        with :ok <- Admission.origin(policy, facts), :error <- Tickets.redeem(gateway, ticket) do
          {:error, Error.new(:unauthorized, "this ticket is used up, expired or unknown")}
        end
    end
  end

  defp ticket(request) do
    Request.parameters(request)["ticket"] ||
      Enum.find_value(protocols(request), fn
        "ticket." <> ticket -> ticket
        _other -> nil
      end)
  end

  defp options(request, gateway) do
    parameters = Request.parameters(request)

    with {:ok, networks} <- networks(parameters["network"], gateway),
         {:ok, role} <- role(parameters["access"]) do
      {:ok, networks ++ role}
    end
  end

  defp networks(nil, _gateway), do: {:ok, []}

  defp networks(text, gateway) do
    names = String.split(text, ",", trim: true)

    with true <- names != [] and length(names) <= @max_networks,
         true <- Enum.all?(names, &(&1 =~ ~r/\A[A-Za-z0-9_-]{1,64}\z/)),
         :ok <- Router.known_networks(gateway, names) do
      {:ok, [networks: names]}
    else
      false ->
        {:error, Error.new(:bad_request, "network must be a name, or several with commas between them")}

      {:error, unknown} ->
        {:error, Error.new(:bad_request, Exception.message(unknown))}
    end
  end

  defp role(nil), do: {:ok, []}
  defp role("full"), do: {:ok, []}
  defp role("read"), do: {:ok, [role: :read_only]}
  defp role(_other), do: {:error, Error.new(:bad_request, "access must be read or full")}

  # The connection's process, which will run the WebSocket, holds the place; this process ends with the handshake.
  defp reserve(%{pid: connection}, gateway) do
    case Capacity.reserve(gateway, connection) do
      :ok -> :ok
      :full -> {:error, Error.new(:unavailable, "the limit websocket.max_clients is reached")}
      :unavailable -> {:error, Error.new(:unavailable, "the gateway is starting; try again")}
    end
  end

  defp protocols(request) do
    case Request.header(request, "sec-websocket-protocol") do
      nil -> []
      text -> text |> String.split(",") |> Enum.map(&String.trim/1)
    end
  end

  defp chosen(request) do
    if "mavlink" in protocols(request),
      do: :cowboy_req.set_resp_header("sec-websocket-protocol", "mavlink", request),
      else: request
  end

  @impl :cowboy_websocket
  def websocket_init(state) do
    Process.set_label({:websocket_client, state.options[:text]})
    id = "ws-#{System.unique_integer([:positive])}"

    :ok = Names.register(state.gateway, :websocket_client, id)
    :ok = PubSub.subscribe(state.gateway, {:notice, :api_keys})

    case Connection.open(state.gateway, [id: id] ++ state.options) do
      {:ok, pipe} ->
        ping()
        {[], %{state | pipe: pipe}}

      {:error, _not_running} ->
        {[{:close, 1013, "the gateway is starting"}], state}
    end
  end

  # A program of this machine, without any key, is judged by `policy.clients` like any other client.
  defp principal(%Principal{kind: :client}), do: nil
  defp principal(key), do: key

  @impl :cowboy_websocket
  def websocket_handle({:binary, bytes}, state),
    do: {[], %{state | pipe: Connection.read(state.pipe, bytes)}}

  def websocket_handle({:text, _text}, state) do
    Store.count_if_running(state.gateway, {:clients, :websocket, :text})
    {[{:close, 1003, "frames are binary messages"}], state}
  end

  def websocket_handle(_ping_or_pong, state), do: {[], state}

  @impl :cowboy_websocket
  def websocket_info({:forward, frames, class}, state) do
    # Messages queue here while a write waits; all of them are sorted by importance before the next write.
    state.pipe |> Connection.queue(frames, class) |> gather() |> write(state)
  end

  def websocket_info(:write, state), do: write(state.pipe, state)

  def websocket_info(:ping, state) do
    ping()
    {[:ping], state}
  end

  def websocket_info({:fleet, {:notice, :api_keys}, name}, %{requester: %{name: name}} = state),
    do: {[{:close, 1008, "the key was revoked"}], state}

  def websocket_info(:disconnect, state), do: {[{:close, 1001, "removed by the operator"}], state}
  def websocket_info(_stray, state), do: {[], state}

  defp gather(pipe) do
    receive do
      {:forward, frames, class} -> pipe |> Connection.queue(frames, class) |> gather()
    after
      0 -> pipe
    end
  end

  defp write(pipe, state) do
    {frames, pipe} = Connection.take(pipe)
    if Connection.waiting?(pipe), do: send(self(), :write)
    {Enum.map(frames, &{:binary, &1}), %{state | pipe: pipe}}
  end

  defp ping, do: Process.send_after(self(), :ping, @ping_ms)
end
