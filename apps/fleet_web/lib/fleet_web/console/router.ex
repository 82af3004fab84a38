defmodule FleetWeb.Console.Router do
  @moduledoc "The pages and their paths. `FleetWeb.Console.Navigation` has the entries of the navigation."
  use Phoenix.Router, helpers: false
  import Phoenix.LiveView.Router

  alias FleetWeb.Console.{Access, Layout}
  alias FleetWeb.Console.Alarms.OnMount

  live_session :console, on_mount: [Access.OnMount, OnMount], layout: {Layout, :app} do
    live "/", FleetWeb.Console.Fleet.Page
    live "/vehicles/:id", FleetWeb.Console.Vehicle.Page
    live "/vehicles/:id/shadow", FleetWeb.Console.Shadow.Page
    live "/vehicles/:id/:section", FleetWeb.Console.Vehicle.Page
    live "/params", FleetWeb.Console.Params.Page
    live "/plan", FleetWeb.Console.Plan.Page
    live "/alarms", FleetWeb.Console.Alarms.Page
    live "/links", FleetWeb.Console.Links.Page
    live "/inspector", FleetWeb.Console.Inspector.Page
    live "/recordings", FleetWeb.Console.Recordings.Page
    live "/audit", FleetWeb.Console.Audit.Page
    live "/diagnosis", FleetWeb.Console.Diagnosis.Page
    live "/system", FleetWeb.Console.System.Page
    live "/settings", FleetWeb.Console.Settings.Page
  end
end
