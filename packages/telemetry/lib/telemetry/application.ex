defmodule Telemetry.Application do
  @moduledoc false

  use Application

  @impl Application
  def start(_type, _args) do
    Supervisor.start_link([Telemetry.HandlerTable], strategy: :one_for_one, name: Telemetry.Supervisor)
  end
end
