defmodule MavRouter.Client.Clients do
  @moduledoc """
  Client endpoints over UDP and TCP: ground stations and other programs that see vehicles through this gateway.

  Each is a link (`MavRouter.Link.Tree`: back-off, names looked up again, a peer for each sender or connection, bounded writes)
  on the other side of the router. A client that dies, hangs or does not read does not affect links and other clients.

  | url | |
  |---|---|
  | `udpin:HOST:PORT` | every sender is an endpoint of its own, forgotten after 60 s of silence |
  | `udpout:HOST:PORT` | sends there; when that host answers from another port, to that port |
  | `udpbcast:ADDRESS:PORT` | broadcasts until somebody answers, then sends only to that address |
  | `tcpin:HOST:PORT` | every connection is an endpoint of its own |
  | `tcp:HOST:PORT` | connects to a ground station that listens |
  | `DEVICE,BAUD` | a serial line with a ground station at its other end |

  `MavRouter.Client` adds and removes them at run time. `Aerie.Base.Store` remembers that, so that a restart of the router brings
  back exactly the clients that existed.
  """

  alias Aerie.Base.Error
  alias MavRouter.Identity
  alias Aerie.Base.Store
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Tree
  alias Aerie.Base.Names
  alias MavRouter.Endpoints
  alias MavRouter.Tables

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

  @doc "Ends a client and forgets it. An unknown id is fine."
  @spec stop(Names.gateway(), String.t()) :: :ok
  def stop(gateway, id) do
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

  @doc "The gateway's own network, to which clients belong that name none."
  @spec network(Names.gateway()) :: String.t()
  def network(gateway) do
    default = Identity.default_network()

    with %{} = tables <- Tables.of(gateway),
         do: Tables.setting(tables, :network, default),
         else: (_not_running -> default)
  end

  @doc "The snapshots of all clients, see `MavRouter.Client.endpoints/1`."
  @spec list(Names.gateway()) :: [map]
  def list(gateway) do
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
