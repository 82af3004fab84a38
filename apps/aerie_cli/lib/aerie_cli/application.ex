defmodule AerieCLI.Application do
  @moduledoc false
  use Application

  # The gateway and what belongs to one run of it are started below this supervisor by `AerieCLI.Run`, so that an orderly
  # end of the VM (SIGTERM) stops them in the reverse order of their start.
  @impl Application
  def start(_type, _args) do
    Supervisor.start_link([], strategy: :one_for_one, name: AerieCLI.Supervisor)
  end
end
