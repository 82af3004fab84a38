defmodule Aerie.Vehicle.Settings do
  @moduledoc """
  What the configuration says about vehicles, as the value of the vehicles' supervisor's name. `Aerie.Vehicle.Options` are
  those of one vehicle.
  """
  use Aerie.Base.Settings

  import Aerie.Base.Settings.Rules

  alias Aerie.Base.Names
  alias Aerie.Base.Settings.Types

  part :identity, MavRouter.Identity.Settings
  part :sampling, Aerie.Vehicle.State.Sampling.Settings

  section ""

  setting :vehicles,
          {:list, {:section, vehicle_fields()}},
          """
          Public names of vehicles. One that is not listed is named after its network and system id.
          """,
          default: [],
          example: "[{id: VID-007, network: main, system_id: 7}]"

  section "mavlink"

  setting :request_streams,
          :boolean,
          """
          Ask vehicles for state messages that do not come by themselves, and for what clients want.
          """,
          default: true

  setting :streams,
          {:map, {:number, 0, 400}},
          """
          Messages that every vehicle is to send at least this often (per second), by their names.
          """,
          default: %{},
          example: "{ATTITUDE: 10, GLOBAL_POSITION_INT: 5}"

  setting :timesync_us,
          {:number, 0, 3600},
          "Time between two measurements of a vehicle's clock (TIMESYNC); 0: none.",
          key: "timesync_s",
          default: 10.0,
          times: 1_000_000

  setting :read_gcs_parameters,
          :boolean,
          """
          Read once from each vehicle which ground station it listens to, and what its mode switch, channels and buttons do (some
          thirty parameters).
          """,
          default: true

  section "events", "When a value is an event."

  setting :battery_low, {:number, 0, 1}, "Remaining charge (0 to 1) below which battery.low is given.",
    default: 0.25

  setting :battery_critical, {:number, 0, 1}, "… and battery.critical.", default: 0.1

  section "timeouts"

  setting :stale_us, {:number, 0.1, 3600}, "A vehicle without a heartbeat for this long is stale.",
    key: "vehicle_stale_s",
    default: 3.0,
    times: 1_000_000

  setting :lost_us, {:number, 0.1, 86_400}, "… and lost after this long.",
    key: "vehicle_lost_s",
    default: 5.0,
    times: 1_000_000

  setting :lost_high_latency_us,
          {:number, 1, 86_400},
          "A vehicle that is heard by high-latency links only is lost after this long.",
          key: "vehicle_lost_high_latency_s",
          default: 180.0,
          times: 1_000_000

  section "limits"

  setting :max_vehicles,
          {:integer, 1, 100_000},
          """
          Vehicles. A further one takes the place of the one that is lost for the longest time, or is counted and ignored.
          """,
          default: 600

  setting :displace_lost_ms,
          {:number, 0, 604_800},
          """
          How long a vehicle must be lost before one that was never here takes its place; one that was, or that has a name
          here, need not wait. The place of a vehicle with a name (vehicles, vehicle_id) is nobody else's.
          """,
          key: "displace_lost_s",
          default: 60.0,
          times: 1000

  defp vehicle_fields do
    [
      field(:id, Types.token(), "Public name.", required: true),
      field(:network, Types.token(), "Its network."),
      field(:system_id, {:integer, 1, 4_294_967_295}, "Its MAVLink system id.", required: true)
    ]
  end

  @doc """
  Keeps the settings of a gateway, and the modules that are plugged in from above (`:publisher`, `:arming`, `:loops`); the calling
  process is the vehicles' supervisor.
  """
  @spec put(Names.gateway(), t(), %{
          optional(:publisher | :arming) => module(),
          optional(:loops) => [module()]
        }) :: :ok
  def put(gateway, settings, plugs), do: Names.put_value(gateway, :vehicles, {settings, plugs})

  @doc "The settings of a gateway, with its own system id if that was found out; the defaults when it is not running."
  @spec of(Names.gateway()) :: t()
  def of(gateway) do
    {settings, _plugs} = Names.value(gateway, :vehicles) || {from(%{}), %{}}
    %{settings | identity: MavRouter.Identity.resolve(settings.identity, gateway)}
  end

  @doc "The gateway's `Aerie.Vehicle.Session.Publisher`, or nil."
  @spec publisher(Names.gateway()) :: module() | nil
  def publisher(gateway), do: plug(gateway, :publisher)

  @doc "The gateway's `Aerie.Vehicle.Session.ArmAuthorization`, or nil."
  @spec arming(Names.gateway()) :: module() | nil
  def arming(gateway), do: plug(gateway, :arming)

  @doc "Modules of processes that each vehicle's tree has besides its own, started with `:gateway` and `:options`."
  @spec loops(Names.gateway()) :: [module()]
  def loops(gateway), do: plug(gateway, :loops) || []

  defp plug(gateway, name), do: with({_settings, plugs} <- Names.value(gateway, :vehicles), do: plugs[name])

  @impl Aerie.Base.Settings
  def problems(%{vehicles: vehicles, timeouts: timeouts, events: events, limits: limits} = config) do
    streams =
      for {name, _hz} <- config.mavlink.streams, MavCodec.Dialects.All.message_id(name) == nil do
        problem(["mavlink", "streams", name], "the name of a message, such as ATTITUDE", "an unknown one")
      end

    several =
      failed([
        {timeouts.vehicle_lost_s <= timeouts.vehicle_stale_s, ["timeouts", "vehicle_lost_s"],
         "more than timeouts.vehicle_stale_s (#{timeouts.vehicle_stale_s})", "#{timeouts.vehicle_lost_s}"},
        {events.battery_critical > events.battery_low, ["events", "battery_critical"],
         "at most events.battery_low (#{events.battery_low})", "#{events.battery_critical}"},
        {length(vehicles) > limits.max_vehicles, ["vehicles"],
         "at most limits.max_vehicles (#{limits.max_vehicles})", "#{length(vehicles)}"}
      ])

    systems = &"#{&1.network}/#{&1.system_id}"

    streams ++
      twice(vehicles, & &1.id, ["vehicles"], "vehicle ids that differ") ++
      twice(vehicles, systems, ["vehicles"], "one name for each network and system id") ++ several
  end

  @impl Aerie.Base.Settings
  def warnings(%{mavlink: %{system_id: system}} = config) do
    texts([
      {is_nil(config.vehicle_id) and Enum.any?(config.vehicles, &(&1.system_id == system)),
       "mavlink.system_id #{system} is also a vehicle's in the list: a hub needs an id of its own, " <>
         "such as #{elem(MavRouter.Identity.default_ids(), 0)}. Aboard that vehicle, give vehicle_id instead."}
    ])
  end
end
