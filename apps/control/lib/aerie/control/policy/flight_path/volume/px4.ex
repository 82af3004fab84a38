defmodule Aerie.Control.Policy.FlightPath.Volume.Px4 do
  @moduledoc """
  PX4. Planes circle with NAV_LOITER_RAD unless the message gives a radius, and climb to MIS_LND_ABRT_ALT above a
  landing that is aborted; each vehicle turns within its acceptance radius, that of the item or NAV_ACC_RAD
  (`MissionBlock`).
  """

  alias Aerie.Control.Policy.FlightPath.Volume

  @behaviour Volume

  @impl Volume
  def room({:pass, acceptance, _beyond}, kind, params) do
    Volume.larger([
      if(Volume.winged?(kind), do: circle(nil, params), else: Volume.none()),
      Volume.by("it turns within ", ["NAV_ACC_RAD"], params),
      Volume.given(acceptance, "it turns within its acceptance radius")
    ])
  end

  def room(sweep, kind, params),
    do: if(Volume.winged?(kind), do: winged(sweep, kind, params), else: hovering(sweep))

  defp hovering({kind, radius}) when kind in [:stay, :turns] and is_number(radius),
    do: Volume.given(radius, "it circles there with that radius")

  defp hovering(_stays), do: Volume.none()

  defp winged({:land, abort}, _kind, params) do
    %{metres: metres} = Volume.by("", ["MIS_LND_ABRT_ALT"], params)
    %{circle(nil, params) | climb: max(metres, abs(abort))}
  end

  defp winged({:takeoff, rise}, kind, params), do: Volume.climbing(rise, kind, circle(nil, params))
  defp winged({_circles, radius}, _kind, params), do: circle(radius, params)

  defp circle(radius, params), do: Volume.circle(radius, ["NAV_LOITER_RAD"], params)
end
