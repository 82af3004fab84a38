defmodule Aerie.Vehicle.Firmware.Telemetry do
  @moduledoc """
  Where the messages of a firmware say other things than MAVLink declares, or more. The defaults are those of an unknown
  one.
  """

  defstruct rssi_full: 254,
            unknown_current: nil,
            high_latency_shift: 0,
            high_latency_armed?: false,
            rotor_modes: [],
            status_flies?: false,
            detects_landing?: false,
            height_apart?: false,
            arming_texts?: false

  @typedoc """
    * `:rssi_full` - the `rssi` of RC_CHANNELS at full strength
    * `:unknown_current` - the `current_battery` of BATTERY_STATUS that means "unknown", besides -1
    * `:high_latency_shift` - by how many bits the mode in HIGH_LATENCY2 was shifted to fit into it
    * `:high_latency_armed?` - whether `custom0` of HIGH_LATENCY2 is the base mode, which says whether it is armed
    * `:rotor_modes` - modes that a plane enters only if it has rotors besides its wings
    * `:status_flies?` - whether the heartbeat's ACTIVE means that it flies, and STANDBY that it does not
    * `:detects_landing?` - whether it detects landings itself; one that does not may be falling when it is disarmed
    * `:height_apart?` - whether the height is in ALTITUDE, because GLOBAL_POSITION_INT cannot leave it out
    * `:arming_texts?` - whether a text "Arming disabled: …" names all that keeps it from being armed
  """
  @type t :: %__MODULE__{}
end
