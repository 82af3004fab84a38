defmodule Aerie.Vehicle.Services.Params do
  @moduledoc """
  Reads PARAM_VALUE. The field for the value is always a float, into which each firmware puts integers in its way (P2).
  The capability flags are not reliable, so the firmware decides (`Aerie.Vehicle.Firmware.Traits`).
  """

  alias Aerie.Vehicle.Firmware
  alias MavCodec.Message.ParamValue
  alias MavCodec.Messages, as: M
  alias MavCodec.Ftp.PackedParams

  @type value :: {name :: String.t(), number(), index :: non_neg_integer() | nil}

  # Counters that the firmware keeps as parameters and sends every half minute: nobody has changed them.
  @counters ["STAT_", "LND_FLIGHT_T_"]

  @doc """
  Name (the whole one of Betaflight and iNav), value and index (nil if the message is not part of a list). `:ignore` for PX4's hash over all values, for counters of
  flight time and the like, and for a message without a valid name or number.
  """
  @spec read(struct(), atom()) :: {:ok, value()} | :ignore
  def read(%M.ParamValue{param_id: "_HASH_CHECK"}, _autopilot), do: :ignore

  def read(%M.ParamValue{} = message, autopilot) do
    with true <- name?(message.param_id),
         %{param_encoding: encoding, param_tables: tables} = Firmware.traits(autopilot),
         {:ok, value, _exact?} <- ParamValue.decode(message.param_value, message.param_type, encoding) do
      name = if tables, do: MavCodec.Msp.Params.full(tables, message.param_id), else: message.param_id
      {:ok, {name, value, if(message.param_index == 0xFFFF, do: nil, else: message.param_index)}}
    else
      _garbage -> :ignore
    end
  end

  defp name?(name), do: PackedParams.name?(name) and not String.starts_with?(name, @counters)
end
