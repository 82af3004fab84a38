defmodule Aerie.Vehicle.Firmware.Px4.Room do
  @moduledoc """
  PX4. Planes circle with NAV_LOITER_RAD unless the message gives a radius, and climb to MIS_LND_ABRT_ALT above a
  landing that is aborted; each vehicle turns within its acceptance radius, that of the item or NAV_ACC_RAD
  (`MissionBlock`).
  """

  @behaviour Aerie.Vehicle.Firmware.Room

  alias Aerie.Vehicle.Firmware.Room

  @impl true
  def params(kind) when kind in ["plane", "vtol"], do: ~w(MIS_LND_ABRT_ALT NAV_ACC_RAD NAV_LOITER_RAD)
  def params(kind) when kind in ["copter", "rover", "boat", "unknown"], do: ["NAV_ACC_RAD"]
  def params(_kind), do: []

  @impl true
  def room({:pass, acceptance, _beyond}, kind, params) do
    Room.larger([
      if(Room.winged?(kind), do: circle(nil, params), else: Room.none()),
      Room.by("it turns within ", ["NAV_ACC_RAD"], params),
      Room.given(acceptance, "it turns within its acceptance radius")
    ])
  end

  def room(sweep, kind, params),
    do: if(Room.winged?(kind), do: winged(sweep, kind, params), else: hovering(sweep))

  defp hovering({kind, radius}) when kind in [:stay, :turns] and is_number(radius),
    do: Room.given(radius, "it circles there with that radius")

  defp hovering(_stays), do: Room.none()

  defp winged({:land, abort}, _kind, params) do
    %{metres: metres} = Room.by("", ["MIS_LND_ABRT_ALT"], params)
    %{circle(nil, params) | climb: max(metres, abs(abort))}
  end

  defp winged({:takeoff, rise}, kind, params), do: Room.climbing(rise, kind, circle(nil, params))
  defp winged({_circles, radius}, _kind, params), do: circle(radius, params)

  defp circle(radius, params), do: Room.circle(radius, ["NAV_LOITER_RAD"], params)
end
