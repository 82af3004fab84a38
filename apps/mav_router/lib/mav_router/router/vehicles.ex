defmodule MavRouter.Router.Vehicles do
  @moduledoc """
  The module that has the vehicles which the router hears, given to `MavRouter.Router.Supervisor` (`:vehicles`). Without one the router
  forwards frames and knows no vehicles.

  A vehicle's frames are sent to the process that is registered as its session (`Aerie.Base.Names`, role `:session`); see
  `MavRouter.Router.deliver/4`. Its first ones may wait for it: it asks for them (`MavRouter.Router.first_frames/2`) before it handles any
  other.
  """

  @doc """
  An autopilot is heard: gives the session of its vehicle, started if need be. `:too_many` when there is no room for another
  vehicle, `:not_running` when it may be tried again at once.
  """
  @callback ensure(Aerie.Base.Names.gateway(), MavRouter.Router.vehicle_key()) ::
              {:ok, pid} | {:error, :too_many | :not_running}
end
