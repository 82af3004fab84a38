defmodule MavRouter.Sharing.ReadCache do
  @moduledoc """
  The module that answers ground stations which read parameters and plans, given to `MavRouter.Router.Supervisor` (`:readings`). Without one all
  such requests go to the vehicle.
  """

  alias Aerie.Base.Names
  alias MavRouter.Endpoints.Endpoint
  alias MavCodec.Frame

  @doc "Whether a frame may be such a request, or changes what they read. Must be cheap: it is asked of every frame of a client."
  @callback reading?(Frame.t()) :: boolean

  @doc """
  A request of a client to a vehicle; its target is the vehicle's own id. `:absorb`: it is answered by `ReadCache.Requests.answer/4`, or
  goes on later by `ReadCache.Requests.forward/3`.
  """
  @callback take(Names.gateway(), MavRouter.Router.vehicle_key(), Endpoint.key(), Frame.t()) ::
              :forward | :absorb
end
