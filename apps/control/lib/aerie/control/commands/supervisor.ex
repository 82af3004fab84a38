defmodule Aerie.Control.Commands.Supervisor do
  @moduledoc """
  The ledger, the server of commands, their tasks, and the recovery of what an earlier run left under way.

  If one dies, all restart (`one_for_all`): what was under way becomes `unknown` in the ledger, as after a kill, and is observed.
  """
  use Supervisor

  alias Aerie.Control.Commands.{Recovery, Server, Settings}
  alias Aerie.Base.Names
  alias Aerie.Control.Ledger
  alias Aerie.Control.Policy.ControlLease

  @doc """
  `:gateways` knows the other gateways (`Aerie.Control.Commands.Gateways`); without it this one is alone.
  """
  @spec start_link(
          gateway: Names.gateway(),
          settings: Settings.t(),
          gateways: module()
        ) ::
          Supervisor.on_start()
  def start_link(options),
    do: Supervisor.start_link(__MODULE__, options, name: Names.via(options[:gateway], :command_supervisor))

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    %Settings{ledger: ledger} = settings = Keyword.fetch!(options, :settings)
    Process.set_label({:command_supervisor, gateway})

    Supervisor.init(
      [
        {Ledger,
         gateway: gateway,
         dir: ledger.dir,
         max_entries: ledger.max_entries,
         max_age_s: round(ledger.max_age_s)},
        {Task.Supervisor, name: Names.via(gateway, :command_tasks)},
        {Server, gateway: gateway, settings: settings, gateways: options[:gateways]},
        {Recovery, gateway: gateway},
        {ControlLease.Announcer, gateway: gateway}
      ],
      strategy: :one_for_all,
      max_restarts: 10,
      max_seconds: 30
    )
  end
end
