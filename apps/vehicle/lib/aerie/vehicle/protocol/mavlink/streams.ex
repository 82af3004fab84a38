defmodule Aerie.Vehicle.Protocol.Mavlink.Streams do
  @moduledoc """
  Commands that are repeated for a while: overrides of the remote control, joysticks and set-points (X7, X8). The vehicle does not answer
  them; when they stop, it does what its parameters say.
  """

  import Bitwise

  alias Aerie.Vehicle.Protocol.{Mavlink, Step, Vehicle}
  alias MavCodec.Messages, as: M

  # POSITION_TARGET_TYPEMASK
  @ignore_position 0x007
  @ignore_velocity 0x038
  @ignore_acceleration 0x1C0
  @ignore_yaw 0x400
  @ignore_yaw_rate 0x800
  # ATTITUDE_TARGET_TYPEMASK: body rates
  @ignore_rates 0x07

  @local_ned 1
  @body_ned 8
  @global 5
  @global_relative 6
  @global_terrain 11
  @radians :math.pi() / 180

  # RC_CHANNELS_OVERRIDE: channels 1-8 are left alone by 65535 and released by 0, the others by 0 and 65534.
  @channels 18
  @leave 65_535
  @release_high 65_534

  @doc "The steps of such a command; nil for any other."
  @spec steps(String.t(), map(), Vehicle.t()) :: [Step.t()] | nil
  def steps("rc_override", params, _vehicle) do
    message = channels(params.channels, fn n, us -> if us == 0, do: left_alone(n), else: us end)
    given_back = channels(params.channels, fn n, us -> if us == 0, do: left_alone(n), else: released(n) end)
    stream(message, params, {:message, given_back})
  end

  def steps("manual_control", params, _vehicle) do
    %M.ManualControl{
      x: axis(params.pitch),
      y: axis(params.roll),
      z: axis(params.throttle),
      r: axis(params.yaw),
      buttons: params.buttons
    }
    |> stream(params)
  end

  def steps("setpoint_local", params, _vehicle) do
    %M.SetPositionTargetLocalNed{
      coordinate_frame: @local_ned,
      type_mask: place_mask(params),
      x: params.north,
      y: params.east,
      z: params.down,
      yaw: yaw(params)
    }
    |> stream(params)
  end

  def steps("setpoint_velocity", params, _vehicle) do
    rate = params[:yaw_rate]

    %M.SetPositionTargetLocalNed{
      coordinate_frame: if(params.frame == "body", do: @body_ned, else: @local_ned),
      type_mask:
        @ignore_position ||| @ignore_acceleration ||| @ignore_yaw |||
          if(rate, do: 0, else: @ignore_yaw_rate),
      vx: params.vx,
      vy: params.vy,
      vz: params.vz,
      yaw_rate: (rate || 0.0) * @radians
    }
    |> stream(params)
  end

  def steps("setpoint_attitude", params, _vehicle) do
    %M.SetAttitudeTarget{
      type_mask: @ignore_rates,
      q: quaternion(params.roll * @radians, params.pitch * @radians, params.yaw * @radians),
      thrust: params.thrust
    }
    |> stream(params)
  end

  def steps(_type, _params, _vehicle), do: nil

  @doc "The steps of `setpoint_position`, with the height in one of MAVLink's frames."
  @spec position(map(), frame :: non_neg_integer(), altitude :: float()) :: [Step.t()]
  def position(params, frame, altitude) do
    %M.SetPositionTargetGlobalInt{
      coordinate_frame: frame,
      type_mask: place_mask(params),
      lat_int: round(params.lat * 1.0e7),
      lon_int: round(params.lon * 1.0e7),
      alt: altitude,
      yaw: yaw(params)
    }
    |> stream(params)
  end

  @doc "MAV_FRAME of a height's reference."
  @spec frame(String.t()) :: non_neg_integer()
  def frame("home"), do: @global_relative
  def frame("msl"), do: @global
  def frame("terrain"), do: @global_terrain

  defp stream(message, params, release \\ nil) do
    step = Mavlink.message(message)
    stream = %{hz: params.rate, ms: round(params.hold * 1000), release: release}
    # Any set-point replaces the one before it, of whatever kind.
    [%{step | key: {nil, :stream}, stream: stream}]
  end

  defp place_mask(params),
    do:
      @ignore_velocity ||| @ignore_acceleration ||| @ignore_yaw_rate |||
        if(params[:yaw], do: 0, else: @ignore_yaw)

  defp yaw(params), do: (params[:yaw] || 0.0) * @radians
  defp axis(share), do: round(share * 1000)

  defp channels(given, value) do
    fields =
      given
      |> Stream.concat(Stream.cycle([0]))
      |> Stream.take(@channels)
      |> Stream.with_index(1)
      |> Map.new(fn {us, n} -> {field(n), value.(n, us)} end)

    struct!(M.RcChannelsOverride, fields)
  end

  for n <- 1..@channels, do: defp(field(unquote(n)), do: unquote(:"chan#{n}_raw"))

  defp left_alone(n), do: if(n <= 8, do: @leave, else: 0)
  defp released(n), do: if(n <= 8, do: 0, else: @release_high)

  # Yaw, then pitch, then roll; w first.
  defp quaternion(roll, pitch, yaw) do
    {cr, sr} = half(roll)
    {cp, sp} = half(pitch)
    {cy, sy} = half(yaw)

    [
      cr * cp * cy + sr * sp * sy,
      sr * cp * cy - cr * sp * sy,
      cr * sp * cy + sr * cp * sy,
      cr * cp * sy - sr * sp * cy
    ]
  end

  defp half(angle), do: {:math.cos(angle / 2), :math.sin(angle / 2)}
end
