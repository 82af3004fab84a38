defmodule Mix.Tasks.Sim.Fleet do
  @shortdoc "Starts simulated vehicles that fly by themselves"

  @moduledoc """
  Starts simulated vehicles that fly by themselves until Ctrl-C.

      mix sim.fleet [--count 3] [--to udpout:127.0.0.1:14550] [--firmware mixed|ardupilot|px4] [--first-system 1]
                    [--home LAT,LON,ALT] [--spacing 30] [--speed 1] [--seed 1] [--wind 0.2] [--ready 5] [--still]

  - `--to` is an address of `SimVehicle.Link` (udpout, udpin, tcp, tcpin). With udpin and tcpin the port counts up, one
    for each vehicle.
  - `--still`: they stand and wait for commands
  - `--loss 0.1`, `--delay 200`, `--corrupt 0.01`, `--duplicate 0.05`, `--reorder 0.05`: faults of all links from the
    start
  """

  use Mix.Task

  @switches [
    count: :integer,
    to: :string,
    firmware: :string,
    first_system: :integer,
    home: :string,
    spacing: :float,
    speed: :float,
    seed: :integer,
    wind: :float,
    ready: :float,
    still: :boolean,
    loss: :float,
    delay: :integer,
    corrupt: :float,
    duplicate: :float,
    reorder: :float,
    help: :boolean
  ]

  @impl Mix.Task
  def run(args) do
    case OptionParser.parse(args, strict: @switches) do
      {[help: true], [], []} -> Mix.shell().info(@moduledoc)
      {opts, [], []} -> start(opts)
      {_opts, extra, wrong} -> Mix.raise("unknown arguments: #{words(extra, wrong)} (mix sim.fleet --help)")
    end
  end

  defp start(opts) do
    Mix.Task.run("app.start")
    fleet_opts = fleet_opts(opts)

    case SimVehicle.Fleet.start_link(fleet_opts) do
      {:ok, fleet} -> fly(fleet, opts)
      {:error, reason} -> Mix.raise("the fleet could not be started: #{inspect(reason)}")
    end
  rescue
    error in ArgumentError -> Mix.raise(error.message)
  end

  defp fly(fleet, opts) do
    sims = SimVehicle.Fleet.sims(fleet)
    for {_system, sim} <- sims, {name, value} <- faults(opts), do: :ok = SimVehicle.fault(sim, name, value)

    for {system, sim} <- Enum.sort(sims) do
      Mix.shell().info(
        "system #{system}: #{opts[:to] || "udpout:127.0.0.1:14550"}, local port #{SimVehicle.port(sim)}"
      )
    end

    Process.sleep(:infinity)
  end

  @doc false
  def fleet_opts(opts) do
    [
      count: opts[:count] || 3,
      link: link(opts[:to] || "udpout:127.0.0.1:14550"),
      firmware: firmware(opts[:firmware] || "mixed"),
      first_system: opts[:first_system] || 1,
      spacing: opts[:spacing] || 30.0,
      speed: opts[:speed] || 1.0,
      seed: opts[:seed] || 1,
      wind: opts[:wind] || 0.2,
      ready_s: opts[:ready] || 5.0,
      fly: not (opts[:still] || false)
    ] ++ home(opts[:home])
  end

  defp faults(opts), do: Keyword.take(opts, [:loss, :delay, :corrupt, :duplicate, :reorder])

  # A listener each: the ports count up.
  defp link(address) do
    with true <- String.starts_with?(address, ["udpin:", "tcpin:"]),
         [kind, host, port] <- String.split(address, ":"),
         {port, ""} when port > 0 <- Integer.parse(port) do
      fn number -> "#{kind}:#{host}:#{port + number}" end
    else
      _same_for_all -> address
    end
  end

  defp firmware("mixed"), do: :mixed
  defp firmware("ardupilot"), do: :ardupilot
  defp firmware("px4"), do: :px4
  defp firmware(other), do: Mix.raise("expected --firmware mixed, ardupilot or px4, got: #{other}")

  defp home(nil), do: []

  defp home(text) do
    with [lat, lon, alt] <- String.split(text, ","),
         {lat, ""} <- Float.parse(lat),
         {lon, ""} <- Float.parse(lon),
         {alt, ""} <- Float.parse(alt) do
      [home: {lat, lon, alt}]
    else
      _malformed -> Mix.raise("expected --home LAT,LON,ALT (degrees, degrees, metres), got: #{text}")
    end
  end

  defp words(extra, wrong), do: Enum.join(extra ++ Enum.map(wrong, &elem(&1, 0)), " ")
end
