defmodule Aerie.Vehicle.Events do
  @moduledoc """
  The event loop of one vehicle.
  """
  use GenServer

  alias Aerie.{Fleet, Names, Vehicle}

  @spec start_link(gateway: Names.gateway(), options: Vehicle.Options.t()) :: GenServer.on_start()
  def start_link(arguments) do
    name = Names.via(arguments[:gateway], :events, arguments[:options].key)
    GenServer.start_link(__MODULE__, arguments, name: name)
  end

  @impl GenServer
  def init(gateway: gateway, options: options) do
    Process.set_label({:events, options.id})
    Fleet.Journal.wake(gateway)
    {:ok, %{gateway: gateway, id: options.id}}
  end
end
