defmodule Telemetry.Application do
  @moduledoc false

  use Application
  use Supervisor

  @impl Application
  def start(_type, _args), do: Supervisor.start_link(__MODULE__, nil)

  # The table belongs to the supervisor, so that the handlers survive the process that changes it.
  @impl Supervisor
  def init(nil) do
    :ok = Telemetry.HandlerTable.create()
    Supervisor.init([Telemetry.HandlerTable], strategy: :one_for_one, max_restarts: 100, max_seconds: 10)
  end
end
