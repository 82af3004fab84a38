defmodule Msp.Meaning do
  @moduledoc """
  What a write over MSP means, as the MAVLink message that would ask for the same: by it the policy judges programs that speak MSP themselves. What
  has no counterpart counts as setting a parameter that protects the vehicle, which needs most.
  """

  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.{Frame, Guard, Message, Params, ShortName}
  alias Msp.Params.{Block, Line}

  @component 1
  # A name of `Aerie.Control.Policy.Intent.Protection`, of no parameter.
  @protects "failsafe_delay"

  @commands Map.new(
              [
                {"REBOOT", {:PREFLIGHT_REBOOT_SHUTDOWN, %{param1: 1.0}}},
                {"EEPROM_WRITE", {:PREFLIGHT_STORAGE, %{param1: 1.0}}},
                {"WP_MISSION_SAVE", {:PREFLIGHT_STORAGE, %{param2: 1.0}}},
                {"RESET_CONF", {:PREFLIGHT_STORAGE, %{param1: 2.0}}},
                {"ACC_CALIBRATION", {:PREFLIGHT_CALIBRATION, %{param5: 1.0}}},
                {"MAG_CALIBRATION", {:PREFLIGHT_CALIBRATION, %{param2: 1.0}}},
                {"SET_MOTOR", {:DO_MOTOR_TEST, %{param1: 1.0, param3: 100.0}}},
                # To disable arming is to disarm; to enable it lets others arm.
                {"SET_ARMING_DISABLED", {:COMPONENT_ARM_DISARM, %{param1: 0.0}}}
              ],
              fn {name, {command, params}} -> {name, {MavCmd.value(:"MAV_CMD_#{command}"), params}} end
            )
  @mission ~w(SET_WP WP_MISSION_LOAD)

  @doc "Whether a request only reads: MSP2_CLI_SETTING does, without a `=`."
  @spec reads?(Message.t(), Frame.t()) :: boolean
  def reads?(%{kind: :read}, _frame), do: true
  def reads?(%{name: "MSP2_CLI_SETTING"}, %{payload: payload}), do: not String.contains?(payload, "=")
  def reads?(_message, _frame), do: false

  @doc "The message for the vehicle of a system id."
  @spec of(Guard.target(), Message.t(), Frame.t(), system :: 1..254) :: struct
  def of(target, %{name: name}, frame, system) do
    case @commands do
      %{^name => {command, params}} ->
        struct!(%M.CommandLong{target_system: system, target_component: @component, command: command}, params)

      _other when name in @mission ->
        %M.MissionCount{target_system: system, target_component: @component, count: 1}

      _other ->
        %M.ParamSet{
          target_system: system,
          target_component: @component,
          param_id: ShortName.of(parameter(target, name, frame)),
          # What the write makes of it is not read here.
          param_value: :nan,
          param_type: 9
        }
    end
  end

  defp parameter(_target, "MSP2_COMMON_SET_SETTING", %{payload: payload}) do
    case :binary.split(payload, <<0>>) do
      [name, _value] when name != "" and byte_size(name) < 64 ->
        if String.printable?(name), do: name, else: @protects

      # By its number.
      _other ->
        @protects
    end
  end

  defp parameter(_target, "MSP2_CLI_SETTING", %{payload: payload}) do
    name = payload |> :binary.split("=") |> hd() |> String.trim() |> String.downcase(:ascii)
    if Line.name?(name), do: name, else: @protects
  end

  # A block has several; all of its fields may change.
  defp parameter({firmware, version}, name, _frame) do
    fields =
      for %{block: block} = param when block != nil <- Params.all(firmware, version),
          Block.write_name(block) == name,
          do: param.name

    if fields == [],
      do: @protects,
      else: Enum.find(fields, hd(fields), &String.contains?(&1, ["failsafe", "rescue"]))
  end
end
