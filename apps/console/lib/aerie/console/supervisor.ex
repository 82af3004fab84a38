defmodule Aerie.Console.Supervisor do
  @moduledoc """
  The console's processes. What they serve is in `Aerie.Console.HTTP.Routes`.

  ```
  Aerie.Console.Supervisor   one_for_one
  ├─ Assets                     owns the table of scripts, styles and images
  ├─ Access.Users               owns the table of users, writes their file
  ├─ Access.Sessions            owns the table of open sessions, writes their file
  ├─ Access.Limiter             counts failed sign-ins
  ├─ Map.Tiles                  knows the layers of the map
  ├─ Map.Tiles.Fetcher          fetches tiles of servers, and keeps them
  ├─ Map.Tiles.Area             fetches those of an area beforehand
  ├─ Access.Launch              the token of the address that `bin/run` prints
  ├─ Alarms              the alarms, for all operators
  ├─ Aerie.Fleet.Inspector      the messages on the links, while somebody looks
  ├─ Fleet.Board.Server         the rows of the fleet's table, for all who look
  ├─ Commands.Courses           how far each vehicle's commands are
  └─ a DynamicSupervisor        one process for each open page
  ```
  """
  use Supervisor

  alias Aerie.Base.Names
  alias Aerie.{Access, Console}
  alias Aerie.Fleet.Alarms
  alias Aerie.Console.Assets
  alias Aerie.Console.Pages.Settings.Configuration

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
        {Console.Map.Tiles, gateway: gateway, settings: settings.map},
        {Console.Map.Tiles.Fetcher,
         gateway: gateway,
         dir: Console.Map.Tiles.cache(settings.map.dir),
         most: settings.map.cache_mb * 1_000_000},
        {Console.Map.Tiles.Area, gateway: gateway, dir: Console.Map.Tiles.cache(settings.map.dir)},
        {Access.Launch, gateway: gateway, file: Path.join(dir, "url")},
        {Alarms, gateway: gateway},
        {Aerie.Fleet.Inspector, gateway: gateway},
        {Console.Pages.Fleet.Board.Server, gateway: gateway},
        {Console.Commands.Courses, gateway: gateway},
        {DynamicSupervisor, name: pages(gateway), max_children: max_pages}
      ],
      strategy: :one_for_one,
      max_restarts: 20,
      max_seconds: 10
    )
  end

  @doc "The supervisor of the open pages."
  @spec pages(Names.gateway()) :: GenServer.name()
  def pages(gateway), do: Names.via(gateway, :console_pages)
end
