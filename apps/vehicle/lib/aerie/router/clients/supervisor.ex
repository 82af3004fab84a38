defmodule Aerie.Router.Clients.Supervisor do
  @moduledoc "The client endpoints of a gateway: their trees, and what starts those that there are to be."
  use Supervisor

  alias Aerie.Names
  alias Aerie.Router.Clients.Boot

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
      {DynamicSupervisor,
       name: Names.via(gateway, :client_trees), max_children: max(config), max_restarts: 100, max_seconds: 1},
      {Boot, gateway: gateway, config: config}
    ]

    Supervisor.init(children, strategy: :rest_for_one, max_restarts: 10, max_seconds: 10)
  end

  defp max(%{limits: %{max_clients: max}}), do: max
  defp max(_none), do: @default_max
end
