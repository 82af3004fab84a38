defmodule MavRouter.Link.Transport.Msp.Share do
  @moduledoc """
  The TCP port at which programs that speak MSP (configurators) share a vehicle: option `share` of an MSP link. The session in the link's process
  checks their requests (`Msp.Session.Clients`); what changes something is judged by the policy as a client of the name `LINK-share`.

  A browser can be made to send anything to a port of its own machine, but begins as HTTP: such a connection is closed.
  """

  alias Aerie.Base.Address
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Transport.TcpServer
  alias MavRouter.Router.{Access, Tables}
  alias MavRouter.Router.Forward.Table.Path

  @http ~r/\A[A-Z]{3,8} \S/
  @station {255, 190}

  @enforce_keys [:conn, :spec]
  defstruct [:conn, :spec, texts: %{}]

  @type t :: %__MODULE__{conn: struct, spec: Spec.t(), texts: %{pos_integer => String.t()}}
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
        {:error, "programs cannot share the vehicle at #{Address.format(host, port)}: #{words(reason)}"}
    end
  end

  defp words(reason) when is_atom(reason), do: :inet.format_error(reason)
  defp words(reason), do: inspect(reason, limit: 10)

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

  defp event({:peer_up, id, text}, share), do: {[{:client, id, :up}], put_in(share.texts[id], text)}

  defp event({:peer_down, id, _reason}, share),
    do: {[{:client, id, :down}], %{share | texts: Map.delete(share.texts, id)}}

  defp event({:read, reads}, share) do
    Enum.map_reduce(reads, share, fn {id, bytes}, share ->
      if Regex.match?(@http, bytes),
        do: {[{:client, id, :down}], drop(share, id)},
        else: {[{:client, id, bytes}], share}
    end)
  end

  # Beyond its limits, or the acceptor has ended with the link.
  defp event(_other, share), do: {[], share}

  defp drop(share, id),
    do: %{share | conn: TcpServer.drop(share.conn, id), texts: Map.delete(share.texts, id)}

  @doc "Bytes to a program. One that does not read them is dropped."
  @spec write(t | nil, pos_integer, binary) :: {[event], t | nil}
  def write(nil, _id, _bytes), do: {[], nil}

  def write(share, id, bytes) do
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
