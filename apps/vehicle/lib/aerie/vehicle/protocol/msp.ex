defmodule Aerie.Vehicle.Protocol.Msp do
  @moduledoc """
  Betaflight and iNav, which the gateway reaches over MSP (`Msp.Session`). The session takes commands as MAVLink and acknowledges them with what
  the flight controller said.

  MSP has no message for arming, for a mode, or for flying somewhere: the pilot's switches do that.
  """

  use Aerie.Vehicle.Protocol.Mavlink.Commands, calibration: __MODULE__.Calibration, long_frames: []

  alias Aerie.Vehicle.Protocol.Mavlink
  alias Aerie.Vehicle.Protocol.Mavlink.Commands

  @switches "MSP has no message for it: the switches of the transmitter do that"
  @by_switch ~w(arm disarm force_disarm set_mode rtl hold)
  @has ~w(reboot save_params calibrate request_message set_message_interval)
  # Writing the EEPROM takes up to two seconds.
  @slow_ms 6_000

  @impl true
  def gap(type, _kind) when type in @has, do: nil
  def gap(type, _kind) when type in @by_switch, do: @switches
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

  def steps(%{type: "save_params"}, _vehicle),
    do: {:ok, [Mavlink.long(:MAV_CMD_PREFLIGHT_STORAGE, %{1 => 1}, answer_ms: @slow_ms)]}

  def steps(%{type: type, params: params}, vehicle), do: {:ok, Commands.steps(type, params, vehicle)}

  @impl true
  def param_encoding, do: :c_cast

  @impl true
  def setpoints_first?(_command, _vehicle), do: false

  @impl true
  def home_is_item_0?, do: false

  @impl true
  def item_offset, do: -1

  @impl true
  def kept(_item, _mission_type, _kind), do: %{}

  @impl true
  def plan_watch_us(_mission_type), do: 0

  @impl true
  def plan_verdict(_message, _mission_type, _opaque_id), do: :ignore

  defmodule Calibration do
    @moduledoc false
    # The acknowledgement says that it began; nothing in MSP says how it goes.
    def read(_step, _message, _source, _vehicle), do: :ignore
    def listens(_step), do: []
  end
end
