defmodule Aerie.Router.Vehicles do
  @moduledoc """
  Who has the vehicles that the router hears: a module that is given to `Aerie.Router.Supervisor` (`:vehicles`). A router
  without one passes frames on and knows no vehicles.

  A vehicle's frames go as messages to the process that is registered as its session (`Aerie.Names`, role `:session`); see
  `Aerie.Router.deliver/3`.
  """

  @doc """
  An autopilot is heard: makes sure that its vehicle has a session, and gives it. `:too_many` when there is no room for another
  one, `:not_running` when it may be tried again at once.
  """
  @callback ensure(Aerie.Names.gateway(), Aerie.Router.vehicle_key()) ::
              {:ok, pid} | {:error, :too_many | :not_running}
end
