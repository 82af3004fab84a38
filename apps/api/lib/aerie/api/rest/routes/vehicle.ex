defmodule Aerie.Api.Rest.Routes.Vehicle do
  @moduledoc """
  The routes of one vehicle that are not of an operation (`Aerie.Api.Rest.Routes`).
  """

  import Aerie.Api.Rest.Route

  @doc "The rows."
  @spec rows() :: [Aerie.Api.Rest.Route.t()]
  def rows do
    [
      get("/api/vehicles/:id", :vehicle, "Everything that is known of a vehicle.", answer: :vehicle),
      get("/api/vehicles/:id/signing", :vehicle_signing, "The signing state of a vehicle.",
        answer: :vehicle_signing
      )
    ]
  end
end
