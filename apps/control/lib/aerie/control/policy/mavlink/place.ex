defmodule Aerie.Control.Policy.Mavlink.Place do
  @moduledoc "Positions as MAVLink has them, as places of `Aerie.Control.Policy.Intent`."

  alias Aerie.Control.Policy.Intent
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Enums.MavFrame
  alias MavCodec.Messages, as: M

  @unset 0x7FFFFFFF
  frames = fn names -> Enum.map(names, &MavFrame.value(:"MAV_FRAME_#{&1}")) end
  @msl frames.(~w(GLOBAL GLOBAL_INT))
  @home frames.(~w(GLOBAL_RELATIVE_ALT GLOBAL_RELATIVE_ALT_INT))
  @terrain frames.(~w(GLOBAL_TERRAIN_ALT GLOBAL_TERRAIN_ALT_INT))
  @local frames.(~w(LOCAL_NED))
  @body frames.(~w(BODY_NED BODY_OFFSET_NED BODY_FRD))
  @shift frames.(~w(LOCAL_OFFSET_NED))

  @doc "The place of a mission item or of COMMAND_INT."
  @spec of(struct()) :: Intent.place()
  def of(%M.MissionItem{x: lat, y: lon} = m), do: floats(lat, lon, height(m.frame, m.z))

  def of(%{x: lat, y: lon} = m), do: int(lat, lon, height(m.frame, m.z))

  @doc """
  The place of an item of a mission: to some firmwares, latitude and longitude 0 mean where the vehicle is (a take-off,
  mostly). To others they are a place, and to an unknown firmware they may be.
  """
  @spec item(struct(), Aerie.Control.Policy.Mavlink.vehicle()) :: Intent.place()
  def item(message, vehicle) do
    place = of(message)
    if Firmware.reading(vehicle.autopilot).zero_place == :here, do: here(place), else: place
  end

  @doc "The same place, or where the vehicle is if latitude and longitude are 0."
  @spec here(Intent.place()) :: Intent.place()
  def here(%{lat: lat, lon: lon} = place) when lat == 0 and lon == 0, do: %{place | lat: nil, lon: nil}
  def here(place), do: place

  @doc "A place in 1e-7 degrees; the largest number means where the vehicle is."
  @spec int(integer(), integer(), Intent.height()) :: Intent.place()
  def int(@unset, @unset, height), do: %{lat: nil, lon: nil, height: height}
  def int(lat, lon, height), do: %{lat: lat / 1.0e7, lon: lon / 1.0e7, height: height}

  @doc "A place in degrees; two NaNs mean where the vehicle is, and one counts as 0."
  @spec floats(term(), term(), Intent.height()) :: Intent.place()
  def floats(lat, lon, height) do
    if is_number(lat) or is_number(lon),
      do: %{lat: number(lat), lon: number(lon), height: height},
      else: %{lat: nil, lon: nil, height: height}
  end

  @doc "A height in a frame. What it is above in any other frame is not known, as above the ground."
  @spec height(integer(), term()) :: Intent.height()
  def height(_frame, metres) when not is_number(metres), do: :same
  def height(frame, metres) when frame in @msl, do: {:msl, metres}
  def height(frame, metres) when frame in @home, do: {:home, metres}
  def height(_frame, metres), do: {:terrain, metres}

  @doc "The path of a local set-point: from home, or from where the vehicle is. An axis that is nil stays as it is."
  @spec local(integer(), {term(), term(), term()}) :: Intent.path()
  def local(frame, {x, y, z}) when frame in @local, do: {:offset, {axis(x), axis(y), axis(z)}}

  def local(frame, {x, y, z}) do
    case axes(frame) do
      nil -> :anywhere
      axes -> {:shift, axes, {number(x), number(y), number(z)}}
    end
  end

  @doc "Whether x is to the north or ahead in a frame, nil for one in which each firmware has its own opinion."
  @spec axes(integer()) :: :north | :body | nil
  def axes(frame) when frame in @body, do: :body

  def axes(frame)
      when frame in @local or frame in @shift or frame in @msl or frame in @home or frame in @terrain,
      do: :north

  def axes(_frame), do: nil

  defp axis(value) when is_number(value), do: value
  defp axis(_not_finite), do: nil

  @doc "A number, 0 for anything else."
  @spec number(term()) :: number()
  def number(value) when is_number(value), do: value
  def number(_not_finite), do: 0.0
end
