defmodule Aerie.Console.HTTP.Routes do
  @moduledoc "What the console serves: pages, signing in and out, downloads, assets and map tiles."

  alias Aerie.Access.HTTP.Admission
  alias Aerie.Access.Session
  alias Aerie.Base.Names
  alias Aerie.Console.{Assets, Layout, SignIn, Supervisor}
  alias Aerie.Console.HTTP.{DownloadHandler, IncidentHandler, PageHandler, Router}
  alias Aerie.Console.Map.Tiles
  alias Aerie.Console.Pages.Settings.Configuration
  alias Phoenix.LiveView.Server

  @typedoc "What the console cannot do by itself: what the page of settings shows, and packing an incident."
  @type given :: %{
          optional(:configuration) => (-> [Configuration.section()]),
          optional(:incident) => IncidentHandler.pack()
        }

  @doc "The console's processes and routes, for the HTTP server. What is not `given` its pages do not offer."
  @spec serve(Names.gateway(), map(), given(), Admission.policy()) ::
          {:ok, [{module(), keyword()}], [tuple()]} | {:error, String.t()}
  def serve(gateway, settings, given, policy) do
    with {:ok, secret} <- Session.secret(gateway, settings.dir) do
      {:ok, [{Supervisor, gateway: gateway, settings: settings, configuration: given[:configuration]}],
       routes(gateway, policy, secret, %{pack: given[:incident], dir: settings.dir})}
    end
  end

  @doc "The server of the live pages. `policy` says which hosts are the gateway's."
  @spec server(Names.gateway(), Admission.policy(), secret :: binary()) :: Server.t()
  def server(gateway, policy, secret) do
    Server.new(
      router: Router,
      secret: secret,
      supervisor: Supervisor.pages(gateway),
      root_layout: {Layout, :root},
      cookie: Session.cookie(secret),
      session: &Map.put(Session.extra(&1), "gateway", gateway),
      origin?: &PageHandler.own?(policy, &1),
      not_found: Layout.not_found(),
      too_many: Layout.too_many(),
      # Telemetry goes first.
      priority: :low,
      opened: fn _session -> SignIn.OnMount.watch(gateway) end,
      over?: &SignIn.OnMount.over?(gateway, &1, &2)
    )
  end

  @doc "The routes for Cowboy. Pages of other sites may not use the console, even if they may use `/api`."
  @spec routes(Names.gateway(), Admission.policy(), secret :: binary(), incidents :: map()) :: [tuple()]
  def routes(gateway, policy, secret, incidents) do
    policy = %{policy | origins: [], keys: []}
    server = server(gateway, policy, secret)
    access = %{gateway: gateway, policy: policy, server: server}

    entrance =
      for {path, what} <- [{"/sign-in", :sign_in}, {"/sign-out", :sign_out}, {"/launch", :launch}],
          do: {path, SignIn.Handler, Map.put(access, :what, what)}

    pages =
      for route <- Phoenix.LiveView.Cowboy.routes(server) do
        case route do
          {:_, _page, server} -> {:_, PageHandler, %{policy: policy, server: server}}
          socket -> socket
        end
      end

    downloads =
      for {path, what} <- [{"/download/recordings/:name", :recording}, {"/download/audit", :audit}],
          do: {path, DownloadHandler, Map.put(access, :what, what)}

    entrance ++
      downloads ++
      [
        {"/download/incident", IncidentHandler, Map.merge(access, incidents)},
        {"/assets/:version/[...]", Assets.Handler, gateway},
        {"/tiles", Tiles.Handler, Map.put(access, :what, :layers)},
        {"/tiles/:layer", Tiles.Handler, Map.put(access, :what, :archive)},
        {"/tiles/:layer/area", Tiles.Handler, Map.put(access, :what, :area)},
        {"/tiles/:layer/:z/:x/:y", Tiles.Handler, Map.put(access, :what, :tile)}
      ] ++ pages
  end
end
