defmodule Aerie.Vehicle.State.Mode do
  @moduledoc "What the autopilot is doing: mode, armed, failsafe from its HEARTBEAT, landed from EXTENDED_SYS_STATE."
  @behaviour Aerie.Vehicle.State

  import Bitwise

  alias Aerie.Vehicle.{Kind, Modes, State}
  alias MavCodec.Enums.{MavLandedState, MavState, MavVtolState}
  alias MavCodec.Messages, as: M

  @safety_armed 0x80
  # MAV_STATE_CRITICAL, MAV_STATE_EMERGENCY: both firmwares show a failsafe in charge that way.
  @failsafe [5, 6]

  @impl State
  def read(%M.Heartbeat{} = m, _state, _at) do
    autopilot = Kind.autopilot(m.autopilot)
    kind = Kind.name(m.type)

    fields = [autopilot: autopilot, type: m.type, kind: kind, base_mode: m.base_mode, high_latency: false]

    {fields,
     mode: %{
       mode: Modes.name(autopilot, kind, m.base_mode, m.custom_mode),
       custom_mode: m.custom_mode,
       armed: (m.base_mode &&& @safety_armed) != 0,
       system_status: MavState.label(m.system_status) || "STATE(#{m.system_status})",
       failsafe: m.system_status in @failsafe
     }}
  end

  def read(%M.ExtendedSysState{} = m, _state, at) do
    {[landed: {m.landed_state, at}],
     mode: %{
       landed_state: known(MavLandedState, m.landed_state),
       vtol_state: known(MavVtolState, m.vtol_state)
     }}
  end

  defp known(_enum, 0), do: nil
  defp known(enum, value), do: enum.label(value) || Integer.to_string(value)
end
