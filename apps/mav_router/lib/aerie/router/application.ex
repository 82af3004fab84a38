defmodule Aerie.Router.Application do
  @moduledoc false
  use Application

  @impl Application
  def start(_type, _args) do
    :ok = Aerie.Names.prepare()

    children = [
      # Names of all processes of all gateways (Aerie.Names).
      {Registry, keys: :unique, name: Aerie.Registry},
      # Who listens to which change notices (Aerie.Store.PubSub).
      {Registry, keys: :duplicate, name: Aerie.Store.PubSub.Subscribers}
    ]

    # A gateway's names are worth nothing without the registries, but gateways are not children of this supervisor:
    # each is started where it is needed (bin/run, a release's own child, a test).
    Supervisor.start_link(children, strategy: :one_for_all)
  end
end
