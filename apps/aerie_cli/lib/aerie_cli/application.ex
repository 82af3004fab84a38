defmodule AerieCLI.Application do
  @moduledoc false
  use Application

  # `AerieCLI.Run` starts the parts of a run below this supervisor, so that an orderly end of the VM (SIGTERM) stops them
  # in reverse order.
  @impl Application
  def start(_type, _args) do
    Supervisor.start_link([], strategy: :one_for_one, name: AerieCLI.Supervisor)
  end
end
