defmodule Aerie.Control.Params.Message do
  @moduledoc """
  The messages about parameters: requests, and what an answer says. With the encoding `:extended` they are those of PARAM_EXT, which
  cameras, gimbals and companions speak (P8); with the others those of an autopilot.
  """

  alias Aerie.Control.Params.Param
  alias Aerie.Vehicle.Protocol.ExtValue
  alias MavCodec.Enums.MavParamError
  alias MavCodec.Message.ParamValue
  alias MavCodec.Messages, as: M
  alias MavCodec.Ftp.PackedParams

  @type target :: {system :: non_neg_integer(), component :: 0..255}
  @type encoding :: ParamValue.encoding() | :extended

  @type value :: number() | String.t() | nil
  @type wire :: ParamValue.wire() | binary()

  @autopilot %{
    list: M.ParamRequestList,
    read: M.ParamRequestRead,
    set: M.ParamSet,
    value: M.ParamValue
  }
  @extended %{
    list: M.ParamExtRequestList,
    read: M.ParamExtRequestRead,
    set: M.ParamExtSet,
    value: M.ParamExtValue
  }

  @doc "Asks for the whole list."
  @spec list(target(), encoding()) :: struct()
  def list(target, encoding), do: message(:list, target, [], encoding)

  @doc "Asks for a parameter by its name, or by its index."
  @spec read(target(), String.t() | 0..65_535, encoding()) :: struct()
  def read(target, index, encoding) when is_integer(index),
    do: message(:read, target, [param_index: index], encoding)

  def read(target, name, encoding), do: message(:read, target, [param_index: -1, param_id: name], encoding)

  @doc "Sets a parameter to a value as it is on the wire (`encode/3`)."
  @spec set(target(), String.t(), wire(), type :: integer(), encoding()) :: struct()
  def set(target, name, wire, type, encoding),
    do: message(:set, target, [param_id: name, param_value: wire, param_type: type], encoding)

  defp message(kind, {system, component}, fields, encoding),
    do: struct!(module(kind, encoding), [target_system: system, target_component: component] ++ fields)

  defp module(kind, :extended), do: Map.fetch!(@extended, kind)
  defp module(kind, _encoding), do: Map.fetch!(@autopilot, kind)

  @doc "A value as it is on the wire, or why it cannot be sent unchanged."
  @spec encode(value(), type :: integer(), encoding()) :: {:ok, wire()} | {:error, String.t()}
  def encode(value, type, :extended), do: ExtValue.encode(value, type)
  def encode(value, type, encoding), do: ParamValue.encode(value, type, encoding)

  @doc "Whether a reported value is the one that was sent as `wire`."
  @spec same?(value(), wire(), type :: integer(), encoding()) :: boolean()
  def same?(value, wire, type, :extended), do: value == ExtValue.decode(wire, type)

  def same?(value, wire, type, encoding) do
    {:ok, sent, _exact?} = ParamValue.decode(wire, type, encoding)
    ParamValue.same?(value, sent)
  end

  @doc """
  A parameter's value: `:garbage` without a valid name, `:other` for any other message. A value that is not a number (NaN, infinite) is nil:
  the vehicle has the parameter all the same.
  """
  @spec value(struct(), encoding()) :: {:ok, Param.t()} | :garbage | :other
  def value(%module{} = m, encoding) do
    cond do
      module != module(:value, encoding) -> :other
      not PackedParams.name?(m.param_id) -> :garbage
      true -> {:ok, param(m, encoding)}
    end
  end

  defp param(m, :extended),
    do: %Param{name: m.param_id, value: ExtValue.decode(m.param_value, m.param_type), type: m.param_type}

  defp param(m, encoding) do
    {value, exact?} =
      case ParamValue.decode(m.param_value, m.param_type, encoding) do
        {:ok, value, exact?} -> {value, exact?}
        :error -> {nil, false}
      end

    %Param{name: m.param_id, value: value, type: m.param_type, exact: exact?}
  end

  @doc "The value of a named parameter in a message, or its refusal."
  @spec about(struct(), String.t(), encoding()) :: {:value, Param.t()} | {:refused, String.t()} | :other
  # PX4 1.18 answers a read by index with random memory as the name; after a read by name it is right.
  def about(%M.ParamError{param_id: name, error: error}, name, _encoding),
    do: {:refused, to_string(MavParamError.name(error) || "MAV_PARAM_ERROR #{error}")}

  def about(message, name, encoding) do
    case value(message, encoding) do
      {:ok, %{name: ^name} = param} -> {:value, param}
      _other -> :other
    end
  end

  @doc "The reason for which nothing was read or set, if there was no answer."
  @spec silence(target(), encoding()) :: :no_answer | {:silent, component :: 0..255}
  def silence({_system, component}, :extended), do: {:silent, component}
  def silence(_target, _encoding), do: :no_answer
end
