defmodule Aerie.Vehicle.Firmware.Ardupilot.Room do
  @moduledoc """
  ArduPilot. Planes circle with WP_LOITER_RAD (`ModeGuided`, `do_loiter_*`), turn within WP_RADIUS of a waypoint or
  fly on beyond it by its third parameter (`do_nav_wp`), and climb to the first parameter of a landing that is
  aborted, 30 m if
  it is 0. Copters take no notice of these; they circle by LOITER_TURNS only, and cut corners by WPNAV_RADIUS.
  """

  @behaviour Aerie.Vehicle.Firmware.Room

  alias Aerie.Vehicle.Firmware.Room

  @wheeled ["rover", "boat"]
  @wheeled_m 10
  @abort_m 30

  @impl true
  def params(kind) when kind in ["plane", "vtol"], do: ~w(WP_LOITER_RAD WP_RADIUS)
  def params("copter"), do: ~w(CIRCLE_RADIUS CIRCLE_RADIUS_M WPNAV_RADIUS WP_RADIUS_M)
  def params(kind) when kind in @wheeled, do: ~w(LOIT_RADIUS WP_RADIUS)
  def params(_kind), do: []

  @impl true
  def room(sweep, kind, params) do
    cond do
      Room.winged?(kind) -> winged(sweep, kind, params)
      kind in @wheeled -> Room.by("it stops or turns within ", ["WP_RADIUS"], params, @wheeled_m)
      true -> hovering(sweep, params)
    end
  end

  defp hovering({kind, radius}, _params) when kind in [:stay, :turns] and is_number(radius) and radius != 0,
    do: Room.given(radius, "it circles there with that radius")

  defp hovering({:turns, _not_given}, params),
    do: Room.by("it circles there with ", ["CIRCLE_RADIUS", "CIRCLE_RADIUS_M"], params)

  defp hovering({:pass, _acceptance, _beyond}, params),
    do: Room.by("it passes within ", ["WPNAV_RADIUS", "WP_RADIUS_M"], params)

  defp hovering(_stays, _params), do: Room.none()

  defp winged({:pass, acceptance, beyond}, _kind, params) do
    Room.larger([
      circle(nil, params),
      Room.by("it turns within ", ["WP_RADIUS"], params),
      Room.given(acceptance, "it turns within its acceptance radius")
    ])
    |> Room.beyond(beyond)
  end

  defp winged({:land, abort}, _kind, params),
    do: %{circle(nil, params) | climb: if(abort == 0, do: @abort_m, else: abs(abort))}

  defp winged({:takeoff, rise}, kind, params), do: Room.climbing(rise, kind, circle(nil, params))
  defp winged({_circles, radius}, _kind, params), do: circle(radius, params)

  defp circle(radius, params), do: Room.circle(radius, ["WP_LOITER_RAD"], params)
end
