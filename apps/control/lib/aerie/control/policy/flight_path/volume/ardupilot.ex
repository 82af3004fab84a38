defmodule Aerie.Control.Policy.FlightPath.Volume.Ardupilot do
  @moduledoc """
  ArduPilot. Planes circle with WP_LOITER_RAD (`ModeGuided`, `do_loiter_*`), turn within WP_RADIUS of a waypoint or
  fly on beyond it by its third parameter (`do_nav_wp`), and climb to the first parameter of a landing that is
  aborted, 30 m if
  it is 0. Copters take no notice of these; they circle by LOITER_TURNS only, and cut corners by WPNAV_RADIUS.
  """

  alias Aerie.Control.Policy.FlightPath.Volume

  @behaviour Volume

  @wheeled ["rover", "boat"]
  @wheeled_m 10
  @abort_m 30

  @impl Volume
  def room(sweep, kind, params) do
    cond do
      Volume.winged?(kind) -> winged(sweep, kind, params)
      kind in @wheeled -> Volume.by("it stops or turns within ", ["WP_RADIUS"], params, @wheeled_m)
      true -> hovering(sweep, params)
    end
  end

  defp hovering({kind, radius}, _params) when kind in [:stay, :turns] and is_number(radius) and radius != 0,
    do: Volume.given(radius, "it circles there with that radius")

  defp hovering({:turns, _not_given}, params),
    do: Volume.by("it circles there with ", ["CIRCLE_RADIUS", "CIRCLE_RADIUS_M"], params)

  defp hovering({:pass, _acceptance, _beyond}, params),
    do: Volume.by("it passes within ", ["WPNAV_RADIUS", "WP_RADIUS_M"], params)

  defp hovering(_stays, _params), do: Volume.none()

  defp winged({:pass, acceptance, beyond}, _kind, params) do
    Volume.larger([
      circle(nil, params),
      Volume.by("it turns within ", ["WP_RADIUS"], params),
      Volume.given(acceptance, "it turns within its acceptance radius")
    ])
    |> Volume.beyond(beyond)
  end

  defp winged({:land, abort}, _kind, params),
    do: %{circle(nil, params) | climb: if(abort == 0, do: @abort_m, else: abs(abort))}

  defp winged({:takeoff, rise}, kind, params), do: Volume.climbing(rise, kind, circle(nil, params))
  defp winged({_circles, radius}, _kind, params), do: circle(radius, params)

  defp circle(radius, params), do: Volume.circle(radius, ["WP_LOITER_RAD"], params)
end
