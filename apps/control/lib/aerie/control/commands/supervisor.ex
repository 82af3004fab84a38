defmodule Aerie.Control.Commands.Supervisor do
  @moduledoc """
  The door to the vehicles: the ledger, the desk, the tasks that bring commands through, and the recovery of what an earlier run
  left behind.

  If one dies, all restart (`one_for_all`): what was under way then is `unknown` in the ledger, as after a kill, and is observed.
  """
  use Supervisor

  alias Aerie.Control.Commands.{LeaseAnnouncer, Recovery, Server, Settings}
  alias Aerie.Base.Names
  alias Aerie.Control.Ledger

  @doc """
  `:elsewhere`: the way to vehicles of other gateways (`Aerie.Control.Commands.RemoteGateway`); without one there are none. `:holder`: who holds
  a vehicle (`Aerie.Control.Commands.Ownership`); without one this gateway is alone.
  """
  @spec start_link(gateway: Names.gateway(), settings: Settings.t(), elsewhere: module(), holder: module()) ::
          Supervisor.on_start()
  def start_link(options),
    do: Supervisor.start_link(__MODULE__, options, name: Names.via(options[:gateway], :command_door))

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    %Settings{ledger: ledger} = settings = Keyword.fetch!(options, :settings)
    Process.set_label({:command_door, gateway})

    Supervisor.init(
      [
        {Ledger,
         gateway: gateway,
         dir: ledger.dir,
         max_entries: ledger.max_entries,
         max_age_s: round(ledger.max_age_s)},
        {Task.Supervisor, name: Names.via(gateway, :command_tasks)},
        {Server,
         gateway: gateway, settings: settings, elsewhere: options[:elsewhere], holder: options[:holder]},
        {Recovery, gateway: gateway},
        {LeaseAnnouncer, gateway: gateway}
      ],
      strategy: :one_for_all,
      max_restarts: 10,
      max_seconds: 30
    )
  end
end
