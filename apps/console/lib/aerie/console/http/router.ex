defmodule Aerie.Console.HTTP.Router do
  @moduledoc "The routes of `Aerie.Console.Pages`."
  use Phoenix.Router, helpers: false
  import Phoenix.LiveView.Router

  alias Aerie.Console.{Frame, Layout, Map, Pages}
  alias Aerie.Console.Pages.{Alarms, Operations}
  alias Aerie.Console.SignIn.OnMount

  live_session :console,
    on_mount: [OnMount, Frame, Operations.OnMount, Alarms.OnMount, Map.OnMount],
    layout: {Layout, :app} do
    for %{path: path, page: page} <- Pages.all(), do: live(path, page)
  end
end
