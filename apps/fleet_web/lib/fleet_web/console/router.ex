defmodule FleetWeb.Console.Router do
  @moduledoc "The routes of `FleetWeb.Console.Pages`."
  use Phoenix.Router, helpers: false
  import Phoenix.LiveView.Router

  alias FleetWeb.Console.{Alarms, Frame, Layout, Pages}
  alias FleetWeb.Console.SignIn.OnMount

  live_session :console, on_mount: [OnMount, Frame, Alarms.OnMount], layout: {Layout, :app} do
    for %{path: path, page: page} <- Pages.all(), do: live(path, page)
  end
end
