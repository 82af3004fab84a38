defmodule SimVehicle.Firmware.Ardupilot.Arming do
  @moduledoc """
  ArduCopter's arming: the checks with their texts, and disarming by itself.
  """

  import MavCodec.MessageId

  alias MavCodec.Enums.MavResult
  alias MavCodec.Messages, as: M
  alias SimVehicle.{Flight, Params, Vehicle}
  alias SimVehicle.Physics.{Battery, Geo}
  alias SimVehicle.Services.Telemetry
  alias SimVehicle.Firmware.Ardupilot.{Calibration, Modes}

  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @failed MavResult.value(:MAV_RESULT_FAILED)
  @force 21_196
  @prearm_every_us 30_000_000

  @doc "COMPONENT_ARM_DISARM with 1; `force` is its second parameter."
  @spec arm(Vehicle.t(), number) :: {non_neg_integer, (Vehicle.t() -> Vehicle.t())}
  def arm(%{armed: true}, _force), do: {@accepted, & &1}

  def arm(v, force) do
    reasons = if(force == @force, do: mandatory(v), else: reasons(v)) ++ mode(v)

    case reasons do
      [] -> {@accepted, &armed/1}
      [_first | _rest] -> {@failed, fn v -> Enum.reduce(reasons, v, &Vehicle.text(&2, 2, "Arm: " <> &1)) end}
    end
  end

  @doc "COMPONENT_ARM_DISARM with 0."
  @spec disarm(Vehicle.t(), number) :: {non_neg_integer, (Vehicle.t() -> Vehicle.t())}
  def disarm(%{armed: false}, _force), do: {@accepted, & &1}
  def disarm(%{airborne: true}, force) when force != @force, do: {@failed, & &1}
  def disarm(_v, _force), do: {@accepted, &stop/1}

  @doc "Stops the motors and says so."
  @spec stop(Vehicle.t()) :: Vehicle.t()
  def stop(v) do
    %{v | landed: if(v.airborne, do: v.landed, else: :on_ground)}
    |> Flight.disarm()
    |> rewind()
    |> Vehicle.put_own(:auto_armed, false)
    |> Vehicle.text(6, "Disarming motors")
  end

  # Disarming resets the mission to its beginning.
  defp rewind(%{mission: %{state: :none}} = v), do: v
  defp rewind(v), do: %{v | mission: %{v.mission | current: 0, state: :not_started}}

  @doc "The reasons against arming, in the firmware's words; empty when there are none."
  @spec reasons(Vehicle.t()) :: [String.t()]
  def reasons(v) do
    mandatory(v) ++
      for {true, text} <- [
            {MapSet.member?(v.failsafes, :rc), "Throttle below failsafe"},
            {MapSet.member?(v.failsafes, :gcs), "GCS failsafe on"},
            {battery?(v), "Battery failsafe"},
            {MapSet.member?(v.failsafes, :fence), "Vehicle outside fence"}
          ],
          do: text
  end

  @doc "Reports every 30 seconds why the vehicle cannot be armed, and disarms it when it is idle."
  @spec tick(Vehicle.t()) :: Vehicle.t()
  def tick(%{armed: true} = v), do: if(Calibration.holds?(v), do: v, else: idle(v))

  def tick(v) do
    if v.now >= Vehicle.own(v, :prearm_at, @prearm_every_us) do
      v = Vehicle.put_own(v, :prearm_at, v.now + @prearm_every_us)
      # Texts are for ground stations; without one they are not sent.
      if v.gcs_heard, do: Enum.reduce(reasons(v), v, &Vehicle.text(&2, 2, "PreArm: " <> &1)), else: v
    else
      v
    end
  end

  defp mandatory(v) do
    position? = Modes.requires_position?(v.mode)

    for {true, text} <- [
          {v.now < min(3_000_000, v.ready_us), "Gyros not calibrated"},
          {position? and Telemetry.Position.gps_fix(v) < 3, "GPS 1: Bad fix"},
          {position? and not Vehicle.positioned?(v), "Need Position Estimate"}
        ],
        do: text
  end

  # Checked last, and only on an attempt to arm.
  defp mode(v), do: if(Modes.armable?(v.mode), do: [], else: ["#{v.mode} mode not armable"])

  defp battery?(v) do
    v.failsafes |> MapSet.intersection(MapSet.new([:battery, :battery_critical])) |> MapSet.size() > 0 or
      Battery.remaining(v.battery) * v.battery.capacity_mah <= Params.get(v.params, "BATT_CRT_MAH")
  end

  defp armed(v) do
    v
    |> Vehicle.emit(%M.GpsGlobalOrigin{
      latitude: v.origin.lat,
      longitude: v.origin.lon,
      altitude: Geo.millimetres(v.origin.alt),
      time_usec: v.now
    })
    |> Vehicle.text(6, "Arming motors")
    |> home_here()
    |> Vehicle.arm()
    |> Vehicle.put_own(:idle_since, v.now)
  end

  # Home is where the vehicle is armed, unless somebody set it.
  defp home_here(%{home: nil} = v), do: v

  defp home_here(v) do
    if Vehicle.own(v, :home_locked) do
      v
    else
      {lat, lon} = Vehicle.position(v)
      v = %{v | home: %{lat: lat, lon: lon, alt: Vehicle.altitude(v)}}
      Vehicle.emit(v, Telemetry.message(v, id(HomePosition)))
    end
  end

  defp idle(%{airborne: false, flight: :idle} = v) do
    since = Vehicle.own(v, :idle_since) || v.now
    delay = Params.get(v.params, "DISARM_DELAY")

    if delay > 0 and v.now - since >= delay * 1_000_000,
      do: stop(v),
      else: Vehicle.put_own(v, :idle_since, since)
  end

  defp idle(v), do: if(Vehicle.own(v, :idle_since), do: Vehicle.put_own(v, :idle_since, nil), else: v)
end
