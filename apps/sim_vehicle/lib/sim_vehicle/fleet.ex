defmodule SimVehicle.Fleet do
  @moduledoc """
  Several vehicles under one supervisor, each flying its own pattern for ever: arm, take off, circuits, return, land, a
  fresh battery, again. They stand in rows, `spacing` metres apart.

  Options:

  - `count` (3): number of vehicles, 1..200
  - `first_system` (1): their system ids count up from here
  - `link` ("udpout:127.0.0.1:14550"): one for all, or a function of the number 0.. that gives the address
  - `home` ({47.397742, 8.545594, 489.0}), `spacing` (30.0 m)
  - `firmware` (`:mixed`): `:ardupilot`, `:px4` or every third a PX4
  - `fly` (true): whether they fly by themselves
  - `seed`, `speed`, `wind`, `ready_s`, `rates`: as in `SimVehicle.Server.Options`; seed counts up
  """

  use Supervisor

  alias SimVehicle.Pilot
  alias SimVehicle.Physics.Geo
  alias SimVehicle.Server.Options

  @defaults [
    count: 3,
    first_system: 1,
    link: "udpout:127.0.0.1:14550",
    home: {47.397742, 8.545594, 489.0},
    spacing: 30.0,
    firmware: :mixed,
    fly: true,
    seed: 1,
    speed: 1.0,
    wind: 0.2,
    ready_s: 5.0,
    rates: %{},
    name: nil
  ]

  # Enough for every pattern, flown by the slower of the two firmwares, to end with a quarter of the charge.
  @capacity_mah 5500.0

  @doc "Starts the fleet; raises ArgumentError for an option that is unknown or wrong."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(opts \\ []) do
    case Keyword.validate(opts, @defaults) do
      {:ok, opts} ->
        vehicles = vehicles(Map.new(opts))
        Supervisor.start_link(__MODULE__, vehicles, if(opts[:name], do: [name: opts[:name]], else: []))

      {:error, unknown} ->
        raise ArgumentError,
              "unknown options #{inspect(unknown)}; known: #{Enum.map_join(@defaults, ", ", &":#{elem(&1, 0)}")}"
    end
  end

  @doc "The processes of the vehicles, by system id."
  @spec sims(Supervisor.supervisor()) :: %{pos_integer => pid}
  def sims(fleet) do
    for {{SimVehicle, system}, pid, _type, _modules} <- Supervisor.which_children(fleet),
        is_pid(pid),
        into: %{} do
      {system, pid}
    end
  end

  @doc "The options of each vehicle of a fleet."
  @spec vehicles(map) :: [keyword]
  def vehicles(opts) do
    unless opts.count in 1..200 and opts.first_system in 1..255 and opts.first_system + opts.count <= 256 do
      raise ArgumentError,
            "expected :count in 1..200 and system ids up to 255, got: #{opts.count} from #{opts.first_system}"
    end

    for number <- 0..(opts.count - 1) do
      vehicle = [
        firmware: firmware(opts.firmware, number),
        link: if(is_function(opts.link, 1), do: opts.link.(number), else: opts.link),
        system: opts.first_system + number,
        home: place(opts, number),
        heading: rem(number * 40, 360),
        seed: opts.seed + number,
        speed: opts.speed,
        wind: opts.wind,
        ready_s: opts.ready_s,
        rates: opts.rates,
        battery: [capacity_mah: @capacity_mah],
        script: if(opts.fly, do: Pilot.pattern(number))
      ]

      _checked = Options.validate!(vehicle)
      vehicle
    end
  end

  @impl Supervisor
  # A vehicle that crashes is the simulator's own fault: start it again, the others fly on.
  def init(vehicles), do: Supervisor.init(Enum.map(vehicles, &{SimVehicle, &1}), strategy: :one_for_one)

  defp firmware(:mixed, number), do: if(rem(number, 3) == 2, do: :px4, else: :ardupilot)
  defp firmware(one, _number), do: one

  defp place(opts, number) do
    {lat, lon, alt} = opts.home
    origin = %{lat: round(lat * 1.0e7), lon: round(lon * 1.0e7), alt: alt * 1.0}
    row = 8
    {lat, lon} = Geo.to_global(origin, -div(number, row) * opts.spacing, rem(number, row) * opts.spacing)
    {lat / 1.0e7, lon / 1.0e7, alt}
  end
end
