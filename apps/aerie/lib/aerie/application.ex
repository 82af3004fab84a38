defmodule Aerie.Application do
  @moduledoc false
  use Application

  require Logger

  alias Aerie.Base.Store
  alias Aerie.Base.Names.Successor
  alias Aerie.CLI
  alias Aerie.Control.Commands
  alias Aerie.CLI.Output
  alias Aerie.CLI.Output.LogKeeper
  alias Aerie.CLI.Start.Ports

  # The application ends with its top process, and the VM with the application. So that one does nothing but restart the supervisor below
  # which everything runs.
  @impl Application
  def start(_type, _args) do
    child = %{id: CLI.Supervisor, start: {__MODULE__, :start_run, []}, type: :supervisor, shutdown: :infinity}
    Supervisor.start_link([child], strategy: :one_for_one)
  end

  # `Aerie.CLI.Start.Run` starts the parts of a run below this supervisor, so that an orderly stop of the VM (SIGTERM) ends them
  # in reverse order, the devices last.
  @doc false
  @spec start_run() :: Supervisor.on_start()
  def start_run do
    :ok = Successor.await_end_below(CLI.Supervisor)

    children = [
      {Output, fd: 1, name: Output.stdout(), lost: &count_lost/1},
      {Output, fd: 2, name: Output.stderr(), lost: &count_lost/1},
      LogKeeper,
      Ports,
      {Aerie.Processes, gateway: :default}
    ]

    with {:ok, run} <-
           Supervisor.start_link(children,
             strategy: :one_for_one,
             name: CLI.Supervisor,
             max_restarts: 10,
             max_seconds: 10
           ),
         :ok <- gateway(Application.get_env(:aerie, :start)),
         do: {:ok, run}
  end

  # The command line of the VM says whether it has a gateway: `bin/run` puts its words there, a release those after -extra.
  # Tests, benchmarks and `bin/aerie eval` have none.
  defp gateway(nil), do: :ok
  defp gateway(:plain_arguments), do: CLI.Start.main(Enum.map(:init.get_plain_arguments(), &List.to_string/1))
  defp gateway(words), do: CLI.Start.main(words)

  # Before anything is stopped, so that links still carry the vehicles' answers.
  @impl Application
  def prep_stop(state) do
    left = Commands.drain(:default)

    if left != [],
      do: Logger.warning("ended with commands under way, whose results are unknown: #{Enum.join(left, ", ")}")

    state
  end

  # For `/metrics` of the gateway that `bin/run` starts.
  defp count_lost(lines), do: Store.count_if_running(:default, {:output, :lines_lost}, lines)
end
