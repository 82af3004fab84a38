defmodule Aerie.Vehicle.Streams.Request do
  @moduledoc """
  The messages by which rates are asked for (M1), and what those of others mean.

  SET_MESSAGE_INTERVAL is for one message. REQUEST_DATA_STREAM is older and for groups, whose members the firmware decides;
  `groups/0` are ArduPilot's, as far as they matter here.
  """

  alias MavCodec.Messages.{CommandInt, CommandLong, RequestDataStream}

  @set_message_interval 511
  @request_message 512
  @message_interval 244

  # MAV_DATA_STREAM => message ids.
  @groups %{
    1 => [27, 29, 116, 129, 137, 143],
    2 => [1, 24, 42, 62, 124, 125, 127, 128, 152, 162],
    3 => [35, 36, 65],
    6 => [32, 33],
    10 => [30, 164, 178, 194],
    11 => [74],
    12 => [2, 136, 147, 163, 168, 173, 193, 241]
  }
  @group_of for {group, ids} <- @groups, id <- ids, into: %{}, do: {id, group}

  @type target :: {system :: non_neg_integer(), component :: non_neg_integer()}

  @doc "Groups of REQUEST_DATA_STREAM with their messages."
  @spec groups() :: %{pos_integer() => [non_neg_integer()]}
  def groups, do: @groups

  @doc "The group of a message, or nil."
  @spec group(non_neg_integer()) :: pos_integer() | nil
  def group(id), do: @group_of[id]

  @doc "SET_MESSAGE_INTERVAL; `hz` 0 means the vehicle's own default."
  @spec set(target(), non_neg_integer(), number()) :: CommandLong.t()
  def set(target, id, hz) when hz == 0, do: command(target, @set_message_interval, id, 0)
  def set(target, id, hz), do: command(target, @set_message_interval, id, trunc(1_000_000 / hz))

  @doc "Asks what interval is set: MESSAGE_INTERVAL answers."
  @spec query(target(), non_neg_integer()) :: CommandLong.t()
  def query(target, id), do: command(target, @request_message, @message_interval, id)

  @doc "Asks for a message once."
  @spec once(target(), non_neg_integer()) :: CommandLong.t()
  def once(target, id), do: command(target, @request_message, id, 0)

  @doc "REQUEST_DATA_STREAM; the rate is a whole number, at least 1."
  @spec group(target(), non_neg_integer(), number()) :: RequestDataStream.t()
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
  What a message of somebody else asks for: `{:message, id, hz}` or `{:groups, [group], hz}`, `hz` nil for "not any more"
  or "whatever is the default". `:other` when it is about something else or makes no sense.
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
