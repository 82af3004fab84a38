defmodule Aerie.Base.Application do
  @moduledoc false
  use Application
  use Supervisor

  alias Aerie.Base.Names

  @impl Application
  def start(_type, _args), do: Supervisor.start_link(__MODULE__, nil)

  # The tables of names are this process's: as a supervisor it has no code that could fail, and it ends with the application.
  @impl Supervisor
  def init(nil) do
    :ok = Names.prepare()

    Supervisor.init([{Names.Cleaner, owners: &Names.Book.owners/0, forget: &Names.forget/1}],
      strategy: :one_for_one,
      max_restarts: 100,
      max_seconds: 10
    )
  end
end
