defmodule Aerie.Vehicle.State.Groups.Mode do
  @moduledoc """
  What the autopilot does: mode, arming and failsafe from HEARTBEAT, landed state from EXTENDED_SYS_STATE, names of modes from
  AVAILABLE_MODES.
  """
  import Bitwise

  alias Aerie.Vehicle.Firmware.Modes
  alias Aerie.Vehicle.{Firmware, State}
  alias Aerie.Vehicle.Protocol.Kind
  alias Aerie.Vehicle.State.Group

  alias MavCodec.Enums.{
    MavLandedState,
    MavModeFlag,
    MavStandardMode,
    MavState,
    MavVtolState
  }

  alias MavCodec.Messages, as: M

  @safety_armed MavModeFlag.value(:MAV_MODE_FLAG_SAFETY_ARMED)
  # Both firmwares show an active failsafe by these.
  @failsafe [MavState.value(:MAV_STATE_CRITICAL), MavState.value(:MAV_STATE_EMERGENCY)]
  @max_names 64

  use Group,
    name: :mode,
    title: "Mode, arming and flight state.",
    sampling: {:change, 10.0, %{}, 30.0},
    messages: [
      M.Heartbeat,
      M.ComponentInformationBasic,
      M.ExtendedSysState,
      M.AvailableModes,
      M.AvailableModesMonitor,
      M.CurrentMode
    ],
    fields: [
      {:mode, :text, nil, "name of the flight mode, which depends on firmware and type",
       "HEARTBEAT, HIGH_LATENCY2"},
      {:custom_mode, 0, nil, "the firmware's number of the mode", "HEARTBEAT, HIGH_LATENCY2"},
      {:armed, :boolean, nil, "true while the motors may turn", "HEARTBEAT, HIGH_LATENCY2 (ArduPilot)",
       metric: {"gateway_vehicle_armed", "1 while armed, 0 while not; absent while lost."}},
      {:in_air, :boolean, nil, "true while the vehicle flies",
       "EXTENDED_SYS_STATE, HEARTBEAT, else height and speed",
       metric: {"gateway_vehicle_in_air", "1 while in the air, 0 while not; absent while lost."}},
      {:landed_state, :text, nil, "MAV_LANDED_STATE", "EXTENDED_SYS_STATE"},
      {:vtol_state, :text, nil, "MAV_VTOL_STATE", "EXTENDED_SYS_STATE"},
      {:system_status, :text, nil, "MAV_STATE", "HEARTBEAT"},
      {:failsafe, :boolean, nil, "true while MAV_STATE is CRITICAL or EMERGENCY", "HEARTBEAT"}
    ]

  @impl Group
  def read(%M.Heartbeat{} = m, state, _at) do
    autopilot = Firmware.heard(m.autopilot, state.autopilot)
    named = Kind.name(m.type)
    # Only a quadplane enters one of these.
    quadplane =
      state.quadplane or
        (named == "plane" and m.custom_mode in Firmware.telemetry(autopilot).rotor_modes)

    kind = kind(named, quadplane)

    fields = [
      autopilot: autopilot,
      type: m.type,
      kind: kind,
      quadplane: quadplane,
      base_mode: m.base_mode,
      high_latency: false
    ]

    {fields,
     mode: %{
       mode: named(Modes.name(autopilot, kind, m.base_mode, m.custom_mode), m.custom_mode, state.mode_names),
       custom_mode: m.custom_mode,
       armed: (m.base_mode &&& @safety_armed) != 0,
       system_status: MavState.label(m.system_status) || "STATE(#{m.system_status})",
       failsafe: m.system_status in @failsafe
     }}
  end

  def read(%M.ExtendedSysState{} = m, state, at) do
    {[{:landed, {m.landed_state, at}} | if(m.vtol_state == 0, do: [], else: quadplane(state))],
     mode: %{
       landed_state: known(MavLandedState, m.landed_state),
       vtol_state: known(MavVtolState, m.vtol_state)
     }}
  end

  # Which of the firmwares that MAV_AUTOPILOT has no number for.
  def read(%M.ComponentInformationBasic{} = m, state, _at) do
    autopilot = Firmware.vendor(m.vendor_name)
    numbered? = Firmware.traits(state.autopilot).mav_autopilot != nil
    {if(autopilot == :generic or numbered?, do: [], else: [autopilot: autopilot]), []}
  end

  # A mode that an application registered (PX4's external modes, ArduPilot's scripts) has its own name.
  def read(%M.AvailableModes{custom_mode: mode} = m, state, _at) do
    standard = standard_modes(m, state.standard_modes)
    {fields, changes} = mode_name(m, mode, state)
    {if(standard == state.standard_modes, do: fields, else: [{:standard_modes, standard} | fields]), changes}
  end

  # A vehicle that sends one of these has AVAILABLE_MODES, and its modes changed with the number (X4).
  def read(%M.CurrentMode{}, %{modes_seq: nil}, _at), do: {[modes_seq: 0], []}
  def read(%M.CurrentMode{}, _state, _at), do: {[], []}
  def read(%M.AvailableModesMonitor{seq: seq}, %{modes_seq: seq}, _at), do: {[], []}
  def read(%M.AvailableModesMonitor{seq: seq}, _state, _at), do: {[modes_seq: seq, standard_modes: %{}], []}

  @doc "It has rotors besides its wings, as its parameter, its state or a mode say: ArduPlane's heartbeat says FIXED_WING unless Q_MAV_TYPE is set."
  @spec quadplane(State.t()) :: keyword()
  def quadplane(%{quadplane: false, kind: "plane" = kind} = state) do
    if Firmware.telemetry(state.autopilot).rotor_modes == [],
      do: [],
      else: [quadplane: true, kind: kind(kind, true)]
  end

  def quadplane(_state), do: []

  defp kind("plane", true), do: "vtol"
  defp kind(kind, _quadplane), do: kind

  defp standard_modes(%{standard_mode: 0}, known), do: known

  defp standard_modes(%{standard_mode: standard, custom_mode: mode}, known) do
    case MavStandardMode.label(standard) do
      nil -> known
      # The first of several is the firmware's choice.
      label -> Map.put_new(known, String.downcase(label), mode)
    end
  end

  defp mode_name(m, mode, state) do
    name = m.mode_name |> String.replace_invalid() |> String.trim()

    if name == "" or (map_size(state.mode_names) >= @max_names and not is_map_key(state.mode_names, mode)) do
      {[], []}
    else
      names = Map.put(state.mode_names, mode, name)
      now = Group.data(state, :mode)
      shown = if now[:custom_mode] == mode, do: named(now.mode, mode, names)
      {[mode_names: names], if(shown != nil and shown != now[:mode], do: [mode: %{mode: shown}], else: [])}
    end
  end

  defp named(name, mode, names), do: if(Modes.unnamed?(name), do: Map.get(names, mode, name), else: name)

  defp known(_enum, 0), do: nil
  defp known(enum, value), do: enum.label(value)
end
