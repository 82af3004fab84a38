defmodule MavRouter.Client.Supervisor do
  @moduledoc "The client endpoints of a gateway: their trees, and the process that starts them."
  use Supervisor

  alias Aerie.Base.Names
  alias MavRouter.Client.Boot
  alias MavRouter.Client.Settings

  @doc "Options: `:gateway`, `:settings` (`MavRouter.Client.Settings`)."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options), do: Supervisor.start_link(__MODULE__, options)

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    %Settings{} = settings = Keyword.fetch!(options, :settings)
    Process.set_label({:client_endpoints, gateway})

    children = [
      {DynamicSupervisor,
       name: Names.via(gateway, :client_trees),
       max_children: settings.max_clients,
       max_restarts: 100,
       max_seconds: 1},
      {Boot, gateway: gateway, settings: settings}
    ]

    Supervisor.init(children, strategy: :rest_for_one, max_restarts: 10, max_seconds: 10)
  end
end
