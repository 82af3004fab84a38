defmodule Aerie.Vehicle.Tree do
  @moduledoc """
  The processes of one vehicle, `one_for_all`: a session whose event loop died has told it things it no longer knows,
  and the other way round, so they restart together. Both come back from the store, so a restart costs the frames in
  their mailboxes and no event.

  Up to ten restarts in ten seconds, then the tree dies and `Aerie.Vehicle.Keeper` takes over with growing delays.
  """
  use Supervisor, restart: :temporary

  alias Aerie.{Names, Store, Vehicle}

  @spec start_link(keyword()) :: Supervisor.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    key = Keyword.fetch!(options, :key)
    Supervisor.start_link(__MODULE__, options, name: Names.via(gateway, :tree, key))
  end

  @doc "All trees of a gateway with the options they were started with."
  @spec all(Names.gateway()) :: [{Store.vehicle_key(), pid(), keyword()}]
  def all(gateway) do
    Registry.select(Aerie.Registry, [
      {{{gateway, :tree, :"$1"}, :"$2", :"$3"}, [], [{{:"$1", :"$2", :"$3"}}]}
    ])
  end

  @impl Supervisor
  def init(options) do
    {gateway, rest} = Keyword.pop!(options, :gateway)
    {key, rest} = Keyword.pop!(rest, :key)
    given = [fleet: Names.value(gateway, :vehicles)] ++ rest
    vehicle_options = Vehicle.Options.new(Aerie.RunningConfig.of(gateway), key, given)
    Process.set_label({:vehicle, vehicle_options.id, key})
    Names.put_value(gateway, :tree, key, rest)
    arguments = [gateway: gateway, options: vehicle_options]

    # Events first: the session offers what it sees to a loop that is there to look at it.
    Supervisor.init([{Vehicle.Events, arguments}, {Vehicle.Session, arguments}],
      strategy: :one_for_all,
      max_restarts: 10,
      max_seconds: 10
    )
  end
end
