defmodule MavRouter.Link.Transport.Msp.Share do
  @moduledoc """
  The TCP port at which programs that speak MSP (configurators) share a vehicle: option `share` of an MSP link. The session in the link's process
  checks their requests (`Msp.Session.Clients`); what changes something is judged by the policy as a client of the name `LINK-share`.

  A connection that begins as HTTP is a WebSocket, whose binary messages are the same bytes. Any page in a browser of this machine can open one, so only the page of
  `share_origin` may; programs name none.
  """

  alias Aerie.Base.Net.Address
  alias Aerie.Base.Net.WebSocket.{Frames, Handshake}
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Transport.TcpServer
  alias MavRouter.Endpoints.Access
  alias MavRouter.Tables
  alias MavRouter.Forward.Table.Path

  @http ~r/\A[A-Z]{1,8}( |\z)/
  @station {255, 190}

  @enforce_keys [:conn, :spec]
  defstruct [:conn, :spec, texts: %{}, streams: %{}]

  @typedoc "By program: its address, and what its connection is so far."
  @type t :: %__MODULE__{
          conn: struct,
          spec: Spec.t(),
          texts: %{pos_integer => String.t()},
          streams: %{pos_integer => :new | :msp | {:http, binary} | {:websocket, Frames.t()}}
        }
  @type event :: {:client, pos_integer, :up | :down | binary}

  @doc "The name that the programs at a link's port have as a client."
  @spec client(link :: String.t()) :: String.t()
  def client(link), do: link <> "-share"

  @doc "Opens the port of a link; nil if it has none. What went wrong is words: the vehicle's line works without it."
  @spec open(Spec.t()) :: {:ok, t | nil} | {:error, String.t()}
  def open(%{share: nil}), do: {:ok, nil}

  def open(%{share: {host, port}} = spec) do
    case TcpServer.open(%{host: host, port: port}) do
      {:ok, conn} ->
        {:ok, %__MODULE__{conn: conn, spec: spec}}

      {:error, reason} ->
        {:error,
         "programs cannot share the vehicle at #{Address.format(host, port)}: #{:inet.format_error(reason)}"}
    end
  end

  @doc "Hands it to the link's process."
  @spec give(t | nil, pid) :: :ok | {:error, term}
  def give(nil, _link), do: :ok
  def give(share, link), do: TcpServer.give(share.conn, link)

  @doc "Begins to accept; with the port."
  @spec activate(t | nil) :: {t | nil, String.t() | nil}
  def activate(nil), do: {nil, nil}

  def activate(share) do
    {:ok, conn, info} = TcpServer.activate(share.conn)
    {%{share | conn: conn}, info.local}
  end

  @doc "A message of the link's mailbox, if it is this port's."
  @spec handle(t | nil, term) :: {[event], t} | :unknown
  def handle(nil, _message), do: :unknown

  def handle(share, message) do
    with {events, conn} <- TcpServer.handle(share.conn, message) do
      {all, share} = Enum.map_reduce(events, %{share | conn: conn}, &event/2)
      {List.flatten(all), share}
    end
  end

  defp event({:peer_up, id, text}, share),
    do:
      {[{:client, id, :up}],
       %{share | texts: Map.put(share.texts, id, text), streams: Map.put(share.streams, id, :new)}}

  defp event({:peer_down, id, _reason}, share), do: {[{:client, id, :down}], forget(share, id)}

  defp event({:read, reads}, share) do
    Enum.map_reduce(reads, share, fn {id, bytes}, share -> read(share.streams[id], id, bytes, share) end)
  end

  # Beyond its limits, or the acceptor has ended with the link.
  defp event(_other, share), do: {[], share}

  # The connection was dropped.
  defp read(nil, _id, _bytes, share), do: {[], share}

  defp read(:new, id, bytes, share) do
    if Regex.match?(@http, bytes),
      do: read({:http, ""}, id, bytes, share),
      else: read(:msp, id, bytes, put_in(share.streams[id], :msp))
  end

  defp read(:msp, id, bytes, share), do: {[{:client, id, bytes}], share}

  defp read({:http, before}, id, bytes, share) do
    case Handshake.accept(before <> bytes) do
      :more ->
        {[], put_in(share.streams[id], {:http, before <> bytes})}

      {:ok, %{origin: origin}, _rest} when origin != nil and origin != share.spec.share_origin ->
        refuse(
          share,
          id,
          Handshake.refused("403 Forbidden", "pages of #{printable(origin)} may not: see share_origin")
        )

      {:ok, request, rest} ->
        {events, share} = send_raw(share, id, Handshake.accepted(request))
        frames = Frames.new(:client)

        if events == [],
          do: read({:websocket, frames}, id, rest, put_in(share.streams[id], {:websocket, frames})),
          else: {events, share}

      {:error, answer} ->
        refuse(share, id, answer)
    end
  end

  defp read({:websocket, frames}, id, bytes, share) do
    {events, frames} = Frames.push(frames, bytes)
    share = put_in(share.streams[id], {:websocket, frames})
    Enum.flat_map_reduce(events, share, &message(&1, id, &2))
  end

  defp message({:data, bytes}, id, share), do: {[{:client, id, bytes}], share}
  defp message({:ping, payload}, id, share), do: send_raw(share, id, Frames.answer({:pong, payload}))
  defp message(:pong, _id, share), do: {[], share}
  defp message(_close_or_bad, id, share), do: {[{:client, id, :down}], drop(share, id)}

  defp refuse(share, id, answer) do
    {_events, share} = send_raw(share, id, answer)
    {[{:client, id, :down}], drop(share, id)}
  end

  defp printable(text), do: text |> String.slice(0, 100) |> String.replace(~r/[^ -~]/, "?")

  @doc "Closes the connection of a program."
  @spec drop(t, pos_integer) :: t
  def drop(share, id), do: forget(%{share | conn: TcpServer.drop(share.conn, id)}, id)

  defp forget(share, id),
    do: %{share | texts: Map.delete(share.texts, id), streams: Map.delete(share.streams, id)}

  @doc "Bytes to a program. One that does not read them is dropped."
  @spec write(t | nil, pos_integer, binary) :: {[event], t | nil}
  def write(nil, _id, _bytes), do: {[], nil}

  def write(share, id, bytes) do
    case share.streams[id] do
      nil -> {[], share}
      {:websocket, _frames} -> send_raw(share, id, Frames.reply(bytes))
      _plain -> send_raw(share, id, bytes)
    end
  end

  defp send_raw(share, id, bytes) do
    case TcpServer.write(share.conn, id, bytes) do
      {:ok, conn} -> {[], %{share | conn: conn}}
      _full_or_gone -> {[{:client, id, :down}], drop(share, id)}
    end
  end

  @doc "Whether the policy lets a program do what a MAVLink message would ask for."
  @spec allowed?(t | nil, pos_integer, struct) :: boolean
  def allowed?(nil, _id, _message), do: false

  def allowed?(%{spec: %{gateway: gateway, network: network} = spec, texts: texts}, id, message) do
    path = %Path{
      key: {client(spec.id), id},
      owner: client(spec.id),
      side: :client,
      networks: [network],
      commands: true,
      local: Access.loopback?(texts[id]),
      text: texts[id],
      gateway: gateway
    }

    {system, component} = @station
    bytes = MavCodec.encode(message, system: system, component: component)
    {[frame], _parser} = MavCodec.Parser.push(MavCodec.Parser.new(), bytes, 0)

    case Tables.of(gateway).policy do
      nil ->
        path.local

      policy ->
        sender = %{
          endpoint: path.key,
          owner: path.owner,
          peer: path.text,
          principal: policy.principal(gateway, path)
        }

        policy.decide(gateway, sender, {network, message.target_system}, frame) == :forward
    end
  end

  @doc "Closes the port and its connections."
  @spec close(t | nil) :: :ok
  def close(nil), do: :ok
  def close(share), do: TcpServer.close(share.conn)
end
