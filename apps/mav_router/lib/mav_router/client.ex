defmodule MavRouter.Client do
  @moduledoc """
  Clients: ground stations, scripts and pages that use the gateway's vehicles. Everybody who adds, lists or removes them at
  run time does it here.

      {:ok, "field"} = MavRouter.Client.add(:default, "udpout:192.168.1.20:14550", id: "field")
      {:ok, _id} = MavRouter.Client.add(:default, "tcpin:0.0.0.0:5760", role: :read_only)
      MavRouter.Client.list(:default)
      :ok = MavRouter.Client.remove(:default, "field")

  Endpoints over UDP, TCP and serial lines can be added (`MavRouter.Client.Clients`). Unix sockets
  (`Aerie.Base.UnixSocket`) and WebSockets (`FleetWeb.WebSocket`) are configured; each of their connections is a client
  that can be listed and removed. All of them are endpoints of `MavRouter.Router`, with its rules.
  """

  alias Aerie.Base.Error
  alias MavRouter.Client.Clients
  alias MavRouter.Client.Settings
  alias MavRouter.Link.FirstAttempt
  alias Aerie.Base.Names
  alias MavRouter.Router
  alias Aerie.Base.Store

  @processes [:websocket_client, :unix_client]

  @doc """
  Adds an endpoint for clients and starts it; gives its id. It lives until `remove/2` or the end of the gateway.

  The options are the keys of the configuration's `clients` (`MavRouter.Client.Settings.client/1`), such as `:id`,
  `:networks` and `:role`; a map of them with the `:url` does as well. A server that cannot listen is not added: the error
  says who has its port.
  """
  @spec add(Names.gateway(), url :: String.t(), keyword) :: {:ok, id :: String.t()} | {:error, Error.t()}
  def add(gateway, url, options) when is_binary(url), do: add(gateway, Map.new([url: url] ++ options))

  @doc "See `add/3`."
  @spec add(Names.gateway(), String.t() | map) :: {:ok, id :: String.t()} | {:error, Error.t()}
  def add(gateway, url) when is_binary(url), do: add(gateway, %{url: url})

  def add(gateway, client) when is_map(client) do
    with :ok <- Settings.known(client),
         {:ok, spec} <- client |> Map.put(:network, Clients.network(gateway)) |> Settings.client(),
         :ok <-
           if(client[:from] == :remote,
             do: Router.known_networks(gateway, client[:networks] || []),
             else: :ok
           ),
         :ok <- FirstAttempt.start(spec, &Clients.start(gateway, spec, notify: &1)) do
      {:ok, spec.id}
    else
      {:error, %Error{} = error} ->
        {:error, error}

      {:error, text} ->
        Error.new({:invalid, text})

      {:failed, id, text} ->
        Clients.stop(gateway, id)
        Error.new({:invalid, text})
    end
  end

  @doc """
  Removes an endpoint for clients with all that use it, or ends the connection of one client (its id as in `list/1`).
  """
  @spec remove(Names.gateway(), String.t()) :: :ok | {:error, Error.t()}
  def remove(gateway, id) do
    pid = Enum.find_value(@processes, &Names.whereis(gateway, &1, id))

    cond do
      Clients.link(gateway, id) != nil -> Clients.stop(gateway, id)
      pid != nil -> disconnect(pid)
      Store.link(gateway, id) != nil -> Error.new({:conflict, "this is a link to vehicles"})
      true -> Error.new({:unknown, :client, id})
    end
  end

  defp disconnect(pid) do
    send(pid, :disconnect)
    :ok
  end

  @doc """
  The endpoints for clients in the order of their ids, as snapshots of links (`MavRouter.Link.Core.Snapshot`) without peers and
  sources.
  """
  @spec endpoints(Names.gateway()) :: [map]
  def endpoints(gateway), do: Clients.list(gateway)

  @doc "All clients that are connected or were heard, however they came in, as `MavRouter.Router.endpoints/1` has them."
  @spec list(Names.gateway()) :: [map]
  def list(gateway), do: gateway |> Router.endpoints() |> Enum.filter(&(&1.side == :client))
end
