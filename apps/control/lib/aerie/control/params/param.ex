defmodule Aerie.Control.Params.Param do
  @moduledoc """
  One parameter of a vehicle.

  `type` is its MAV_PARAM_TYPE; for a parameter of PARAM_EXT the MAV_PARAM_EXT_TYPE, which has the same numbers and 11 for text or bytes, and
  whose values are those of `Aerie.Vehicle.Protocol.ExtValue`. `exact` is false for an integer that came as a float too large to be exact
  (`MavCodec.Message.ParamValue`). `value` is nil if it is not a number on board (NaN, infinite), which `plain/1` remarks. `default` is the firmware's default, nil if the vehicle did not say.
  """

  @enforce_keys [:name, :value, :type]
  defstruct [:name, :value, :type, :default, exact: true]

  @type t :: %__MODULE__{
          name: String.t(),
          value: number() | String.t() | nil,
          type: 0..255,
          default: number() | nil,
          exact: boolean()
        }

  @doc "Reads what `plain/1` gave, as JSON brings it: it came from outside."
  @spec parse(term()) :: {:ok, t()} | :error
  def parse(%{"name" => name, "value" => value, "type" => type} = object)
      when is_binary(name) and byte_size(name) in 1..64 and type in 0..255 and
             (is_number(value) or is_nil(value) or (is_binary(value) and byte_size(value) <= 128)) do
    default = if is_number(object["default"]), do: object["default"]

    {:ok,
     %__MODULE__{name: name, value: value, type: type, default: default, exact: object["exact"] != false}}
  end

  def parse(_other), do: :error

  @doc "A parameter of ArduPilot's parameter file."
  @spec unpack(MavCodec.Ftp.PackedParams.param()) :: t()
  def unpack({name, type, value, default}),
    do: %__MODULE__{name: name, value: value, type: type, default: default}

  @doc "A parameter for ArduPilot's parameter file."
  @spec pack(t()) :: MavCodec.Ftp.PackedParams.param()
  def pack(param), do: {param.name, param.type, param.value, param.default}

  @doc "Whether two values are the same for a vehicle."
  @spec same?(number() | nil, number() | nil) :: boolean()
  defdelegate same?(one, other), to: MavCodec.Message.ParamValue

  @doc "The parameter as NATS and REST show it."
  @spec plain(t()) :: %{atom() => String.t() | number() | boolean() | nil}
  def plain(%{value: nil} = param),
    do: Map.put(fields(param), :remark, "not a number on board (NaN or infinite)")

  def plain(param), do: fields(param)

  defp fields(param), do: Map.take(param, [:name, :value, :type, :default, :exact])
end
