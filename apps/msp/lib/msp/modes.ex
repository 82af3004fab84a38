defmodule Msp.Modes do
  @moduledoc """
  Flight modes of Betaflight and iNav, from the boxes that are on.

  Bit n of the mode flags is the n-th id of BOXIDS, which depends on build and configuration; the id itself is permanent. A mode's
  number is the permanent id of its box, 0 is ACRO, when none is on. The first box of the list that is on is the mode: a failsafe
  also switches ANGLE on.
  """

  import Bitwise

  @arm 0
  @failsafe 27
  @acro 0
  @autopilot 56

  @modes %{
    betaflight: [
      {27, "FAILSAFE"},
      {46, "GPS RESCUE"},
      {56, "AUTOPILOT"},
      {12, "PASSTHRU"},
      {11, "POS HOLD"},
      {3, "ALTHOLD"},
      {1, "ANGLE"},
      {2, "HORIZON"},
      {55, "CHIRP"},
      {47, "ACRO TRAINER"},
      {28, "AIR MODE"},
      {0, "ACRO"}
    ],
    inav: [
      {27, "FAILSAFE"},
      {12, "MANUAL"},
      {36, "NAV LAUNCH"},
      {10, "NAV RTH"},
      {28, "NAV WP"},
      {11, "NAV POSHOLD"},
      {53, "NAV CRUISE"},
      {45, "NAV COURSE HOLD"},
      {3, "NAV ALTHOLD"},
      {1, "ANGLE"},
      {2, "HORIZON"},
      {64, "ANGLE HOLD"},
      {29, "ACRO AIR"},
      {0, "ACRO"}
    ]
  }

  # MAV_STANDARD_MODE
  @standard %{
    betaflight: %{46 => 5, 11 => 1, 3 => 4},
    inav: %{10 => 5, 11 => 1, 28 => 6, 3 => 4, 53 => 3}
  }

  @type firmware :: MavCodec.Msp.Messages.firmware()

  @doc "The modes of a firmware, the first of those whose boxes are on being the mode."
  @spec all(firmware) :: [{number :: byte, name :: String.t()}]
  def all(firmware), do: Map.fetch!(@modes, firmware)

  @doc "The name of a mode's number."
  @spec name(firmware, byte) :: String.t() | nil
  def name(firmware, number), do: List.keyfind(all(firmware), number, 0, {nil, nil}) |> elem(1)

  @doc "The MAV_STANDARD_MODE of a mode, 0 for a mode without one."
  @spec standard(firmware, byte) :: non_neg_integer
  def standard(firmware, number), do: Map.get(@standard[firmware], number, 0)

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
    cond do
      %{betaflight: 46, inav: 10}[firmware] in boxes -> "RTH"
      firmware == :betaflight and @autopilot in boxes -> "AUTOPILOT"
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
