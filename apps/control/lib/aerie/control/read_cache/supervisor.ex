defmodule Aerie.Control.ReadCache.Supervisor do
  @moduledoc "Supervises a process for each vehicle that is heard (`Aerie.Control.ReadCache.Vehicle`). After a restart the vehicles are read again."
  use Supervisor

  alias Aerie.Base.Names
  alias Aerie.Control.ReadCache.Starter

  @spec start_link(keyword()) :: Supervisor.on_start()
  def start_link(options),
    do: Supervisor.start_link(__MODULE__, options, name: Names.via(options[:gateway], :read_cache_supervisor))

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:read_cache_supervisor, gateway})

    Supervisor.init(
      [
        {DynamicSupervisor,
         name: Names.via(gateway, :read_cache_vehicles), max_restarts: 20, max_seconds: 10},
        {Starter, gateway: gateway}
      ],
      strategy: :one_for_all,
      max_restarts: 5,
      max_seconds: 30
    )
  end
end
