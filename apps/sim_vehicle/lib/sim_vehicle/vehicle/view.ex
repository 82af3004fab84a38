defmodule SimVehicle.Vehicle.View do
  @moduledoc """
  A snapshot of a vehicle for tests and tables, in plain units.
  """

  alias SimVehicle.Vehicle
  alias SimVehicle.Physics.{Battery, Kinematics}

  @typedoc """
  - `lat`, `lon` degrees; `alt`, `alt_rel`, `north`, `east` metres; `heading` degrees; speeds m/s
  - `battery` 0.0..1.0, `voltage` V
  - `landed`: `:on_ground`, `:taking_off`, `:in_air`, `:landing`
  - `ready`: the position is good enough to arm
  - `seconds` since boot (vehicle time), `boots` how often it was powered up
  - `mission`: `%{current, state, items}`; `failsafes`: list
  """
  @type t :: map

  @doc "The view of a vehicle now."
  @spec of(Vehicle.t()) :: t
  def of(v) do
    {lat, lon} = Vehicle.position(v)

    %{
      system: v.system,
      mode: v.mode,
      armed: v.armed,
      airborne: v.airborne,
      landed: v.landed,
      ready: Vehicle.positioned?(v),
      lat: lat / 1.0e7,
      lon: lon / 1.0e7,
      alt: Vehicle.altitude(v),
      alt_rel: Vehicle.relative_altitude(v),
      north: v.kin.n,
      east: v.kin.e,
      heading: SimVehicle.Physics.Geo.centidegrees(v.kin.yaw) / 100,
      groundspeed: Kinematics.groundspeed(v.kin),
      climb: -v.kin.vd,
      battery: Battery.remaining(v.battery),
      voltage: Battery.voltage(v.battery),
      failsafes: Enum.sort(MapSet.to_list(v.failsafes)),
      mission: %{
        current: v.mission.current,
        state: v.mission.state,
        items: length(SimVehicle.Plans.items(v.plans, 0))
      },
      home: v.home,
      seconds: Vehicle.seconds(v),
      boots: v.boots
    }
  end
end
