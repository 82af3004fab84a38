defmodule Aerie.Vehicle.Protocol.Msp do
  @moduledoc """
  Betaflight and iNav, which the gateway reaches over MSP (`Msp.Session`). The session takes commands as MAVLink and acknowledges them with what
  the flight controller said.

  MSP has no message for arming, for a mode, or for flying somewhere: the pilot's switches do that, or channels in their place, which the
  gateway does not send.
  """

  use Aerie.Vehicle.Protocol.Mavlink.Commands, calibration: __MODULE__.Calibration, long_frames: []

  alias Aerie.Vehicle.Protocol.{Mavlink, Unknown}
  alias Aerie.Vehicle.Protocol.Mavlink.Commands
  alias Aerie.Vehicle.Protocol.Msp.StoredItem

  @switches "MSP has no message for it: the switches of the transmitter do that, and Aerie sends no channels in their place"
  @by_switch ~w(arm disarm force_disarm set_mode rtl hold)
  # What the firmware, or one of the two, could do.
  @not_yet ~w(motor_test rc_override manual_control rx_pair reset_params mission_start mission_pause mission_set_current resume set_home goto
    camera_trigger)
  @has ~w(reboot save_params calibrate request_message set_message_interval)
  # Writing the EEPROM takes up to two seconds.
  @slow_ms 6_000

  @impl true
  def gap(type, _kind) when type in @has, do: nil
  def gap(type, _kind) when type in @by_switch, do: @switches
  def gap(type, _kind) when type in @not_yet, do: "Aerie does not do it over MSP yet"
  def gap(_type, _kind), do: "Betaflight and iNav have no such command over MSP"

  @impl true
  def steps(%{type: "reboot", params: %{to: "bootloader"}}, _vehicle),
    do: {:error, "a boot loader does not speak MSP: the vehicle would be gone until somebody goes to it"}

  def steps(%{type: "calibrate", params: %{sensor: sensor}}, _vehicle) do
    case sensor do
      sensor when sensor in ["accelerometer", "magnetometer"] ->
        {:ok, [Commands.preflight(sensor, answer_ms: @slow_ms)]}

      other ->
        {:error, "MSP calibrates the accelerometer and the magnetometer, not #{other}"}
    end
  end

  def steps(%{type: "save_params", params: %{what: what}}, _vehicle) do
    number = %{"params" => 1, "mission" => 2}[what]
    {:ok, [Mavlink.long(:MAV_CMD_PREFLIGHT_STORAGE, %{number => 1}, answer_ms: @slow_ms)]}
  end

  def steps(%{type: type, params: params}, vehicle), do: {:ok, Commands.steps(type, params, vehicle)}

  @impl true
  def param_encoding, do: :c_cast

  # There are no set-points yet.
  @impl true
  defdelegate setpoints_first?(command, vehicle), to: Unknown
  @impl true
  def home_is_item_0?, do: false
  @impl true
  def item_offset, do: -1
  @impl true
  def kept(item, mission_type, _kind), do: StoredItem.kept(item, mission_type)
  # The session acknowledges a plan after it has read it.
  @impl true
  defdelegate plan_watch_us(mission_type), to: Unknown
  @impl true
  defdelegate plan_verdict(message, mission_type, opaque_id), to: Unknown

  defmodule Calibration do
    @moduledoc false
    # The acknowledgement says that it began; nothing in MSP says how it goes.
    def read(_step, _message, _source, _vehicle), do: :ignore
    def listens(_step), do: []
  end
end
