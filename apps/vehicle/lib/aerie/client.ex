defmodule Aerie.Client do
  @moduledoc """
  Clients: ground stations, scripts and pages that use the gateway's vehicles.

      {:ok, "field"} = Aerie.Client.add(:default, "udpout:192.168.1.20:14550", id: "field")
      {:ok, _id} = Aerie.Client.add(:default, "tcpin:0.0.0.0:5760", access: :read)
      Aerie.Client.list(:default)
      :ok = Aerie.Client.remove(:default, "field")

  Endpoints for clients over UDP, TCP and serial lines are `Aerie.Link.Clients`. Unix sockets
  (`Aerie.Client.Supervisor`) and WebSockets (`FleetWeb.WebSocket`) are further ways in. All of them are endpoints of
  `Aerie.Router`, with its rules; this module is what they have in common for who adds, lists and removes them.
  """

  alias Aerie.Store
  alias Aerie.Names
  alias Aerie.Router

  @options [:id, :networks, :access]
  @processes [:websocket_client, :unix_client]

  @typedoc """
  - `id`: its name, the connection string when absent
  - `networks`: whose vehicles it sees, of first importance first; all when absent, those that are added later too
  - `access`: `:full`, or `:read` for one that nothing is taken from
  """
  @type option :: {:id, String.t()} | {:networks, [String.t()]} | {:access, :full | :read}

  @doc """
  Adds an endpoint for clients, as `Aerie.Link.Clients.add/2`. It lives until `remove/2` or the end of the gateway. The
  error is words.
  """
  @spec add(Names.gateway(), String.t(), [option()]) :: {:ok, String.t()} | {:error, String.t()}
  def add(gateway, url, options \\ []) do
    options = Keyword.validate!(options, @options)

    Aerie.Link.Clients.add(gateway, %{
      url: url,
      id: options[:id],
      networks: options[:networks],
      network: own_network(gateway),
      role: if(options[:access] == :read, do: :read_only, else: :full)
    })
  end

  defp own_network(gateway) do
    with %{network: network} <- Aerie.RunningConfig.of(gateway), do: network, else: (_none -> nil)
  end

  @doc """
  Removes an endpoint for clients with all that use it, or ends the connection of one client (its id as in `list/1`).
  """
  @spec remove(Names.gateway(), String.t()) :: :ok | {:error, :unknown | :for_vehicles}
  def remove(gateway, id) do
    pid = Enum.find_value(@processes, &Names.whereis(gateway, &1, id))

    cond do
      Enum.any?(endpoints(gateway), &(&1.id == id)) -> Aerie.Link.Clients.remove(gateway, id)
      pid != nil -> disconnect(pid)
      Store.link(gateway, id) != nil -> {:error, :for_vehicles}
      true -> {:error, :unknown}
    end
  end

  defp disconnect(pid) do
    send(pid, :disconnect)
    :ok
  end

  @doc "The endpoints for clients, as snapshots of their links."
  @spec endpoints(Names.gateway()) :: [map()]
  def endpoints(gateway), do: Aerie.Link.Clients.list(gateway)

  @doc "All clients that are connected or were heard, on whichever way, as `Aerie.Router.endpoints/1` has them."
  @spec list(Names.gateway()) :: [map()]
  def list(gateway), do: gateway |> Router.endpoints() |> Enum.filter(&(&1.side == :client))
end
