defmodule Aerie.Link.Clients.Supervisor do
  @moduledoc "The client endpoints of a gateway: their trees, and what starts those that there are to be."
  use Supervisor

  alias Aerie.Successor
  alias Aerie.Names
  alias Aerie.Link.Clients.Boot

  @default_max 64

  @doc "Options: `:gateway`, `:config`."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options), do: Supervisor.start_link(__MODULE__, options)

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    config = Keyword.get(options, :config)
    Process.set_label({:client_endpoints, gateway})

    children = [
      %{id: DynamicSupervisor, start: {__MODULE__, :start_trees, [gateway, max(config)]}, type: :supervisor},
      {Boot, gateway: gateway, config: config}
    ]

    Supervisor.init(children, strategy: :rest_for_one, max_restarts: 10, max_seconds: 10)
  end

  @doc false
  @spec start_trees(Names.gateway(), pos_integer) :: Supervisor.on_start()
  def start_trees(gateway, max) do
    options = [name: Names.via(gateway, :client_trees), strategy: :one_for_one]
    limits = [max_children: max, max_restarts: 100, max_seconds: 1]
    Successor.start(fn -> DynamicSupervisor.start_link(options ++ limits) end)
  end

  defp max(%{limits: %{max_clients: max}}), do: max
  defp max(_none), do: @default_max
end
