defmodule Aerie.Vehicle.Firmware.Msp.Commands do
  @moduledoc """
  What Betaflight and iNav have in common, which the gateway reaches over MSP (`Msp.Session`). The session takes
  commands as MAVLink and acknowledges them with what the flight controller said.

  MSP has no message for arming, for a mode, or for flying somewhere: the pilot's switches do that, or channels in their
  place, where the vehicle's receiver is MSP or its pilot has handed them over (`Msp.Receiver`). A source that arms it
  has to steer it by `manual_control` or `rc_override`.
  """

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Firmware.Modes
  alias Aerie.Vehicle.Protocol.{Mavlink, Step, Vehicle}
  alias Aerie.Vehicle.Protocol.Mavlink.Commands

  # What the firmware, or one of the two, could do.
  @not_yet ~w(rx_pair reset_params mission_start mission_pause mission_set_current resume camera_trigger)
  @has ~w(reboot save_params calibrate request_message set_message_interval arm disarm force_disarm set_mode rtl hold
    rc_override manual_control motor_test)
  # Betaflight from 2026.6 flies its rescue as a plan of its autopilot, if it was built with that.
  @flown_as %{"GPS RESCUE" => ["GPS RESCUE", "AUTOPILOT"]}
  # Safe channels for two seconds, and what keeps it from being armed may take longer.
  @arm_ms 12_000
  @unsaid "they count only if the vehicle was armed by this gateway; a text says if they were ignored"
  # Two questions, each asked three times at most, and the order: a second each on a line that answers slowly.
  @motor_ms 8_000
  # Writing the EEPROM takes up to two seconds.
  @slow_ms 6_000

  @doc "Why they lack a command; nil if both have it."
  @spec gap(String.t()) :: String.t() | nil
  def gap(type) when type in @has, do: nil
  def gap(type) when type in @not_yet, do: "Aerie does not do it over MSP yet"
  def gap(_type), do: "Betaflight and iNav have no such command over MSP"

  @doc "The steps of a command that both have in the same way."
  @spec steps(Command.t(), Vehicle.t()) :: {:ok, [Step.t(), ...]} | {:gap | :error, String.t()}
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

  def steps(%{type: type}, %{armed: armed}) when type in ["rc_override", "manual_control"] and armed != true,
    do: {:error, "it is not armed: channels are sent from arm on"}

  def steps(%{type: type, params: params}, vehicle) when type in ["rc_override", "manual_control"],
    do: {:ok, for(step <- Commands.steps(type, params, vehicle), do: %{step | note: @unsaid})}

  def steps(%{type: "motor_test", params: params}, _vehicle) do
    numbers = %{1 => params.motor, 3 => params.throttle * 100, 4 => params.duration}
    {:ok, [Mavlink.long(:MAV_CMD_DO_MOTOR_TEST, numbers, answer_ms: @motor_ms)]}
  end

  def steps(%{type: type, params: params}, vehicle), do: {:ok, Commands.steps(type, params, vehicle)}

  @doc "The steps that change to a mode."
  @spec mode(String.t(), Vehicle.t()) :: {:ok, [Step.t(), ...]} | {:gap | :error, String.t()}
  def mode(name, vehicle) do
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

  @doc "The acknowledgement says that a calibration began; nothing in MSP says how it goes."
  @spec read(Step.t(), struct(), tuple(), Vehicle.t()) :: :ignore
  def read(_step, _message, _source, _vehicle), do: :ignore

  @doc "See `read/4`."
  @spec listens(Step.t()) :: []
  def listens(_step), do: []
end
