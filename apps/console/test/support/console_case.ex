defmodule Aerie.ConsoleCase do
  @moduledoc """
  Tests of the console's pages: a gateway whose store the test fills by hand, and somebody signed in.

      setup do: {:ok, Aerie.ConsoleCase.start_console()}

      test "a page", %{console: console} do
        put_vehicle(console, "VID-001", mode: %{armed: true})
        {:ok, view, html} = live(conn(console, :operator), "/")
      end

  In a browser: `browse/3` runs a script of `test/js`, which signs in with `signIn(page, address, "operator")`.
  """
  use ExUnit.CaseTemplate

  alias Aerie.Base.Store
  alias Aerie.Console
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Access.{Session, Users}
  alias Aerie.Access.Users.Password
  alias Aerie.ConsoleCase

  @scripts Path.expand("../js", __DIR__)
  # As few as are allowed: tests would wait for nothing.
  @iterations 1_000

  @enforce_keys [:gateway, :port, :dir, :server, :url]
  defstruct @enforce_keys

  @type t :: %ConsoleCase{}

  using do
    quote do
      import Aerie.ConsoleCase
      import Phoenix.LiveViewTest, except: [conn: 1, conn: 2]
    end
  end

  setup context do
    if context[:chromium], do: Aerie.Lane.setup(context), else: :ok
  end

  @doc """
  Starts a gateway without links and NATS, its HTTP server on a free port, and a console with the users `viewer`, `operator` and `admin`, whose
  passwords are `password/1`. Options: `:users` (false: none), `:port`, `:dir`, `:gateway` (one that runs), `:config` (sections),
  `:pubsub_tick_ms` (5: pages hear of changes 40 times as often as with a gateway that is not a test's),
  `:configuration`, `:incident` (as of `Aerie.Console.HTTP.Routes.serve/4`).
  """
  @spec start_console(keyword()) :: [console: t()]
  def start_console(options \\ []) do
    dir = options[:dir] || folder()
    if Keyword.get(options, :users, true) and not File.exists?(Users.file(dir)), do: write_users(dir)

    config =
      Map.merge(
        %{http: %{port: options[:port] || 0}, console: %{dir: dir}, websocket: %{enabled: false}},
        options[:config] || %{}
      )

    gateway = options[:gateway] || start_gateway(config, options)
    settings = Aerie.Api.Settings.from(config)

    given = options |> Keyword.take([:configuration, :incident]) |> Map.new()
    pages = &Console.HTTP.Routes.serve(gateway, settings.console, given, &1)

    ExUnit.Callbacks.start_supervised!(
      Supervisor.child_spec(
        {Aerie.Api.Endpoint, gateway: gateway, settings: settings, pages: pages},
        id: {:endpoint, gateway}
      )
    )

    port = Aerie.Api.Endpoint.port(gateway)
    {:ok, secret} = Aerie.Access.Session.secret(make_ref(), dir)
    policy = %{keys: [], origins: [], ports: [], hosts: []}

    [
      console: %ConsoleCase{
        gateway: gateway,
        port: port,
        dir: dir,
        server: Console.HTTP.Routes.server(gateway, policy, secret),
        url: "http://127.0.0.1:#{port}"
      }
    ]
  end

  defp start_gateway(config, options) do
    options = Keyword.take(options, [:pubsub_tick_ms])
    Aerie.GatewayCase.start_gateway(config, options ++ [name: make_ref(), with: [:router]])
  end

  @doc "Ends the console and its HTTP server; the gateway goes on."
  @spec stop_console(t()) :: :ok
  def stop_console(%ConsoleCase{gateway: gateway}),
    do: ExUnit.Callbacks.stop_supervised!({:endpoint, gateway})

  defp folder do
    dir = Path.join(System.tmp_dir!(), "aerie-console-#{System.unique_integer([:positive])}-#{System.pid()}")
    ExUnit.Callbacks.on_exit(fn -> File.rm_rf!(dir) end)
    dir
  end

  @doc "The password of a user of the tests."
  @spec password(atom()) :: String.t()
  def password(role), do: "password-of-#{role}"

  defp write_users(dir) do
    users =
      for role <- [:viewer, :operator, :admin],
          do: %{name: role, role: role, password: Password.hash(password(role), @iterations)}

    :ok = Aerie.Base.Files.Private.new_folder(dir)

    :ok =
      Aerie.Base.Files.Private.write(Path.join(dir, "users.json"), JSON.encode_to_iodata!(%{users: users}))
  end

  @doc "Somebody with a role, signed in; `nil`: nobody. For `Phoenix.LiveViewTest.live/2`. A test with pages of its own gives its router."
  @spec conn(t(), :viewer | :operator | :admin | nil, module()) :: Phoenix.LiveViewTest.conn()
  def conn(console, role \\ :operator, router \\ Console.HTTP.Router) do
    user = role && Users.find(console.gateway, Atom.to_string(role))
    session = if user, do: Session.of_user(console.gateway, user), else: %{}

    Phoenix.LiveViewTest.conn(
      %{console.server | router: router},
      Map.put(session, "gateway", console.gateway)
    )
  end

  @doc """
  Puts a vehicle into the store: `groups` are merged into those of a copter that hovers, the rest of `fields` into its snapshot.
  """
  @spec put_vehicle(t(), String.t(), keyword(), map()) :: :ok
  def put_vehicle(%ConsoleCase{gateway: gateway}, id, groups \\ [], fields \\ %{}) do
    now = System.os_time(:microsecond)
    system = :erlang.phash2(id, 200) + 1

    groups =
      for {name, data} <- groups(groups), into: %{}, do: {name, %{at: now, time_boot_ms: 5_000, data: data}}

    snapshot = %Aerie.Vehicle.Snapshot{
      id: id,
      key: {"main", system},
      network: "main",
      system_id: system,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      firmware: "4.6.0",
      status: :online,
      last_heard: now,
      links: ["radio"],
      groups: groups
    }

    snapshot = Map.merge(snapshot, fields)
    Store.put_vehicle(gateway, snapshot.key, snapshot)
  end

  @hovering [
    position: %{lat: 47.3977, lon: 8.5456, alt_msl: 508.2, alt_rel: 20.1, heading: 90.0},
    attitude: %{roll: 1.5, pitch: -2.0, yaw: 90.0, rollspeed: 0.0, pitchspeed: 0.0, yawspeed: 0.0},
    velocity: %{vn: 0.0, ve: 3.0, vd: 0.0, groundspeed: 3.0, airspeed: 3.2, climb: 0.1, throttle: 0.42},
    battery: %{
      id: 0,
      voltage: 22.8,
      current: 12.5,
      remaining: 0.76,
      consumed_mah: 1200,
      charge_state: "OK",
      batteries: []
    },
    gps: %{
      fix: 3,
      fix_name: "3D_FIX",
      satellites: 14,
      hdop: 0.8,
      vdop: 1.1,
      lat: 47.3977,
      lon: 8.5456,
      alt_msl: 508.0
    },
    mode: %{
      mode: "GUIDED",
      armed: true,
      in_air: true,
      failsafe: false,
      system_status: "ACTIVE",
      landed_state: "IN_AIR"
    },
    home: %{lat: 47.3975, lon: 8.5450, alt_msl: 488.0}
  ]

  defp groups(changes) do
    Enum.reduce(changes, @hovering, fn
      {name, nil}, groups -> Keyword.delete(groups, name)
      {name, data}, groups -> Keyword.update(groups, name, data, &Map.merge(&1, data))
    end)
  end

  @doc "Starts what keeps the gateway's operations, for pages that act on several vehicles."
  @spec start_operations(t()) :: pid()
  def start_operations(%ConsoleCase{gateway: gateway}),
    do: ExUnit.Callbacks.start_supervised!({Aerie.Fleet.Operations.Supervisor, gateway: gateway})

  @doc "Puts somebody in charge of the vehicle with a system id of network `main`."
  @spec take_charge(t(), 1..255, String.t(), Aerie.Control.Policy.Roles.role()) :: :ok
  def take_charge(%ConsoleCase{gateway: gateway}, system_id, name, role \\ :operator) do
    source = %{name: name, role: role, permissions: []}
    rules = %{required: false, take_over: :operator}
    {:ok, _lease} = Holders.change(gateway, {"main", system_id}, {:take, nil, nil}, source, "rest", rules)
    :ok
  end

  @doc "Puts a link into the store: an UDP port on which somebody is heard, and `fields`."
  @spec put_link(t(), String.t(), map()) :: :ok
  def put_link(%ConsoleCase{gateway: gateway}, id, fields \\ %{}) do
    link = %{
      id: id,
      network: "main",
      kind: :udp_server,
      url: "udpin:0.0.0.0:14550",
      label: nil,
      status: :up,
      text: "up",
      last_heard: System.os_time(:microsecond),
      local: "0.0.0.0:14550",
      rates: %{bytes_in: 1_200, bytes_out: 40, frames_in: 48, writes_out: 1, crc_errors: 0},
      counters: %{}
    }

    Store.put_link(gateway, id, Map.merge(link, fields))
  end

  @doc "Runs a script of `test/js` with the console's address as its first argument; fails with its output unless it ends well."
  @spec browse(t(), String.t(), [String.t()]) :: String.t()
  def browse(%ConsoleCase{url: url}, script, arguments \\ []) do
    {output, status} = Aerie.Browser.run(Path.join(@scripts, script), [url | arguments])
    if status != 0, do: ExUnit.Assertions.flunk(output)
    output
  end

  @doc "Starts such a script as a port, for a test that acts while it runs: it prints lines (`await_line/2`), and reads them (`Port.command/2`)."
  @spec browser(t(), String.t(), [String.t()]) :: port()
  def browser(%ConsoleCase{url: url}, script, arguments \\ []),
    do: Aerie.Browser.open(Path.join(@scripts, script), [url | arguments])

  # Each of a script's own waits ends after five minutes, and then says what the page showed; several may be needed for a line.
  @script_ms 900_000

  @doc "Waits until a script says a line; fails with all that it said if it ends before."
  @spec await_line(port(), String.t(), [String.t()]) :: :ok
  def await_line(script, line, before \\ []) do
    receive do
      {^script, {:data, {_end, ^line}}} ->
        :ok

      {^script, {:data, {_end, other}}} ->
        await_line(script, line, [other | before])

      {^script, {:exit_status, _status}} ->
        ExUnit.Assertions.flunk(before |> Enum.reverse() |> Enum.join("\n"))
    after
      @script_ms ->
        ExUnit.Assertions.flunk("never said #{line}: #{Enum.join(Enum.reverse(before), "\n")}")
    end
  end

  @doc "Has a page of the fleet read the store now, and not at the next notice."
  @spec refresh_fleet(Phoenix.LiveViewTest.View.t()) :: String.t()
  def refresh_fleet(%{pid: pid, conn: %{session: %{"gateway" => gateway}}} = view) do
    _news = Console.Pages.Fleet.Board.Server.news(gateway, nil, :now)
    send(pid, :refresh)
    Phoenix.LiveViewTest.render(view)
  end

  @doc "See `Aerie.Patience.eventually/1`."
  @spec eventually((-> result)) :: result when result: term()
  defdelegate eventually(fun), to: Aerie.Patience
end
