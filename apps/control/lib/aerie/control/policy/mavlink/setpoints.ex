defmodule Aerie.Control.Policy.Mavlink.Setpoints do
  @moduledoc """
  SET_POSITION_TARGET_GLOBAL_INT and _LOCAL_NED: where they lead, as the vehicle's firmware reads their masks
  (`setpoints` of `Aerie.Vehicle.Firmware.Reading`).

  ArduPilot (`handle_message_set_position_target_*` of GCS_MAVLINK_Copter, _Rover, _Plane, _Sub) takes no notice of a
  position, a velocity or an acceleration of which one axis is masked. With a position and a velocity it flies to the
  place and on from there; an acceleration makes a velocity grow for as long as it is flown. A rover with a yaw or a
  rate besides drives where that points. A plane takes only the height, whatever the mask says. PX4
  (`MavlinkReceiver::handle_message_set_position_target_*`) goes by axis, and takes NaN for masked. Each reading is
  judged for an unknown firmware. Besides, the place and the velocity that the message names are judged as they are.
  """

  import Bitwise

  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Mavlink.Place
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Enums.MavFrame
  alias MavCodec.Messages, as: M

  # POSITION_TARGET_TYPEMASK
  @yaw 0x400
  @yaw_rate 0x800
  @all_but_z 0x1FB
  @local_offset MavFrame.value(:MAV_FRAME_LOCAL_OFFSET_NED)

  @doc "The facts of a set-point."
  @spec facts(struct(), Aerie.Control.Policy.Mavlink.vehicle()) :: Intent.t()
  def facts(%module{type_mask: mask} = m, vehicle) do
    [place?, velocity?, acceleration?] = for bit <- [0, 3, 6], do: Enum.any?(used(mask, bit))

    type =
      cond do
        place? and module == M.SetPositionTargetGlobalInt -> "setpoint_position"
        place? -> "setpoint_local"
        velocity? or acceleration? -> "setpoint_velocity"
        true -> "setpoint_attitude"
      end

    what = if not place? and velocity?, do: [what: Intent.drift_what()], else: []
    reading = Firmware.reading(vehicle.autopilot)
    sweep = if place? and reading.stays_at_setpoint?, do: {:stay, nil}
    ways = Map.get(reading.setpoints, vehicle.vehicle_type, reading.setpoints.any)
    readings = Enum.flat_map(ways, &read(&1, m))
    Intent.named(type, [path: path(readings ++ named(m)), sweep: sweep] ++ what)
  end

  defp named(%{type_mask: mask} = m) do
    [place?, velocity?] = for bit <- [0, 3], do: Enum.any?(used(mask, bit))
    masked = m |> place_values(true) |> axes(used(mask, 0))
    velocity = for v <- axes(velocity(m), used(mask, 3)), do: v || 0
    whole = if m |> place_values(true) |> finite?(), do: [place(m)], else: []
    places = if place?, do: whole ++ [place(m, masked)], else: []
    if velocity?, do: places ++ [drift(m, velocity, [0, 0, 0], false)], else: places
  end

  defp path(readings) do
    case readings |> Enum.reject(&(&1 == :none)) |> Enum.uniq() do
      [] -> :none
      [path] -> path
      paths -> {:all, paths}
    end
  end

  defp read(:whole, m), do: [whole(m)]
  defp read(:driven, m), do: [driven(m)]
  defp read(:by_axis, m), do: [by_axis(m)]
  defp read(:height, m), do: height(m)
  defp read(:depth, m), do: depth(m)

  # Whether each axis from this bit on is not masked.
  defp used(mask, bit), do: for(n <- 0..2, do: (mask >>> (bit + n) &&& 1) == 0)
  defp whole?(mask, bit), do: Enum.all?(used(mask, bit))

  # ArduPilot's copters and submarines.
  defp whole(%{type_mask: mask} = m) do
    turns? = (mask &&& @yaw_rate) == 0
    acceleration = if whole?(mask, 6), do: acceleration(m), else: [0, 0, 0]

    case {whole?(mask, 0), whole?(mask, 3), whole?(mask, 6)} do
      {true, true, _with_it} -> onward(place(m), drift(m, velocity(m), acceleration, turns?))
      {true, false, _useless} -> place(m)
      {false, true, _with_it} -> drift(m, velocity(m), acceleration, turns?)
      {false, false, true} -> :anywhere
      _nothing -> :none
    end
  end

  # ArduPilot's rovers and boats: a speed in a direction, which a yaw or a rate replaces.
  defp driven(%{type_mask: mask} = m) do
    steered? = (mask &&& (@yaw ||| @yaw_rate)) != (@yaw ||| @yaw_rate)

    cond do
      whole?(mask, 0) -> place(m)
      not whole?(mask, 3) -> :none
      steered? -> drift(m, velocity(m), [0, 0, 0], :any)
      true -> drift(m, velocity(m), [0, 0, 0], false)
    end
  end

  # ArduPlane: local ones change the height to which it flies by so many metres, and that height is not known.
  defp height(%M.SetPositionTargetLocalNed{coordinate_frame: @local_offset, z: z}) when z == 0, do: []
  defp height(%M.SetPositionTargetLocalNed{coordinate_frame: @local_offset}), do: [:anywhere]
  defp height(%M.SetPositionTargetLocalNed{}), do: []

  defp height(%M.SetPositionTargetGlobalInt{type_mask: mask} = m) do
    height =
      if is_number(m.alt), do: {:to, [%{lat: nil, lon: nil, height: Place.height(m.coordinate_frame, m.alt)}]}

    [height || :anywhere | if(whole?(mask, 0), do: [place(m)], else: [])]
  end

  defp depth(%M.SetPositionTargetLocalNed{} = m), do: [by_axis(%{m | type_mask: m.type_mask ||| @all_but_z})]

  defp depth(%M.SetPositionTargetGlobalInt{} = m),
    do: if(List.last(used(m.type_mask, 0)), do: height(m), else: [])

  # PX4
  defp by_axis(%{type_mask: mask} = m) do
    turns? = (mask &&& @yaw_rate) == 0
    place = axes(place_values(m, whole?(mask, 0)), used(mask, 0))
    velocity = axes(velocity(m), used(mask, 3))
    acceleration = axes(acceleration(m), used(mask, 6))
    axes = Enum.zip([place, velocity, acceleration])

    cond do
      :infinite in (place ++ velocity ++ acceleration) -> :anywhere
      Enum.any?(axes, &match?({nil, nil, a} when a != nil, &1)) -> :anywhere
      place == [nil, nil, nil] and velocity == [nil, nil, nil] -> :none
      place == [nil, nil, nil] -> drift(m, led(axes), [0, 0, 0], turns?)
      velocity ++ acceleration == List.duplicate(nil, 6) -> place(m, place)
      true -> onward(place(m, place), drift(m, led(axes), [0, 0, 0], turns?))
    end
  end

  # The controller corrects the effect of an acceleration on a requested velocity within a second.
  defp led(axes), do: for({_place, v, a} <- axes, do: (v || 0) + (a || 0))

  defp axes(values, used) do
    for {value, used?} <- Enum.zip(values, used) do
      cond do
        not used? -> nil
        is_number(value) -> value
        value in [:infinity, :neg_infinity] -> :infinite
        true -> nil
      end
    end
  end

  # A global position counts as a whole or not at all.
  defp place_values(%M.SetPositionTargetGlobalInt{}, false), do: [:nan, :nan, :nan]
  defp place_values(%M.SetPositionTargetGlobalInt{} = m, true), do: [m.lat_int, m.lon_int, m.alt]
  defp place_values(m, _whole?), do: [m.x, m.y, m.z]

  defp velocity(m), do: [m.vx, m.vy, m.vz]
  defp acceleration(m), do: [m.afx, m.afy, m.afz]

  defp place(%M.SetPositionTargetGlobalInt{} = m) do
    if is_number(m.alt),
      do: {:to, [Place.int(m.lat_int, m.lon_int, Place.height(m.coordinate_frame, m.alt))]},
      else: :anywhere
  end

  defp place(m),
    do: if(finite?([m.x, m.y, m.z]), do: Place.local(m.coordinate_frame, {m.x, m.y, m.z}), else: :anywhere)

  # Axes that are nil stay as they are.
  defp place(m, axes) do
    cond do
      :infinite in axes -> :anywhere
      Enum.all?(axes, &(&1 == nil)) -> :none
      is_struct(m, M.SetPositionTargetGlobalInt) -> global(m, axes)
      true -> Place.local(m.coordinate_frame, List.to_tuple(axes))
    end
  end

  defp global(m, [lat, lon, alt]) do
    height = if alt, do: Place.height(m.coordinate_frame, alt), else: :same
    {:to, [%{lat: lat && lat / 1.0e7, lon: lon && lon / 1.0e7, height: height}]}
  end

  defp onward(:anywhere, _drift), do: :anywhere
  defp onward(:none, drift), do: drift
  defp onward(_path, :anywhere), do: :anywhere
  defp onward(path, {:drift, drift}), do: {:onward, path, drift}

  defp drift(m, [_x, _y, _down] = velocity, acceleration, turns) do
    frame =
      case {Place.axes(m.coordinate_frame), turns} do
        {nil, _turns} -> nil
        {_axes, :any} -> :any
        # Its nose turns, and with it what is ahead.
        {:body, true} -> :any
        {axes, _straight} -> axes
      end

    if frame != nil and finite?(velocity ++ acceleration),
      do: {:drift, Intent.drift(frame, List.to_tuple(velocity), acceleration: List.to_tuple(acceleration))},
      else: :anywhere
  end

  defp finite?(values), do: Enum.all?(values, &is_number/1)
end
