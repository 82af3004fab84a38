defmodule Aerie.Vehicle.Supervisor.Tree do
  @moduledoc """
  The processes of one vehicle, `one_for_all`: session and event loop keep state about each other, so they restart
  together. Both recover from the store; a restart costs the frames in their mailboxes and no event. Further loops, such as the executor of
  commands, are plugged in.

  After ten restarts in ten seconds the tree dies, and `Aerie.Vehicle.Supervisor.TreeRestarter` starts it with growing
  delays.
  """
  use Supervisor, restart: :temporary

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle

  @spec start_link(keyword()) :: Supervisor.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    key = Keyword.fetch!(options, :key)
    Supervisor.start_link(__MODULE__, options, name: Names.via(gateway, :tree, key))
  end

  @doc "All trees of a gateway, with the options that they were started with."
  @spec all(Names.gateway()) :: [{Store.vehicle_key(), pid(), keyword()}]
  def all(gateway), do: Names.all(gateway, :tree)

  @impl Supervisor
  def init(options) do
    {gateway, rest} = Keyword.pop!(options, :gateway)
    {key, rest} = Keyword.pop!(rest, :key)
    given = [publisher: Vehicle.Settings.publisher(gateway)] ++ rest
    vehicle_options = Vehicle.Options.new(Vehicle.Settings.of(gateway), key, given)
    Process.set_label({:vehicle, vehicle_options.id, key})
    Names.put_value(gateway, :tree, key, rest)
    arguments = [gateway: gateway, options: vehicle_options]

    loops = for module <- Vehicle.Settings.loops(gateway), do: {module, arguments}

    # Events first: the session wakes it with its first observation.
    Supervisor.init(
      [
        {Vehicle.Events, arguments},
        {Vehicle.Session, arguments}
      ] ++ loops,
      strategy: :one_for_all,
      max_restarts: 10,
      max_seconds: 10
    )
  end
end
