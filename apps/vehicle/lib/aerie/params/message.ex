defmodule Aerie.Params.Message do
  @moduledoc """
  The messages about parameters: requests, and what an answer says. With the encoding `:extended` they are those of PARAM_EXT, which
  cameras, gimbals and companions speak (P8); with the others those of an autopilot.
  """

  alias Aerie.Params.Param
  alias Aerie.Protocol.{ExtValue, ParamValue}
  alias MavCodec.Enums.MavParamError
  alias MavCodec.Messages, as: M

  @type target :: {system :: non_neg_integer(), component :: 0..255}
  @type encoding :: ParamValue.encoding() | :extended

  @doc "Asks for the whole list."
  @spec list(target(), encoding()) :: struct()
  def list({system, component}, encoding) do
    module = if encoding == :extended, do: M.ParamExtRequestList, else: M.ParamRequestList
    struct!(module, target_system: system, target_component: component)
  end

  @doc "Asks for a parameter by its name, or by its index."
  @spec read(target(), String.t() | 0..65_535, encoding()) :: struct()
  def read({system, component}, which, encoding) do
    module = if encoding == :extended, do: M.ParamExtRequestRead, else: M.ParamRequestRead

    which =
      if is_integer(which), do: [param_index: which], else: [param_index: -1, param_id: which]

    struct!(module, [target_system: system, target_component: component] ++ which)
  end

  @doc "Sets a parameter to a value as it is on the wire, for which `encode/3` is."
  @spec set(target(), String.t(), ParamValue.wire() | binary(), type :: integer(), encoding()) :: struct()
  def set({system, component}, name, wire, type, encoding) do
    module = if encoding == :extended, do: M.ParamExtSet, else: M.ParamSet

    struct!(module,
      target_system: system,
      target_component: component,
      param_id: name,
      param_value: wire,
      param_type: type
    )
  end

  @doc """
  A parameter's value: `:garbage` without a valid name, `:other` for any other message. A value that is not a number (NaN, infinite) is nil:
  the vehicle has the parameter all the same.
  """
  @spec value(struct(), encoding()) :: {:ok, Param.t()} | :garbage | :other
  def value(%M.ParamExtValue{} = m, :extended) do
    value = ExtValue.decode(m.param_value, m.param_type)

    if ParamValue.name?(m.param_id),
      do: {:ok, %Param{name: m.param_id, value: value, type: m.param_type}},
      else: :garbage
  end

  def value(%M.ParamValue{} = m, encoding) when encoding != :extended do
    case {ParamValue.name?(m.param_id), ParamValue.decode(m.param_value, m.param_type, encoding)} do
      {false, _value} ->
        :garbage

      {true, :error} ->
        {:ok, %Param{name: m.param_id, value: nil, type: m.param_type, exact: false}}

      {true, {:ok, value, exact?}} ->
        {:ok, %Param{name: m.param_id, value: value, type: m.param_type, exact: exact?}}
    end
  end

  def value(_message, _encoding), do: :other

  @doc "What a message says about the parameter of a name."
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
