defmodule Aerie.Vehicle.State.Mode do
  @moduledoc "What the autopilot is doing: mode, armed, failsafe from its HEARTBEAT, landed from EXTENDED_SYS_STATE, names of modes from AVAILABLE_MODES."
  @behaviour Aerie.Vehicle.State

  import Bitwise

  alias Aerie.Vehicle.{Kind, Modes, State}
  alias MavCodec.Enums.{MavLandedState, MavState, MavVtolState}
  alias MavCodec.Messages, as: M

  @safety_armed 0x80
  # MAV_STATE_CRITICAL, MAV_STATE_EMERGENCY: both firmwares show a failsafe in charge that way.
  @failsafe [5, 6]
  @max_names 64

  @impl State
  def read(%M.Heartbeat{} = m, state, _at) do
    autopilot = Kind.autopilot(m.autopilot)
    kind = Kind.name(m.type)

    fields = [autopilot: autopilot, type: m.type, kind: kind, base_mode: m.base_mode, high_latency: false]

    {fields,
     mode: %{
       mode: named(Modes.name(autopilot, kind, m.base_mode, m.custom_mode), m.custom_mode, state.mode_names),
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

  # A mode that an application brought along (PX4's external modes, ArduPilot's scripts) has the name that it gave itself.
  def read(%M.AvailableModes{custom_mode: mode} = m, state, _at) do
    name = m.mode_name |> String.replace_invalid() |> String.trim()

    if name == "" or (map_size(state.mode_names) >= @max_names and not is_map_key(state.mode_names, mode)) do
      {[], []}
    else
      names = Map.put(state.mode_names, mode, name)
      now = State.data(state, :mode)
      shown = if now.custom_mode == mode, do: named(now.mode, mode, names)
      {[mode_names: names], if(shown != nil and shown != now.mode, do: [mode: %{mode: shown}], else: [])}
    end
  end

  defp named(name, mode, names), do: if(Modes.unnamed?(name), do: Map.get(names, mode, name), else: name)

  defp known(_enum, 0), do: nil
  defp known(enum, value), do: enum.label(value) || Integer.to_string(value)
end
