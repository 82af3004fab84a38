defmodule Aerie.Vehicle.Firmware.Msp.Adapter do
  @moduledoc """
  Betaflight and iNav, which the gateway reaches over MSP (`Msp.Session`). The session takes commands as MAVLink and
  acknowledges them with what the flight controller said.

  MSP has no message for arming, for a mode, or for flying somewhere: the pilot's switches do that, or channels in their
  place, where the vehicle's receiver is MSP or its pilot has handed them over (`Msp.Receiver`). A source that arms it
  has to steer it by `manual_control` or `rc_override`.
  """

  use Aerie.Vehicle.Protocol.Mavlink.Commands, calibration: __MODULE__.Calibration, long_frames: []

  alias Aerie.Vehicle.Firmware.{Modes, Unknown}
  alias Aerie.Vehicle.Protocol.Mavlink
  alias Aerie.Vehicle.Protocol.Mavlink.{Commands, Streams}
  alias Aerie.Vehicle.Firmware.Msp.StoredItem

  # What the firmware, or one of the two, could do.
  @not_yet ~w(rx_pair reset_params mission_start mission_pause mission_set_current resume camera_trigger)
  @has ~w(reboot save_params calibrate request_message set_message_interval arm disarm force_disarm set_mode rtl hold rc_override
    manual_control motor_test)
  # What iNav alone has.
  @inav ~w(goto set_home)
  @return %{betaflight: "GPS RESCUE", inav: "NAV RTH"}
  # Betaflight from 2026.6 flies its rescue as a plan of its autopilot, if it was built with that.
  @flown_as %{"GPS RESCUE" => ["GPS RESCUE", "AUTOPILOT"]}
  @hold %{betaflight: "POS HOLD", inav: "NAV POSHOLD"}
  # Safe channels for two seconds, and what keeps it from being armed may take longer.
  @arm_ms 12_000
  @unsaid "they count only if the vehicle was armed by this gateway; a text says if they were ignored"
  # Two questions, each asked three times at most, and the order: a second each on a line that answers slowly.
  @motor_ms 8_000
  # Writing the EEPROM takes up to two seconds.
  @slow_ms 6_000

  @impl true
  def gap(type, _kind, firmware) when type in @has or (type in @inav and firmware == :inav), do: nil
  def gap(type, _kind, _firmware) when type in @inav, do: "Betaflight has no message for it in MSP"
  def gap(type, _kind, _firmware) when type in @not_yet, do: "Aerie does not do it over MSP yet"
  def gap(_type, _kind, _firmware), do: "Betaflight and iNav have no such command over MSP"

  @impl true
  def steps(%{type: "reboot", params: %{to: "bootloader"}}, _vehicle),
    do: {:gap, "a boot loader does not speak MSP: the vehicle would be gone until somebody goes to it"}

  def steps(%{type: "calibrate", params: %{sensor: sensor}}, _vehicle) do
    case sensor do
      sensor when sensor in ["accelerometer", "magnetometer"] ->
        {:ok, [Commands.preflight(sensor, answer_ms: @slow_ms)]}

      other ->
        {:gap, "MSP calibrates the accelerometer and the magnetometer, not #{other}"}
    end
  end

  def steps(%{type: "save_params", params: %{what: what}}, _vehicle) do
    number = %{"params" => 1, "mission" => 2}[what]
    {:ok, [Mavlink.long(:MAV_CMD_PREFLIGHT_STORAGE, %{number => 1}, answer_ms: @slow_ms)]}
  end

  def steps(%{type: "arm"}, _vehicle),
    do:
      {:ok,
       [Mavlink.long(:MAV_CMD_COMPONENT_ARM_DISARM, %{1 => 1}, answer_ms: @arm_ms, confirm: {:armed, true})]}

  def steps(%{type: "set_mode", params: %{mode: name}}, vehicle), do: mode(name, vehicle)

  def steps(%{type: "set_mode", params: %{standard_mode: name}}, vehicle) do
    case Modes.standard(vehicle) do
      %{^name => mode} -> mode(mode, vehicle)
      _none -> lacks_mode("for #{name}", vehicle)
    end
  end

  def steps(%{type: "rtl"}, vehicle), do: mode(@return[vehicle.autopilot], vehicle)
  def steps(%{type: "hold"}, vehicle), do: mode(@hold[vehicle.autopilot], vehicle)

  def steps(%{type: type}, %{armed: armed}) when type in ["rc_override", "manual_control"] and armed != true,
    do: {:error, "it is not armed: channels are sent from arm on"}

  def steps(%{type: type, params: params}, vehicle) when type in ["rc_override", "manual_control"],
    do: {:ok, for(step <- Commands.steps(type, params, vehicle), do: %{step | note: @unsaid})}

  def steps(%{type: "goto", params: %{altitude_reference: "terrain"}}, _vehicle),
    do: {:gap, "iNav has heights above home and above sea level"}

  def steps(%{type: "goto", params: %{speed: speed}}, _vehicle) when speed != nil,
    do: {:gap, "iNav flies there at its own speed (nav_auto_speed)"}

  def steps(%{type: "goto", params: params}, _vehicle) do
    frame = Streams.frame(params.altitude_reference)
    numbers = %{1 => -1, 2 => 0, 4 => params[:yaw] || :nan}
    place = {params.lat, params.lon}
    {:ok, [Mavlink.int(:MAV_CMD_DO_REPOSITION, [{frame, params.altitude}], place, numbers, answer_ms: 3_000)]}
  end

  def steps(%{type: "motor_test", params: params}, _vehicle) do
    numbers = %{1 => params.motor, 3 => params.throttle * 100, 4 => params.duration}
    {:ok, [Mavlink.long(:MAV_CMD_DO_MOTOR_TEST, numbers, answer_ms: @motor_ms)]}
  end

  def steps(%{type: type, params: params}, vehicle), do: {:ok, Commands.steps(type, params, vehicle)}

  defp mode(name, vehicle) do
    case Modes.find(vehicle, name) do
      {:ok, number, name} ->
        {:ok,
         [
           Mavlink.long(:MAV_CMD_DO_SET_MODE, %{1 => 1, 2 => number},
             answer_ms: @slow_ms,
             confirm: {:mode, Map.get(@flown_as, name, [name])}
           )
         ]}

      :error ->
        lacks_mode(inspect(name), vehicle)
    end
  end

  defp lacks_mode(_which, %{mode_names: names}) when names == %{},
    do: {:error, "the vehicle has not said which modes it has yet"}

  defp lacks_mode(which, _vehicle), do: {:gap, "this firmware has no mode #{which}"}

  @impl true
  def param_encoding, do: :bytewise

  # There are no set-points yet.
  @impl true
  defdelegate setpoints_first?(command, vehicle), to: Unknown
  @impl true
  def home_is_item_0?, do: false
  @impl true
  def item_offset, do: -1
  @impl true
  def kept(item, mission_type, _kind), do: StoredItem.kept(item, mission_type)
  @impl true
  def plan_gap(_mission_type, :betaflight), do: "Betaflight has no missions, fences or rally points"
  def plan_gap(0, :inav), do: nil
  def plan_gap(_fence_or_rally, :inav), do: "iNav has no fences or rally points over MSP"
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
