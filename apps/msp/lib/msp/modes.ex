defmodule Msp.Modes do
  @moduledoc """
  Flight modes of Betaflight and iNav, from the boxes that are on.

  Bit n of the mode flags is the n-th id of BOXIDS, which depends on build and configuration; the id itself is permanent. A mode's
  number is the permanent id of its box, 0 is ACRO, when none is on. The first box of the list that is on is the mode: a failsafe
  also switches ANGLE on.
  """

  import Bitwise

  alias Msp.Firmware

  @arm 0
  @failsafe 27
  @acro 0

  @type firmware :: MavCodec.Msp.Messages.firmware()

  @doc "The modes of a firmware, the first of those whose boxes are on being the mode."
  @spec all(firmware) :: [{number :: byte, name :: String.t()}]
  def all(firmware), do: Firmware.of(firmware).modes

  @doc "The name of a mode's number."
  @spec name(firmware, byte) :: String.t() | nil
  def name(firmware, number), do: List.keyfind(all(firmware), number, 0, {nil, nil}) |> elem(1)

  @doc "The MAV_STANDARD_MODE of a mode, 0 for a mode without one."
  @spec standard(firmware, byte) :: non_neg_integer
  def standard(firmware, number), do: Map.get(Firmware.of(firmware).standard, number, 0)

  @doc """
  The permanent ids of the boxes that are on.

      iex> Msp.Modes.boxes(0b101, [0, 1, 2, 27])
      MapSet.new([0, 2])
  """
  @spec boxes(non_neg_integer, [byte]) :: MapSet.t(byte)
  def boxes(flags, ids) do
    for {id, bit} <- Enum.with_index(ids), (flags >>> bit &&& 1) == 1, into: MapSet.new(), do: id
  end

  @doc "The number of the mode; ARM says nothing about it."
  @spec mode(firmware, MapSet.t(byte)) :: byte
  def mode(firmware, boxes) do
    Enum.find_value(all(firmware), @acro, fn {id, _name} -> if id != @arm and id in boxes, do: id end)
  end

  @doc "What a vehicle in a failsafe does: it returns, or flies a plan, if the box for that is on; else it comes down."
  @spec failsafe_action(firmware, MapSet.t(byte)) :: String.t()
  def failsafe_action(firmware, boxes) do
    %{returns: home, plan: plan} = Firmware.of(firmware)

    cond do
      home in boxes -> "RTH"
      plan in boxes -> "AUTOPILOT"
      true -> "landing"
    end
  end

  @doc "Whether the vehicle is armed."
  @spec armed?(MapSet.t(byte)) :: boolean
  def armed?(boxes), do: @arm in boxes

  @doc "Whether a failsafe is active."
  @spec failsafe?(MapSet.t(byte)) :: boolean
  def failsafe?(boxes), do: @failsafe in boxes
end
