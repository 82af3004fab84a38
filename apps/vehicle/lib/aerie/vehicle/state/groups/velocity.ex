defmodule Aerie.Vehicle.State.Groups.Velocity do
  @moduledoc "The vehicle's velocity, and its throttle."

  alias Aerie.Vehicle.State.{Group, Value}
  alias MavCodec.Messages, as: M

  use Group,
    name: :velocity,
    title: "The vehicle's velocity.",
    sampling: {:time, 1.0, %{}, 30.0},
    messages: [M.VfrHud, {M.LocalPositionNed, M.GlobalPositionInt}],
    fields: [
      {:vn, 2, "m/s", "to the north", "GLOBAL_POSITION_INT, LOCAL_POSITION_NED"},
      {:ve, 2, "m/s", "to the east", "GLOBAL_POSITION_INT, LOCAL_POSITION_NED"},
      {:vd, 2, "m/s", "down", "GLOBAL_POSITION_INT, LOCAL_POSITION_NED"},
      {:groundspeed, 2, "m/s", "over the ground", "VFR_HUD, HIGH_LATENCY2"},
      {:airspeed, 2, "m/s", "through the air", "VFR_HUD, HIGH_LATENCY2"},
      {:climb, 2, "m/s", "up", "VFR_HUD, HIGH_LATENCY2"},
      {:throttle, 2, "0..1", "ratio of full throttle", "VFR_HUD, HIGH_LATENCY2"}
    ]

  @impl Group
  def read(%M.LocalPositionNed{} = m, _state, _at) do
    {[], velocity: %{vn: Value.float(m.vx), ve: Value.float(m.vy), vd: Value.float(m.vz)}}
  end

  def read(%M.VfrHud{} = m, _state, _at) do
    {[],
     velocity: %{
       groundspeed: Value.float(m.groundspeed),
       airspeed: Value.float(m.airspeed),
       climb: Value.float(m.climb),
       throttle: Value.up_to(m.throttle, 100, 100)
     }}
  end
end
