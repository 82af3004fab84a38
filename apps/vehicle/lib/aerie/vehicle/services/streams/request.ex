defmodule Aerie.Vehicle.Services.Streams.Request do
  @moduledoc """
  The messages that request rates (M1), and the meaning of those that clients send.

  SET_MESSAGE_INTERVAL is for one message. The older REQUEST_DATA_STREAM is for groups, whose members the firmware decides;
  `groups/0` are ArduPilot's, as far as they matter here.
  """

  alias MavCodec.Dialects.All
  alias MavCodec.Enums.{MavCmd, MavDataStream}
  alias MavCodec.Messages.{CommandInt, CommandLong, RequestDataStream}

  @set_message_interval MavCmd.value(:MAV_CMD_SET_MESSAGE_INTERVAL)
  @request_message MavCmd.value(:MAV_CMD_REQUEST_MESSAGE)
  @get_message_interval MavCmd.value(:MAV_CMD_GET_MESSAGE_INTERVAL)

  # Group => message ids.
  @groups Map.new(
            [
              RAW_SENSORS:
                ~w(RAW_IMU SCALED_PRESSURE SCALED_IMU2 SCALED_IMU3 SCALED_PRESSURE2 SCALED_PRESSURE3),
              EXTENDED_STATUS: ~w(SYS_STATUS GPS_RAW_INT MISSION_CURRENT NAV_CONTROLLER_OUTPUT GPS2_RAW
                POWER_STATUS GPS_RTK GPS2_RTK MEMINFO FENCE_STATUS),
              RC_CHANNELS: ~w(RC_CHANNELS_RAW SERVO_OUTPUT_RAW RC_CHANNELS),
              POSITION: ~w(LOCAL_POSITION_NED GLOBAL_POSITION_INT),
              EXTRA1: ~w(ATTITUDE SIMSTATE AHRS2 PID_TUNING),
              EXTRA2: ~w(VFR_HUD),
              EXTRA3: ~w(SYSTEM_TIME TERRAIN_REPORT BATTERY_STATUS AHRS WIND RANGEFINDER EKF_STATUS_REPORT
                VIBRATION)
            ],
            fn {group, names} ->
              {MavDataStream.value(:"MAV_DATA_STREAM_#{group}"),
               Enum.map(names, &(All.message_id(&1) || raise("no message #{&1}")))}
            end
          )
  @group_of for {group, ids} <- @groups, id <- ids, into: %{}, do: {id, group}

  @type target :: {system :: non_neg_integer(), component :: non_neg_integer()}

  @doc "The groups of REQUEST_DATA_STREAM (MAV_DATA_STREAM) with the ids of their messages."
  @spec groups() :: %{pos_integer() => [non_neg_integer()]}
  def groups, do: @groups

  @doc "The group of a message, or nil."
  @spec group(non_neg_integer()) :: pos_integer() | nil
  def group(id), do: @group_of[id]

  @doc "SET_MESSAGE_INTERVAL; 0 Hz is the vehicle's default."
  @spec set(target(), non_neg_integer(), number()) :: CommandLong.t()
  def set(target, id, hz) when hz == 0, do: command(target, @set_message_interval, id, 0)
  def set(target, id, hz), do: command(target, @set_message_interval, id, trunc(1_000_000 / hz))

  @doc """
  Requests MESSAGE_INTERVAL: the interval that is set. By the command that is older than REQUEST_MESSAGE, because
  ArduPilot answers no other one.
  """
  @spec query(target(), non_neg_integer()) :: CommandLong.t()
  def query(target, id), do: command(target, @get_message_interval, id, 0)

  @doc "Requests a message once."
  @spec once(target(), non_neg_integer()) :: CommandLong.t()
  def once(target, id), do: command(target, @request_message, id, 0)

  @doc "REQUEST_DATA_STREAM; the rate is a whole number, at least 1; 0 Hz stops the group."
  @spec group(target(), non_neg_integer(), number()) :: RequestDataStream.t()
  def group(target, group, hz) when hz == 0,
    do: %{group(target, group, 1) | req_message_rate: 0, start_stop: 0}

  def group({system, component}, group, hz) do
    %RequestDataStream{
      target_system: system,
      target_component: component,
      req_stream_id: group,
      req_message_rate: hz |> ceil() |> max(1) |> min(0xFFFF),
      start_stop: 1
    }
  end

  @doc """
  What a client's message requests: `{:message, id, hz}` or `{:groups, [group], hz}`, with `hz` nil for "stop" and "the
  default". `:other` for another message or an invalid one.
  """
  @spec read(struct()) ::
          {:message, non_neg_integer(), float() | nil} | {:groups, [pos_integer()], number() | nil} | :other
  def read(%module{command: @set_message_interval, param1: id, param2: interval})
      when module in [CommandLong, CommandInt] and is_float(id) and is_float(interval) do
    cond do
      id < 0 or id > 0xFFFFFF or trunc(id) != id -> :other
      interval > 0 -> {:message, trunc(id), 1_000_000 / interval}
      interval in [0.0, -1.0] -> {:message, trunc(id), nil}
      true -> :other
    end
  end

  def read(%RequestDataStream{req_stream_id: stream, req_message_rate: hz, start_stop: start}) do
    groups = if stream == 0, do: Map.keys(@groups), else: [stream]
    {:groups, groups, if(start == 1 and hz > 0, do: hz)}
  end

  def read(_other), do: :other

  defp command({system, component}, command, param1, param2) do
    %CommandLong{
      target_system: system,
      target_component: component,
      command: command,
      param1: param1 * 1.0,
      param2: param2 * 1.0
    }
  end
end
