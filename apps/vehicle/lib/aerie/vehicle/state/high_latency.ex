defmodule Aerie.Vehicle.State.HighLatency do
  @moduledoc """
  HIGH_LATENCY2, which is all that comes over a satellite link (X6): a summary without a heartbeat.

  It does not say whether the vehicle is armed.
  """
  @behaviour Aerie.Vehicle.State

  import Bitwise

  alias Aerie.Vehicle.{Kind, Modes, State, Value}
  alias MavCodec.Messages, as: M

  @impl State
  def read(%M.HighLatency2{} = m, _state, _at) do
    with {lat, lon} <- Value.lat_lon(m.latitude, m.longitude) || {nil, nil} do
      autopilot = Kind.autopilot(m.autopilot)
      kind = Kind.name(m.type)
      # Sixteen bits of the mode: PX4 sends the upper half, where its main and sub modes are.
      mode = if autopilot == :px4, do: m.custom_mode <<< 16, else: m.custom_mode

      {[autopilot: autopilot, type: m.type, kind: kind, high_latency: true],
       [
         mode: %{mode: Modes.name(autopilot, kind, 1, mode), custom_mode: mode},
         position: %{lat: lat, lon: lon, alt_msl: m.altitude * 1.0, heading: m.heading * 2.0},
         velocity: %{groundspeed: m.groundspeed / 5, airspeed: m.airspeed / 5, climb: m.climb_rate / 10},
         battery: %{remaining: if(m.battery in 0..100, do: m.battery / 100)}
       ]}
    else
      :invalid -> {:invalid, :high_latency2}
    end
  end
end
