defmodule Aerie.Params.Message do
  @moduledoc "The messages about one parameter: requests, and what an answer says."

  alias Aerie.Params.Param
  alias Aerie.Protocol.ParamValue
  alias MavCodec.Enums.MavParamError
  alias MavCodec.Messages, as: M

  @type target :: {system :: non_neg_integer(), component :: 0..255}

  @doc "Asks for a parameter by name."
  @spec read(target(), String.t()) :: struct()
  def read({system, component}, name),
    do: %M.ParamRequestRead{
      target_system: system,
      target_component: component,
      param_id: name,
      param_index: -1
    }

  @doc "Sets a parameter to a value as it is on the wire."
  @spec set(target(), String.t(), ParamValue.wire(), type :: integer()) :: struct()
  def set({system, component}, name, wire, type) do
    %M.ParamSet{
      target_system: system,
      target_component: component,
      param_id: name,
      param_value: wire,
      param_type: type
    }
  end

  @doc "What a message says about a parameter."
  @spec about(struct(), String.t(), ParamValue.encoding()) ::
          {:value, Param.t()} | {:refused, String.t()} | :other
  def about(%M.ParamValue{param_id: name} = m, name, encoding) do
    case ParamValue.decode(m.param_value, m.param_type, encoding) do
      {:ok, value, exact?} -> {:value, %Param{name: name, value: value, type: m.param_type, exact: exact?}}
      :error -> :other
    end
  end

  # PX4 1.18 answers a read by index with random memory as the name; after a read by name it is right.
  def about(%M.ParamError{param_id: name, error: error}, name, _encoding),
    do: {:refused, to_string(MavParamError.name(error) || "MAV_PARAM_ERROR #{error}")}

  def about(_message, _name, _encoding), do: :other
end
