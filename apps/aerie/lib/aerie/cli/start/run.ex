defmodule Aerie.CLI.Start.Run do
  @moduledoc """
  Starts the parts of a plan below `Aerie.CLI.Supervisor`, each after the ones that it depends on:

  1. `Aerie.Gateway` with the checked configuration
  2. `Aerie.CLI.Start.ModuleLoader`, whose end the readiness waits for
  3. `Aerie.Api.Endpoint`
  4. `Aerie.Reload`, which puts a changed configuration in force
  5. `SimVehicle.Fleet` and `Aerie.CLI.Start.SimMsp`, if simulated vehicles were asked for. They use a loopback link and a network of their own
     (`sim`), so that they cannot collide with a real vehicle of the same system id.
  6. `Aerie.Node`, the way in for `bin/aerie`
  7. `Aerie.Systemd`, if systemd started the program, which then learns that all that is asked for is there
  8. `Aerie.CLI.Status`

  If a part fails to start, the parts before it are stopped and the error messages are returned.
  """

  alias Aerie.{Config, EventLog, Reload, Systemd}
  alias Aerie.Base.Log
  alias MavRouter.Link.Spec
  alias Aerie.CLI.Status
  alias Aerie.CLI.Start.{HTTP, ModuleLoader, Plan, Ports, SimMsp}

  @loopback {127, 0, 0, 1}
  @sim_port 14_650

  @type run :: %{gateway: term(), config: Config.t(), http: String.t() | nil}

  @doc """
  Starts a plan.

  Options: `gateway` (name of the instance, default `:default`), `style` and `size` of the status display,
  `status: false` for no display, `supervisor` (default `Aerie.CLI.Supervisor`), `device` of the status display and
  `warnings`, the device for the configuration's warnings (default: standard output and standard error), `log: true`: the log of
  the VM is this gateway's, in the configured format and from the configured level on.
  """
  @spec start(Plan.t(), keyword()) :: {:ok, run()} | {:error, [String.t()]}
  def start(plan, options \\ []) do
    supervisor = Keyword.get(options, :supervisor, Aerie.CLI.Supervisor)
    gateway = Keyword.get(options, :gateway, :default)

    with {:ok, loaded} <- load(plan),
         {:ok, config} <- free_ports(loaded),
         {:ok, config, sim_port} <- sim_link(config, plan.sim),
         {:ok, config, msp_ports} <- SimMsp.links(config, Map.get(plan, :sim_msp, 0)),
         {:ok, warnings} <- preflight(config) do
      # The terminal's table clears the screen, so it repeats them.
      config = %{config | warnings: config.warnings ++ warnings}
      options = if options[:log] && Systemd.there?(), do: [status: false] ++ options, else: options
      if options[:log], do: take_log(gateway, config, options)
      device = Keyword.get(options, :warnings, :stderr)
      Enum.each(config.warnings, &IO.puts(device, "warning: " <> &1))
      start_parts(supervisor, gateway, {loaded, config}, plan, {sim_port, msp_ports}, options)
    end
  end

  @doc "What keeps a plan from being started, but for the ports that `ours?` says are free."
  @spec check(Plan.t(), Config.Preflight.ours()) :: :ok | {:error, [String.t()]}
  def check(plan, ours?) do
    with {:ok, config} <- load(plan), {:ok, _warnings} <- preflight(config, ours?), do: :ok
  end

  # The table of a terminal shows events itself; so do the lines of the status, those of vehicles.
  defp take_log(gateway, config, options) do
    :ok = Log.configure(Log.Settings.from(config))

    case {Keyword.get(options, :status, true), options[:style]} do
      {false, _style} -> EventLog.attach(gateway)
      {true, :table} -> :ok
      {true, _lines} -> EventLog.attach(gateway, except: [[:aerie, :vehicle, :event]])
    end
  end

  defp load(plan) do
    case Config.load(plan.config_file, plan.overrides) do
      {:ok, config} -> {:ok, config}
      {:error, errors} -> {:error, [Config.format_errors(errors)]}
    end
  end

  defp preflight(config, ours? \\ fn _protocol, _port -> false end) do
    case Config.Preflight.check(config, ours?) do
      {:ok, warnings} -> {:ok, warnings}
      {:error, errors} -> {:error, [Config.format_errors(errors)]}
    end
  end

  # Only default ports may move to the next free one. A configured port stays; preflight reports it if it is taken.
  defp free_ports(config) do
    with {:ok, config} <- free_http(config),
         {:ok, config} <- free_websocket(config),
         do: free_mavlink(config)
  end

  defp free_http(config) do
    if Config.given?(config, "http.port") or not config.http.enabled do
      {:ok, config}
    else
      {:ok, address} = :inet.parse_address(String.to_charlist(config.http.address))
      with_port(Ports.free_tcp(address, config.http.port), "HTTP", &put_in(config.http.port, &1))
    end
  end

  defp free_websocket(config) do
    if Config.given?(config, "websocket.port") or not config.websocket.enabled do
      {:ok, config}
    else
      {:ok, address} = :inet.parse_address(String.to_charlist(config.websocket.address))
      found = Ports.free_tcp(address, config.websocket.port)
      with_port(found, "WebSocket", &put_in(config.websocket.port, &1))
    end
  end

  defp free_mavlink(config) do
    case Enum.split_with(config.links, &match?(%{given: false, url: "udpin:" <> _address}, &1)) do
      {[], _links} ->
        {:ok, config}

      {[link], links} ->
        [port, host] =
          link.url |> String.reverse() |> String.split(":", parts: 2) |> Enum.map(&String.reverse/1)

        found = Ports.free_udp({0, 0, 0, 0}, String.to_integer(port))
        with_port(found, "MAVLink", &%{config | links: [moved(link, "#{host}:#{&1}") | links]})
    end
  end

  defp moved(link, url) do
    {:ok, spec} = Spec.parse(url, id: link.id, network: link.network)
    %{link | url: url, spec: spec}
  end

  defp with_port({:ok, port}, _what, put), do: {:ok, put.(port)}

  defp with_port({:error, :none_free}, what, _put),
    do: {:error, ["no free port for #{what}: configure one"]}

  defp sim_link(config, 0), do: {:ok, config, nil}

  defp sim_link(config, _count) do
    case Code.ensure_loaded?(SimVehicle.Fleet) && Ports.free_udp(@loopback, @sim_port) do
      false ->
        {:error, ["a release has no simulated vehicles: give --link or --config"]}

      {:ok, port} ->
        link = %{
          id: "sim",
          network: "sim",
          label: "simulated vehicles",
          enabled: true,
          given: false,
          url: nil,
          spec: nil
        }

        link = moved(link, "udpin:127.0.0.1:#{port}")
        {:ok, %{config | links: config.links ++ [link]}, port}

      {:error, :none_free} ->
        {:error,
         [
           "no free UDP port for the simulated vehicles: end the programs that use port #{@sim_port} and the ones after it"
         ]}
    end
  end

  defp start_parts(supervisor, gateway, {loaded, config}, plan, {sim_port, msp_ports}, options) do
    http = HTTP.url(config)

    read = fn -> Config.load(plan.config_file, plan.overrides) end

    parts =
      [{:gateway, {Aerie.Gateway, name: gateway, config: config, read_config: read}}] ++
        [{:modules, %{id: ModuleLoader, start: {ModuleLoader, :start, [gateway]}}}] ++
        HTTP.part(gateway, config) ++
        [{:reload, {Reload, gateway: gateway, config: loaded, read: read, log?: options[:log] == true}}] ++
        sim_part(plan, sim_port) ++
        SimMsp.part(msp_ports) ++
        node_part(gateway, http, config) ++
        systemd_part(gateway) ++
        status_part(gateway, http, config, options)

    Enum.reduce_while(parts, {:ok, []}, fn {id, child}, {:ok, started} ->
      case Supervisor.start_child(
             supervisor,
             Supervisor.child_spec(child, id: {id, gateway}, restart: :permanent)
           ) do
        {:ok, _pid} -> {:cont, {:ok, [id | started]}}
        {:error, reason} -> {:halt, undo(supervisor, gateway, started, id, reason)}
      end
    end)
    |> case do
      {:ok, _started} ->
        {:ok, %{gateway: gateway, config: config, http: http}}

      {:error, messages} ->
        {:error, messages}
    end
  end

  defp undo(supervisor, gateway, started, id, reason) do
    for part <- started do
      _ = Supervisor.terminate_child(supervisor, {part, gateway})
      _ = Supervisor.delete_child(supervisor, {part, gateway})
    end

    {:error, ["#{id} did not start: #{Exception.format_exit(reason)}"]}
  end

  # systemd watches the program's gateway, not those of tests.
  defp systemd_part(:default), do: [{:systemd, {Systemd, gateway: :default}}]
  defp systemd_part(_other), do: []

  defp sim_part(%{sim: 0}, _port), do: []

  defp sim_part(%{sim: count, sim_speed: speed}, port),
    do: [{:sim, {SimVehicle.Fleet, count: count, speed: speed, link: "udpout:127.0.0.1:#{port}"}}]

  # The tools ask the gateway that a node is started for, not those of tests.
  defp node_part(:default, http, config) do
    settings = Aerie.Node.Settings.from(config)
    [{:node, {Aerie.Node, settings: settings, http: http, config: config.file}}]
  end

  defp node_part(_other, _http, _config), do: []

  defp status_part(gateway, http, config, options) do
    if Keyword.get(options, :status, true) do
      [
        {:status,
         {Status,
          [gateway: gateway, http: http, config: config] ++ Keyword.take(options, [:style, :size, :device])}}
      ]
    else
      []
    end
  end
end
