defmodule Aerie.Link.Clients do
  @moduledoc """
  Client endpoints over UDP and TCP: ground stations and other programs that see vehicles through this gateway.

  Each is the same machinery as a link (`Aerie.Link.Tree`: reconnects with a back-off, names looked up again, a peer for
  each sender or connection, bounded writes), on the other side of the router. A client that dies, hangs or does not read
  costs no link and no other client anything.

  | url | |
  |---|---|
  | `udpin:HOST:PORT` | every sender is an endpoint of its own, forgotten after 60 s of silence |
  | `udpout:HOST:PORT` | sends there; once somebody of that host answers, to where the answer came from |
  | `udpbcast:ADDRESS:PORT` | sends to everyone until one answers, then to that one |
  | `tcpin:HOST:PORT` | every connection is an endpoint of its own |
  | `tcp:HOST:PORT` | connects to a ground station that listens |
  | `DEVICE,BAUD` | a serial line with a ground station at its other end |

  What was added and removed at run time is remembered by `Aerie.Store`, so that a restart of the router brings back
  exactly the clients that there were.
  """

  alias Aerie.Store
  alias Aerie.Link.Clients.Settings
  alias Aerie.Link.Spec
  alias Aerie.Successor
  alias Aerie.Link.Tree
  alias Aerie.Names
  alias Aerie.Router.Endpoints
  alias Aerie.Router.Tables

  @first_ms 5_000
  @waited_for [:udp_server, :tcp_server]

  @doc """
  Adds a client and starts it; gives its id. A server whose port is taken is not added: the error says who has it.

  `client` is a connection string, or a map with the keys of the configuration's `clients` (atoms).
  """
  @spec add(Names.gateway(), String.t() | map) :: {:ok, String.t()} | {:error, String.t()}
  def add(gateway, url) when is_binary(url), do: add(gateway, %{url: url})

  def add(gateway, client) when is_map(client) do
    with {:ok, spec} <- Settings.client(client), :ok <- vacant(gateway, spec.id) do
      notify = :erlang.alias()

      try do
        case start(gateway, spec, notify: notify) do
          :ok -> first(gateway, spec, notify)
          {:error, words} -> {:error, words}
        end
      after
        :erlang.unalias(notify)
      end
    end
  end

  # `start/3` takes the place of one that is on its way out; one that runs is nobody's to replace.
  defp vacant(gateway, id) do
    if link(gateway, id), do: {:error, "there is a client #{id} already"}, else: :ok
  end

  defp first(gateway, %Spec{kind: kind} = spec, notify) when kind in @waited_for do
    receive do
      {^notify, {:error, words}} ->
        remove(gateway, spec.id)
        {:error, words}

      {^notify, :ok} ->
        {:ok, spec.id}
    after
      @first_ms -> {:ok, spec.id}
    end
  end

  defp first(_gateway, spec, _notify), do: {:ok, spec.id}

  @doc "Starts the client that a specification says, and remembers it."
  @spec start(Names.gateway(), Spec.t(), keyword) :: :ok | {:error, String.t()}
  def start(gateway, %Spec{} = spec, options \\ []) do
    child = {Tree, [gateway: gateway, spec: spec, home: __MODULE__] ++ options}
    start = fn -> DynamicSupervisor.start_child(Names.via(gateway, :client_trees), child) end

    if Store.link(gateway, spec.id) do
      {:error, "there is a link #{spec.id} already"}
    else
      case Successor.start(start) do
        {:ok, _tree} -> Store.remember(gateway, {:client, spec.id}, spec)
        {:error, {:already_started, _tree}} -> {:error, "there is a client #{spec.id} already"}
        {:error, :max_children} -> {:error, "there are as many clients as limits.max_clients allows"}
        {:error, reason} -> {:error, "client #{spec.id} does not start: #{inspect(reason)}"}
      end
    end
  catch
    :exit, _reason -> {:error, "the gateway is not running"}
  end

  @doc "Ends a client and forgets it. An unknown one is fine."
  @spec remove(Names.gateway(), String.t()) :: :ok
  def remove(gateway, id) do
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

  @doc "The snapshots of all clients, as those of links (`Aerie.Link.Snapshot`) without peers and sources, in the order of their ids."
  @spec list(Names.gateway()) :: [map]
  def list(gateway) do
    case Tables.of(gateway) do
      nil -> []
      tables -> tables.clients |> :ets.tab2list() |> Enum.sort() |> Enum.map(&elem(&1, 1))
    end
  rescue
    # The tables go with the router's process; its successor has others.
    ArgumentError -> []
  end

  ## For the client's process, as `Aerie.Store` for a link's

  @doc false
  @spec link(Names.gateway(), String.t()) :: map | nil
  def link(gateway, id) do
    with tables when is_map(tables) <- Tables.of(gateway), do: :ets.lookup_element(tables.clients, id, 2, nil)
  end

  @doc false
  @spec put_link(Names.gateway(), String.t(), map, Store.Links.changes()) :: :ok
  # What a client's peers say is shown as its endpoints'.
  def put_link(gateway, id, snapshot, _of_peers) do
    with tables when is_map(tables) <- Tables.of(gateway), do: :ets.insert(tables.clients, {id, snapshot})
    :ok
  end
end
