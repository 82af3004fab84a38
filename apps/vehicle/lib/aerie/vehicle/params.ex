defmodule Aerie.Vehicle.Params do
  @moduledoc """
  What a PARAM_VALUE says. A parameter's type travels in the message, its value always as a float: PX4 puts the bytes of
  an integer there, ArduPilot its number (P2; the capability flags are not reliable, so the autopilot decides).
  """

  alias MavCodec.Messages.ParamValue

  # MAV_PARAM_TYPE
  @uint8 1
  @int8 2
  @uint16 3
  @int16 4
  @uint32 5
  @int32 6

  @type value :: {name :: String.t(), number(), index :: non_neg_integer() | nil}

  # Counters that the firmware keeps among its parameters and sends every half minute; nobody has changed them.
  @counters ["STAT_", "LND_FLIGHT_T_"]

  @doc """
  Name, value and index (nil when the message does not come from a list). `:ignore` for PX4's hash over all values, for
  counters of flight time and the like, and for what has no name or no number.
  """
  @spec read(struct(), atom()) :: {:ok, value()} | :ignore
  def read(%ParamValue{param_id: "_HASH_CHECK"}, _autopilot), do: :ignore

  def read(%ParamValue{} = message, autopilot) do
    with true <- name?(message.param_id),
         value when value != nil <- value(autopilot, message.param_type, message.param_value) do
      {:ok, {message.param_id, value, if(message.param_index == 0xFFFF, do: nil, else: message.param_index)}}
    else
      _garbage -> :ignore
    end
  end

  # PX4 left memory garbage in the name of what it could not find.
  defp name?(name) do
    name != "" and String.printable?(name) and byte_size(name) == String.length(name) and
      not String.starts_with?(name, @counters)
  end

  defp value(:px4, type, value) when type in @uint8..@int32, do: value |> bits() |> integer(type)
  defp value(_autopilot, type, value) when type in @uint8..@int32 and is_float(value), do: round(value)
  defp value(_autopilot, _type, value) when is_float(value), do: value
  defp value(_autopilot, _type, _not_a_number), do: nil

  defp bits(value) when is_float(value), do: <<value::float-32>>
  defp bits({:nan, bits}), do: <<bits::32>>
  defp bits(:nan), do: <<0x7FC00000::32>>
  defp bits(:infinity), do: <<0x7F800000::32>>
  defp bits(:neg_infinity), do: <<0xFF800000::32>>

  defp integer(<<_::24, value::unsigned-8>>, @uint8), do: value
  defp integer(<<_::24, value::signed-8>>, @int8), do: value
  defp integer(<<_::16, value::unsigned-16>>, @uint16), do: value
  defp integer(<<_::16, value::signed-16>>, @int16), do: value
  defp integer(<<value::unsigned-32>>, @uint32), do: value
  defp integer(<<value::signed-32>>, @int32), do: value
end
