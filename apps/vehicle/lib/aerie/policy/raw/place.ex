defmodule Aerie.Policy.Raw.Place do
  @moduledoc "Positions as MAVLink has them, as places of `Aerie.Policy.Facts`."

  alias Aerie.Policy.Facts
  alias MavCodec.Enums.MavFrame
  alias MavCodec.Messages, as: M

  @unset 0x7FFFFFFF
  frames = fn names -> Enum.map(names, &MavFrame.value(:"MAV_FRAME_#{&1}")) end
  @msl frames.(~w(GLOBAL GLOBAL_INT))
  @home frames.(~w(GLOBAL_RELATIVE_ALT GLOBAL_RELATIVE_ALT_INT))
  @local frames.(~w(LOCAL_NED))
  @body frames.(~w(BODY_NED BODY_OFFSET_NED BODY_FRD))

  @doc "The place of a mission item or of COMMAND_INT."
  @spec of(struct()) :: Facts.place()
  def of(%M.MissionItem{x: lat, y: lon} = m),
    do: %{lat: finite(lat), lon: finite(lon), height: height(m.frame, m.z)}

  def of(%{x: lat, y: lon} = m), do: int(lat, lon, height(m.frame, m.z))

  @doc "The place of an item of a mission: latitude and longitude 0 mean where the vehicle is (a take-off, mostly)."
  @spec item(struct()) :: Facts.place()
  def item(message) do
    case of(message) do
      %{lat: lat, lon: lon} = place when lat == 0 and lon == 0 -> %{place | lat: nil, lon: nil}
      place -> place
    end
  end

  @doc "A place in 1e-7 degrees; the largest number means where the vehicle is."
  @spec int(integer(), integer(), Facts.height()) :: Facts.place()
  def int(lat, lon, height), do: %{lat: degrees(lat), lon: degrees(lon), height: height}

  @doc "A height in a frame. What it is above in any other frame is not known, as above the ground."
  @spec height(integer(), term()) :: Facts.height()
  def height(_frame, metres) when not is_number(metres), do: :same
  def height(frame, metres) when frame in @msl, do: {:msl, metres}
  def height(frame, metres) when frame in @home, do: {:home, metres}
  def height(_frame, metres), do: {:terrain, metres}

  @doc "The path of a local set-point: from home, or from where the vehicle is."
  @spec local(integer(), {term(), term(), term()}) :: tuple()
  def local(frame, {x, y, z}) do
    metres = {number(x), number(y), number(z)}
    if frame in @local, do: {:offset, metres}, else: {:shift, axes(frame), metres}
  end

  @doc "The facts of FOLLOW_TARGET: a vehicle that follows goes there."
  @spec follow(struct()) :: Facts.t()
  def follow(%M.FollowTarget{lat: lat, lon: lon, alt: metres}) do
    %Facts{
      type: "follow_target",
      permission: :fly,
      moves?: true,
      path: {:to, [int(lat, lon, {:msl, number(metres)})]},
      what: "the place of who is followed"
    }
  end

  @doc "Whether x is to the north or ahead."
  @spec axes(integer()) :: :north | :body
  def axes(frame) when frame in @body, do: :body
  def axes(_frame), do: :north

  @doc "A number, 0 for what is none."
  @spec number(term()) :: number()
  def number(value) when is_number(value), do: value
  def number(_not_finite), do: 0.0

  @doc "A number, nil for what is none."
  @spec finite(term()) :: number() | nil
  def finite(value) when is_number(value), do: value
  def finite(_not_finite), do: nil

  defp degrees(@unset), do: nil
  defp degrees(value), do: value / 1.0e7
end
