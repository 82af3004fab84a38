defmodule MavRouter.Client.Boot do
  @ports 5790..5799

  @moduledoc """
  Starts the clients: those of the configuration when the gateway starts, and after a restart of the router those that ran
  before it (the store remembers them).

  Without `clients` in the configuration it starts one, so that a ground station has something to connect to: TCP on
  127.0.0.1, port #{@ports.first} or the first free one of the nine after it. Not 5760, the usual port of routers: a simulated
  ArduPilot on the same machine needs that one to start.
  """
  use GenServer, restart: :transient

  alias Aerie.Base.Store
  alias MavRouter.Client
  alias MavRouter.Client.Settings

  require Logger

  @booted {:clients, :booted}
  @default "gcs-tcp"

  @doc "The id of the client that is started without `clients` in the configuration."
  @spec default_id() :: String.t()
  def default_id, do: @default

  @doc "Options: `:gateway`, `:settings` (`MavRouter.Client.Settings`)."
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, options)

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:client_boot, gateway})

    for spec <- specs(gateway, Keyword.fetch!(options, :settings)) do
      with {:error, error} <- Client.start(gateway, spec),
           do: Logger.error("client #{spec.id}: #{Exception.message(error)}")
    end

    _times = if Store.counter(gateway, @booted) == 0, do: Store.count(gateway, @booted)
    :ignore
  end

  defp specs(gateway, settings) do
    network = settings.link.identity.network

    if Store.counter(gateway, @booted) == 0,
      do: settings |> configured() |> Enum.flat_map(&spec(Map.put(&1, :network, network))),
      else: for({{:client, _id}, spec} <- Store.remembered(gateway), do: spec)
  end

  defp configured(%Settings{clients: :default} = settings), do: default(settings.link.links)
  defp configured(%Settings{clients: clients}), do: Enum.reject(clients, &(&1[:enabled] == false))

  defp spec(client) do
    case Settings.client(client) do
      {:ok, spec} ->
        [spec]

      {:error, words} ->
        Logger.error(words)
        []
    end
  end

  defp default(links) do
    used = for %{spec: %{port: port}} <- links, do: port

    case Enum.find(@ports, &(&1 not in used and free?(&1))) do
      nil ->
        []

      port ->
        [%{id: @default, url: "tcpin:127.0.0.1:#{port}"}]
    end
  end

  defp free?(port) do
    case :gen_tcp.listen(port, ip: {127, 0, 0, 1}, reuseaddr: true) do
      {:ok, socket} -> :gen_tcp.close(socket) == :ok
      {:error, _taken} -> false
    end
  end
end
