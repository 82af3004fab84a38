defmodule MavRouter.Client do
  @moduledoc """
  Clients: ground stations, scripts and pages that use the gateway's vehicles. Everybody who adds, lists or removes them at
  run time does it here.

      {:ok, "field"} = MavRouter.Client.add(:default, "udpout:192.168.1.20:14550", id: "field")
      {:ok, _id} = MavRouter.Client.add(:default, "tcpin:0.0.0.0:5760", role: :read_only)
      MavRouter.Client.list(:default)
      :ok = MavRouter.Client.remove(:default, "field")

  UDP, TCP and serial lines are added as links on the other side of the router (`MavRouter.Link.Tree`: back-off,
  names looked up again, a peer for each sender or connection, bounded writes). One that dies, hangs or does not
  read does not affect links and other clients. `Aerie.Base.Store` remembers them, so that a restart of the router
  brings back exactly those that existed.

  | url | |
  |---|---|
  | `udpin:HOST:PORT` | every sender is an endpoint of its own, forgotten after 60 s of silence |
  | `udpout:HOST:PORT` | sends there; when that host answers from another port, to that port |
  | `udpbcast:ADDRESS:PORT` | broadcasts until somebody answers, then sends only to that address |
  | `tcpin:HOST:PORT` | every connection is an endpoint of its own |
  | `tcp:HOST:PORT` | connects to a ground station that listens |
  | `DEVICE,BAUD` | a serial line with a ground station at its other end |

  Unix sockets (`Aerie.Base.Net.UnixSocket`) and WebSockets (`Aerie.Api.WebSocket`) are configured; each of their
  connections is a client that can be listed and removed. All of them are endpoints of `MavRouter.Router`, with its
  rules.
  """

  alias Aerie.Base.Error
  alias MavRouter.Client.Settings
  alias MavRouter.Endpoints
  alias MavRouter.Identity
  alias MavRouter.Link.FirstAttempt
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Tree
  alias Aerie.Base.Names
  alias MavRouter.Router
  alias MavRouter.Tables
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
         {:ok, spec} <- client |> Map.put(:network, network(gateway)) |> Settings.client(),
         :ok <-
           if(client[:from] == :remote,
             do: Router.known_networks(gateway, client[:networks] || []),
             else: :ok
           ),
         :ok <- FirstAttempt.start(spec, &start(gateway, spec, notify: &1)) do
      {:ok, spec.id}
    else
      {:error, %Error{} = error} ->
        {:error, error}

      {:error, text} ->
        Error.new({:invalid, text})

      {:failed, id, text} ->
        stop(gateway, id)
        Error.new({:invalid, text})
    end
  end

  # The network of clients that name none.
  defp network(gateway) do
    default = Identity.default_network()

    with %{} = tables <- Tables.of(gateway),
         do: Tables.setting(tables, :network, default),
         else: (_not_running -> default)
  end

  @doc "Starts a client and remembers it, so that a restart of the router brings it back."
  @spec start(Names.gateway(), Spec.t(), keyword) :: :ok | {:error, Error.t()}
  def start(gateway, %Spec{} = spec, options \\ []) do
    child = {Tree, [gateway: gateway, spec: spec, home: __MODULE__] ++ options}

    if Store.link(gateway, spec.id) do
      Error.new({:exists, :link, spec.id})
    else
      case DynamicSupervisor.start_child(Names.via(gateway, :client_trees), child) do
        {:ok, _tree} ->
          Store.remember(gateway, {:client, spec.id}, spec)

        {:error, {:already_started, _tree}} ->
          Error.new({:exists, :client, spec.id})

        {:error, :max_children} ->
          Error.new({:limit, "there are as many clients as limits.max_clients allows"})

        {:error, reason} ->
          Error.new({:unavailable, "client #{spec.id} does not start: #{inspect(reason)}"})
      end
    end
  catch
    :exit, _reason -> Error.new({:unavailable, "the gateway is not running"})
  end

  @doc """
  Removes an endpoint for clients with all that use it, or ends the connection of one client (its id as in `list/1`).
  """
  @spec remove(Names.gateway(), String.t()) :: :ok | {:error, Error.t()}
  def remove(gateway, id) do
    pid = Enum.find_value(@processes, &Names.whereis(gateway, &1, id))

    cond do
      link(gateway, id) != nil -> stop(gateway, id)
      pid != nil -> disconnect(pid)
      Store.link(gateway, id) != nil -> Error.new({:conflict, "this is a link to vehicles"})
      true -> Error.new({:unknown, :client, id})
    end
  end

  defp stop(gateway, id) do
    with tables when is_map(tables) <- Tables.of(gateway),
         true <- :ets.member(tables.clients, id),
         tree when is_pid(tree) <- Names.whereis(gateway, :link_tree, id) do
      Store.forget(gateway, {:client, id})
      _ = DynamicSupervisor.terminate_child(Names.via(gateway, :client_trees), tree)
      :ets.delete(tables.clients, id)
      Endpoints.close(gateway, tables, id)
    end

    :ok
  catch
    :exit, _reason -> :ok
  end

  defp disconnect(pid) do
    send(pid, :disconnect)
    :ok
  end

  @doc "How many frames for an endpoint of `endpoints/1` were dropped."
  @spec dropped(map()) :: non_neg_integer()
  def dropped(%{counters: counters}), do: Endpoints.Counters.dropped(counters)

  @doc """
  The endpoints for clients in the order of their ids, as snapshots of links (`MavRouter.Link.Core.Snapshot`) without peers and
  sources.
  """
  @spec endpoints(Names.gateway()) :: [map]
  def endpoints(gateway) do
    case Tables.of(gateway) do
      nil -> []
      tables -> tables.clients |> rows() |> Enum.sort() |> Enum.map(&elem(&1, 1))
    end
  end

  defp rows(table) do
    :ets.tab2list(table)
  rescue
    # The tables go with the router's process; its successor has others.
    ArgumentError -> []
  end

  @doc "All clients that are connected or were heard, however they came in, as `MavRouter.Router.endpoints/1` has them."
  @spec list(Names.gateway()) :: [map]
  def list(gateway), do: gateway |> Router.endpoints() |> Enum.filter(&(&1.side == :client))

  ## For the process of a client, as `Aerie.Base.Store` for that of a link

  @doc false
  @spec link(Names.gateway(), String.t()) :: map | nil
  defdelegate link(gateway, id), to: Tables, as: :client

  @doc false
  @spec put_link(Names.gateway(), String.t(), map, Store.Links.changes()) :: :ok
  # Peers are not kept: those of a client are shown as its endpoints.
  def put_link(gateway, id, snapshot, _of_peers) do
    with tables when is_map(tables) <- Tables.of(gateway), do: :ets.insert(tables.clients, {id, snapshot})
    :ok
  end
end
