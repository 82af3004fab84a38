defmodule MavRouter.Router.Supervisor do
  @moduledoc """
  Owns the router's tables (`MavRouter.Tables`) and supervises what works on them; client endpoints join it.

  The tables live as long as this supervisor. Its restart costs the learned routes, which the next frame of each component teaches
  again.
  """
  use Supervisor

  alias Aerie.Base.Names
  alias MavRouter.Router.AutoSystemId
  alias MavRouter.Router.Settings
  alias MavRouter.Tables

  @doc """
  Options: `:gateway`, `:settings` (`MavRouter.Router.Settings`); `:vehicles` (`MavRouter.Router.Vehicles`),
  `:requests` (`MavRouter.Sharing.StreamRequests`), `:policy` (`MavRouter.Router.Policy`) and `:readings`
  (`MavRouter.Sharing.ReadCache`), modules, none by default; `:turns_clock`, see `MavRouter.Sharing.TransferLock`;
  `:children`, child specifications of what is supervised beside the router's own processes.
  """
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :router))
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:router, gateway})
    %Settings{} = settings = Keyword.fetch!(options, :settings)

    _tables =
      Tables.create(
        gateway,
        values(settings, gateway),
        Keyword.take(options, [:vehicles, :requests, :policy, :readings])
      )

    children = [
      {MavRouter.Endpoints.Monitor, gateway: gateway},
      {MavRouter.Router.Starter, gateway: gateway},
      {MavRouter.Router.Sweeper, gateway: gateway},
      {MavRouter.Endpoints.Meter, gateway: gateway},
      {MavRouter.Sharing.TransferLock, gateway: gateway, clock: Keyword.get(options, :turns_clock)}
    ]

    further = Keyword.get(options, :children, [])

    # A failing child is not worth more than a few tries.
    Supervisor.init(children ++ further, strategy: :one_for_one, max_restarts: 10, max_seconds: 10)
  end

  # Frames that carry our own ids come back through a loop.
  defp values(%Settings{identity: identity} = settings, gateway) do
    AutoSystemId.settings(identity, gateway) ++
      [between_vehicles: settings.between_vehicles, network: identity.network]
  end
end
