defmodule Aerie.Api.Rest.Routes.Vehicle do
  @moduledoc """
  The routes of one vehicle: commands, desired state, recordings, signing (`Aerie.Api.Rest.Routes`); its
  operations have their own.
  """

  import Aerie.Api.Rest.Route

  @doc "The rows."
  @spec rows() :: [Aerie.Api.Rest.Route.t()]
  def rows do
    [
      get("/api/vehicles/:id", :vehicle, "Everything that is known of a vehicle.", answer: :vehicle),
      get("/api/vehicles/:id/signing", :vehicle_signing, "The signing state of a vehicle.",
        answer: :vehicle_signing
      ),
      get(
        "/api/vehicles/:id/commands",
        :vehicle_commands,
        "Which commands this key may give to the vehicle.",
        answer: :offers
      ),
      get(
        "/api/vehicles/:id/commands/:command",
        :look_at_command,
        "The progress of a command, or its result.",
        answer: [:result, :under_way]
      ),
      delete("/api/vehicles/:id/commands/:command", :cancel_command, "Cancels a command.",
        status: 202,
        answer: :cancelling
      )
    ]
  end
end
