defmodule MavRouter.Router.Settings do
  @moduledoc """
  The settings of the router itself; the rules of a link or client are in `MavRouter.Endpoints.Owner.RuleKeys`.
  """
  use Aerie.Base.Settings

  part :identity, MavRouter.Identity.Settings

  section "router", "How frames go from one to the other."

  setting :between_vehicles,
          {:enum, [:auto, :all, :heartbeats, :none]},
          """
          Which broadcasts of other vehicles a vehicle gets: heartbeats, none; auto: heartbeats in networks of at most
          32 vehicles, else none; all: their telemetry as well, such as positions for following and avoidance. Commands,
          sticks and input of estimators never go from one vehicle to another.
          """,
          default: :auto
end
