defmodule FleetWeb.Console.Router do
  @moduledoc "The routes of `FleetWeb.Console.Pages`."
  use Phoenix.Router, helpers: false
  import Phoenix.LiveView.Router

  alias FleetWeb.Console.{Access, Frame, Layout, Pages}
  alias FleetWeb.Console.Alarms.OnMount

  live_session :console, on_mount: [Access.OnMount, Frame, OnMount], layout: {Layout, :app} do
    for %{path: path, page: page} <- Pages.all(), do: live(path, page)
  end
end
