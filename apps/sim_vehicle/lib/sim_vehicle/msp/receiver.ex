defmodule SimVehicle.Msp.Receiver do
  @moduledoc """
  Where a simulated flight controller has its channels from: its own receiver, MSP as the receiver (RX_MSP, `receiver_type`), or its own
  with some channels overridden by MSP while the switch for that is on. Values out of range leave a channel as it was. A value.
  """

  @valid 885..2115
  # iNav drops an override that is older.
  @override_us 500_000
  @override_box 50

  defstruct pilot: [1500, 1500, 1000, 1500 | List.duplicate(1000, 12)], msp: nil, msp_at: nil, mask: 0

  @type t :: %__MODULE__{}

  @doc "SET_RAW_RC: channels in the receiver's order; `map` is RX_MAP."
  @spec set(t, binary, map :: binary, now :: integer) :: t
  def set(receiver, payload, map, now) do
    raw = for <<us::16-little <- payload>>, do: us
    before = receiver.msp || receiver.pilot

    # Roll, pitch, yaw, throttle by the map, then the others as they come.
    functions = for {us, n} <- Enum.with_index(raw), do: Enum.at(raw, at(map, n), us)
    ordered = order(functions)

    channels =
      for {old, n} <- Enum.with_index(before) do
        us = Enum.at(ordered, n)
        if us in @valid, do: us, else: old
      end

    %{receiver | msp: channels, msp_at: now}
  end

  defp at(map, n), do: if(n < byte_size(map), do: :binary.at(map, n), else: n)
  # Roll, pitch, throttle, yaw, as the simulator has them.
  defp order([roll, pitch, yaw, throttle | more]), do: [roll, pitch, throttle, yaw | more]
  defp order(few), do: few

  @doc "The channels now; `msp?`: MSP is the receiver."
  @spec channels(t, msp? :: boolean, boxes :: MapSet.t(), now :: integer) :: [integer]
  def channels(receiver, true, _boxes, _now), do: receiver.msp || receiver.pilot

  def channels(receiver, false, boxes, now) do
    if receiver.msp != nil and now - receiver.msp_at <= @override_us and @override_box in boxes,
      do: Enum.zip_with([receiver.pilot, receiver.msp, 0..15], &overridden(&1, receiver.mask)),
      else: receiver.pilot
  end

  defp overridden([pilot, msp, n], mask),
    do: if(Bitwise.band(Bitwise.bsr(mask, n), 1) == 1, do: msp, else: pilot)
end
