defmodule SimVehicle.Vehicle.Camera do
  @moduledoc """
  A camera beside the autopilot, with parameters of its own: PARAM_EXT (rule P8), the heartbeat of a camera, and nothing else. Pure.

  | parameter | type | set |
  |---|---|---|
  | `CAM_MODE` | uint8 | 0 to 2, others are VALUE_UNSUPPORTED |
  | `CAM_ISO`, `CAM_SHUTTER`, `CAM_EV`, `CAM_NAME` ... | each type once | anything |
  | `CAM_FORMAT` | uint16 | IN_PROGRESS, and ACCEPTED 3 s later |
  | `CAM_SERIAL` | custom | FAILED |

  A set of another type than the parameter's is FAILED. A parameter that it does not have is not answered.
  """

  alias MavCodec.Enums.ParamAck
  alias MavCodec.Messages, as: M

  @heartbeat_us 1_000_000
  # A list is sent at the rate of a slow link.
  @pace_us 5_000
  @work_us 3_000_000
  @camera 30
  @invalid 8
  @accepted ParamAck.value(:PARAM_ACK_ACCEPTED)
  @unsupported ParamAck.value(:PARAM_ACK_VALUE_UNSUPPORTED)
  @failed ParamAck.value(:PARAM_ACK_FAILED)
  @in_progress ParamAck.value(:PARAM_ACK_IN_PROGRESS)
  @custom 11

  @params [
    {"CAM_MODE", 1, <<1>>},
    {"CAM_EV_STEP", 2, <<-3>>},
    {"CAM_FORMAT", 3, <<0x0100::little-16>>},
    {"CAM_TINT", 4, <<-300::little-16>>},
    {"CAM_ISO", 5, <<0x01000200::little-32>>},
    {"CAM_TEMP", 6, <<-70_000::little-32>>},
    {"CAM_FREE", 7, <<0xFFFF_FFFF_FFFF_FFFF::little-64>>},
    {"CAM_OFFSET", 8, <<-5_000_000_000::little-64>>},
    {"CAM_EV", 9, <<1.0::float-little-32>>},
    {"CAM_SHUTTER", 10, <<0.0125::float-little-64>>},
    {"CAM_NAME", @custom, "Nadir"},
    {"CAM_SERIAL", @custom, <<0, 1, 2, 255>>}
  ]

  @count length(@params)

  @enforce_keys [:component]
  defstruct [:component, :work, params: %{}, beat_at: 0]

  @typedoc "`work`: what is being set, `{parameter's name, value, when it is done}`"
  @type t :: %__MODULE__{}

  @doc "A camera with this component id."
  @spec new(1..255) :: t()
  def new(component),
    do: %__MODULE__{component: component, params: Map.new(@params, fn {name, _t, value} -> {name, value} end)}

  @doc "The vehicle restarted: values stay, what was being set does not."
  @spec reboot(t()) :: t()
  def reboot(camera), do: %{camera | work: nil, beat_at: 0}

  @doc "Its parameters: names and types in the order of the list."
  @spec params() :: [{String.t(), 1..11}]
  def params, do: for({name, type, _value} <- @params, do: {name, type})

  @doc "What it sends by itself at a time of the vehicle."
  @spec tick(t(), integer()) :: {t(), [struct()]}
  def tick(%{work: {name, value, at}} = camera, now) when now >= at do
    camera = %{camera | work: nil, params: Map.put(camera.params, name, value)}
    {camera, [ack(camera, name, @accepted)]}
  end

  def tick(%{beat_at: at} = camera, now) when now >= at do
    beat = %M.Heartbeat{type: @camera, autopilot: @invalid, system_status: 4}
    {%{camera | beat_at: now + @heartbeat_us}, [beat]}
  end

  def tick(camera, _now), do: {camera, []}

  @doc "What it answers to a message for it: `{microseconds later, message}`."
  @spec handle(t(), struct(), integer()) :: {t(), [{non_neg_integer(), struct()}]}
  def handle(camera, %M.ParamExtRequestList{}, _now) do
    {camera, for(index <- 0..(@count - 1), do: {index * @pace_us, value(camera, index)})}
  end

  def handle(camera, %M.ParamExtRequestRead{param_index: -1, param_id: name}, _now),
    do: {camera, for(index <- List.wrap(index(name)), do: {0, value(camera, index)})}

  def handle(camera, %M.ParamExtRequestRead{param_index: index}, _now) when index in 0..(@count - 1)//1,
    do: {camera, [{0, value(camera, index)}]}

  def handle(camera, %M.ParamExtSet{param_id: name} = m, now) do
    case index(name) do
      nil ->
        {camera, []}

      index ->
        {camera, result} = set(camera, Enum.at(@params, index), m, now)
        {camera, [{0, ack(camera, name, result)}]}
    end
  end

  def handle(camera, _other, _now), do: {camera, []}

  defp set(camera, {"CAM_SERIAL", _type, _default}, _m, _now), do: {camera, @failed}

  defp set(camera, {_name, type, _default}, %{param_type: other}, _now) when other != type,
    do: {camera, @failed}

  defp set(camera, {"CAM_MODE", _type, _default}, %{param_value: <<mode, _::binary>>}, _now) when mode > 2,
    do: {camera, @unsupported}

  # A repeated request is answered with progress.
  defp set(%{work: nil} = camera, {"CAM_FORMAT", _type, _default}, m, now),
    do: {%{camera | work: {m.param_id, m.param_value, now + @work_us}}, @in_progress}

  defp set(camera, {"CAM_FORMAT", _type, _default}, _m, _now), do: {camera, @in_progress}

  defp set(camera, {name, _type, _default}, m, _now),
    do: {%{camera | params: Map.put(camera.params, name, m.param_value)}, @accepted}

  defp index(name), do: Enum.find_index(@params, &(elem(&1, 0) == name))

  defp value(camera, index) do
    {name, type, _default} = Enum.at(@params, index)

    %M.ParamExtValue{
      param_id: name,
      param_value: camera.params[name],
      param_type: type,
      param_count: @count,
      param_index: index
    }
  end

  defp ack(camera, name, result) do
    {^name, type, _default} = Enum.at(@params, index(name))
    %M.ParamExtAck{param_id: name, param_value: camera.params[name], param_type: type, param_result: result}
  end
end
