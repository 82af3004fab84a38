defmodule Aerie.Link.Clients.Boot do
  @moduledoc """
  Starts the clients that there are to be: those of the configuration when the gateway starts, and after a restart of the
  router those that ran before it (the store remembers them).

  When the configuration says nothing of clients there is one, so that a ground station has something to connect to: TCP
  on 127.0.0.1, port #{5790} or the first free one of the nine after it. Not 5760, the port of other routers: a simulated ArduPilot
  on the same machine takes that one, and does not start without it.
  """
  use GenServer, restart: :transient

  alias Aerie.Store
  alias Aerie.Successor
  alias Aerie.Names
  alias Aerie.Link.Clients
  alias Aerie.Link.Clients.Settings

  require Logger

  @booted {:clients, :booted}
  @ports 5790..5799

  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    name = Names.via(Keyword.fetch!(options, :gateway), :client_boot)
    Successor.start(fn -> GenServer.start_link(__MODULE__, options, name: name) end)
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:client_boot, gateway})

    for spec <- specs(gateway, Keyword.get(options, :config)) do
      with {:error, words} <- Clients.start(gateway, spec), do: Logger.error("client #{spec.id}: #{words}")
    end

    _times = if Store.counter(gateway, @booted) == 0, do: Store.count(gateway, @booted)
    :ignore
  end

  defp specs(gateway, config) do
    if Store.counter(gateway, @booted) == 0,
      do: config |> configured() |> Enum.flat_map(&spec(Map.put(&1, :network, Map.get(config, :network)))),
      else: for({{:client, _id}, spec} <- Store.remembered(gateway), do: spec)
  end

  defp configured(%{clients: :default} = config), do: default(config)

  defp configured(%{clients: clients}) when is_list(clients),
    do: Enum.reject(clients, &(&1[:enabled] == false))

  defp configured(_none), do: []

  defp spec(client) do
    case Settings.client(client) do
      {:ok, spec} ->
        [spec]

      {:error, words} ->
        Logger.error(words)
        []
    end
  end

  defp default(config) do
    used = for %{spec: %{port: port}} <- Map.get(config, :links, []), do: port

    case Enum.find(@ports, &(&1 not in used and free?(&1))) do
      nil ->
        []

      port ->
        [%{id: "gcs-tcp", url: "tcpin:127.0.0.1:#{port}"}]
    end
  end

  defp free?(port) do
    case :gen_tcp.listen(port, ip: {127, 0, 0, 1}, reuseaddr: true) do
      {:ok, socket} -> :gen_tcp.close(socket) == :ok
      {:error, _taken} -> false
    end
  end
end
