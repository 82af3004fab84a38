defmodule Aerie.Policy.Raw.Setpoints do
  @moduledoc """
  SET_POSITION_TARGET_GLOBAL_INT and _LOCAL_NED: where they lead by their masks. ArduPilot takes no notice of a position (a velocity, an
  acceleration) of which one axis is masked, PX4 goes by axis. So whatever one of them may obey is judged: the position as it is, with
  the masked axes as they are now, the velocity, and the acceleration, which leads anywhere.
  """

  import Bitwise

  alias Aerie.Policy.Facts
  alias Aerie.Policy.Raw.Place
  alias MavCodec.Messages, as: M

  @drift "where that velocity leads within 3 s"

  @doc "The facts of a set-point."
  @spec facts(struct()) :: Facts.t()
  def facts(%module{type_mask: mask} = m) do
    position = if meant?(mask, 0), do: position(m, axes(mask, 0)), else: []
    velocity = if meant?(mask, 3), do: [velocity(m, axes(mask, 3))], else: []
    # With a whole position or velocity, an acceleration only smoothes the way there.
    led? = Enum.all?(axes(mask, 0)) or Enum.all?(axes(mask, 3))
    acceleration = if meant?(mask, 6) and not led?, do: [:anywhere], else: []

    type =
      cond do
        position != [] and module == M.SetPositionTargetGlobalInt -> "setpoint_position"
        position != [] -> "setpoint_local"
        velocity != [] or acceleration != [] -> "setpoint_velocity"
        true -> "setpoint_attitude"
      end

    what = if position == [] and velocity != [], do: [what: @drift], else: []
    Facts.named(type, [path: path(position ++ velocity ++ acceleration)] ++ what)
  end

  defp path([]), do: :none
  defp path([path]), do: path
  defp path(paths), do: {:all, paths}

  # Whether an axis from this bit on is not masked.
  defp meant?(mask, bit), do: (mask >>> bit &&& 0b111) != 0b111

  defp axes(mask, bit), do: for(n <- 0..2, do: (mask >>> (bit + n) &&& 1) == 0)

  defp position(%M.SetPositionTargetGlobalInt{} = m, [lat?, lon?, alt?]) do
    whole = Place.int(m.lat_int, m.lon_int, Place.height(m.coordinate_frame, m.alt))

    masked = %{
      lat: if(lat?, do: whole.lat),
      lon: if(lon?, do: whole.lon),
      height: if(alt?, do: whole.height, else: :same)
    }

    for place <- Enum.uniq([whole, masked]), do: {:to, [place]}
  end

  defp position(%M.SetPositionTargetLocalNed{} = m, [x?, y?, z?]) do
    whole = Place.local(m.coordinate_frame, {m.x, m.y, m.z})
    masked = Place.local(m.coordinate_frame, {if(x?, do: m.x), if(y?, do: m.y), if(z?, do: m.z)})
    Enum.uniq([whole, masked])
  end

  defp velocity(m, [x?, y?, z?]),
    do: Place.drift(m.coordinate_frame, {if(x?, do: m.vx), if(y?, do: m.vy), if(z?, do: m.vz)})
end
