defmodule FleetWeb.Console.Supervisor do
  @moduledoc """
  The console's processes, and its routes on the HTTP listener.

  ```
  FleetWeb.Console.Supervisor   one_for_one
  ├─ Assets                     owns the table of scripts, styles and images
  ├─ Access.Users               owns the table of users, writes their file
  ├─ Access.Sessions            owns the table of open sessions, writes their file
  ├─ Access.Limiter             counts failed sign-ins
  ├─ Map.Tiles                  knows the file or folder of map tiles
  ├─ Access.Launch              the token of the address that `bin/run` prints
  ├─ Alarms.Server              the alarms, for all operators
  ├─ Aerie.Fleet.Inspector            the messages on the links, while somebody looks
  ├─ Fleet.Board.Server         the rows of the fleet's table, for all who look
  ├─ Commands.Courses           how far each vehicle's commands are
  └─ a DynamicSupervisor        one process for each open page
  ```
  """
  use Supervisor

  alias Aerie.Base.Names
  alias FleetWeb.{Access, API, Console}
  alias Aerie.Fleet.Alarms
  alias FleetWeb.Console.{Assets, Layout, PageHandler, Router}
  alias FleetWeb.Console.Settings.Configuration
  alias Phoenix.LiveView.Server

  @spec start_link(keyword()) :: Supervisor.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Supervisor.start_link(__MODULE__, options, name: Names.via(gateway, :console))
  end

  @impl Supervisor
  def init(options) do
    gateway = options[:gateway]
    %{dir: dir, max_pages: max_pages} = settings = options[:settings]
    :ok = Configuration.share(gateway, options[:configuration])

    Supervisor.init(
      [
        {Assets, gateway: gateway},
        {Access.Users, gateway: gateway, file: Access.Users.file(dir)},
        {Access.Sessions, gateway: gateway, file: Path.join(dir, "sessions.json")},
        {Access.Limiter, gateway: gateway},
        {Console.Map.Tiles, gateway: gateway, path: settings.tiles, attribution: settings.tiles_attribution},
        {Access.Launch, gateway: gateway, file: Path.join(dir, "url")},
        {Alarms.Server, gateway: gateway},
        {Aerie.Fleet.Inspector, gateway: gateway},
        {Console.Fleet.Board.Server, gateway: gateway},
        {Console.Commands.Courses, gateway: gateway},
        {DynamicSupervisor, name: pages(gateway), max_children: max_pages}
      ],
      strategy: :one_for_one,
      max_restarts: 20,
      max_seconds: 10
    )
  end

  @doc "The server of the live pages. `policy` says which hosts are the gateway's."
  @spec server(Names.gateway(), API.Access.policy(), secret :: binary()) :: Server.t()
  def server(gateway, policy, secret) do
    Server.new(
      router: Router,
      secret: secret,
      supervisor: pages(gateway),
      root_layout: {Layout, :root},
      cookie: Access.Session.cookie(secret),
      session: &Map.put(Access.Session.extra(&1), "gateway", gateway),
      origin?: &PageHandler.own?(policy, &1),
      not_found: Layout.not_found(),
      too_many: Layout.too_many(),
      # Telemetry goes first.
      priority: :low,
      opened: fn _session -> Console.SignIn.OnMount.watch(gateway) end,
      over?: &Console.SignIn.OnMount.over?(gateway, &1, &2)
    )
  end

  @doc "The routes for Cowboy. Pages of other sites may not use the console, even if they may use `/api`."
  @spec routes(Names.gateway(), API.Access.policy(), secret :: binary()) :: [tuple()]
  def routes(gateway, policy, secret) do
    policy = %{policy | origins: [], keys: []}
    server = server(gateway, policy, secret)
    access = %{gateway: gateway, policy: policy, server: server}

    entrance =
      for {path, what} <- [{"/sign-in", :sign_in}, {"/sign-out", :sign_out}, {"/launch", :launch}],
          do: {path, Console.SignIn.Handler, Map.put(access, :what, what)}

    pages =
      for route <- Phoenix.LiveView.Cowboy.routes(server) do
        case route do
          {:_, _page, server} -> {:_, PageHandler, %{policy: policy, server: server}}
          socket -> socket
        end
      end

    downloads =
      for {path, what} <- [{"/download/recordings/:name", :recording}, {"/download/audit", :audit}],
          do: {path, FleetWeb.Console.DownloadHandler, Map.put(access, :what, what)}

    entrance ++
      downloads ++
      [
        {"/assets/:version/[...]", Assets.Handler, gateway},
        {"/tiles/:z/:x/:y", Console.Map.Tiles.Handler, access}
      ] ++ pages
  end

  defp pages(gateway), do: Names.via(gateway, :console_pages)
end
