defmodule Msp.Firmware.Arming do
  @moduledoc """
  What keeps a vehicle from being armed: names of the arming flags, whose bits differ between firmwares and versions
  (`Msp.Firmware`).
  """

  import Bitwise

  alias Msp.Firmware

  @type flags :: non_neg_integer

  @doc """
  The names of the flags that are on, a number for one without a name.

      iex> Msp.Firmware.Arming.names({:betaflight, {1, 46}}, 0b100 + 0x2000000)
      ["RX_FAILSAFE", "ARM_SWITCH"]
      iex> Msp.Firmware.Arming.names({:inav, {9, 0}}, 0b1100)
      []
  """
  @spec names(MavCodec.Msp.Guard.target(), flags) :: [String.t()]
  def names({firmware, version}, flags) do
    facts = Firmware.of(firmware)
    named(flags &&& bnot(facts.arming_states), since(facts.arming, version) || %{})
  end

  # By the first version that has it.
  defp since(rows, version) do
    Enum.find_value(rows, fn {first, what} -> if version >= first, do: what end)
  end

  defp named(flags, names) do
    for bit <- 0..31, bit?(flags, bit), do: Map.get(names, bit, "flag #{bit}")
  end

  @doc "Whether the receiver is lost; nil where the flags do not say."
  @spec rc_lost?(MavCodec.Msp.Guard.target(), flags, armed? :: boolean) :: boolean | nil
  def rc_lost?({firmware, _version}, flags, armed?) do
    case Firmware.of(firmware).rx_lost do
      {_bit, :disarmed} when armed? -> nil
      {bit, _when} -> bit?(flags, bit)
    end
  end

  @doc "Whether the vehicle has just started: Betaflight does not arm for some seconds after that."
  @spec booting?(MavCodec.Msp.Guard.target(), flags) :: boolean
  def booting?({firmware, version}, flags) do
    bit = since(Firmware.of(firmware).booting, version)
    bit != nil and bit?(flags, bit)
  end

  defp bit?(flags, bit), do: (flags >>> bit &&& 1) == 1
end
