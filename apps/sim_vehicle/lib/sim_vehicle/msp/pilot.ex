defmodule SimVehicle.Msp.Pilot do
  @moduledoc "A pilot with a transmitter: the channels of a short flight, again and again. A function of time."

  @cycle_s 150
  @neutral 1500
  @low 1000
  @on 1900

  @doc "Roll, pitch, throttle, yaw and four switches (arm, angle, return, none) `us` after the start."
  @spec channels(us :: non_neg_integer) :: [integer]
  def channels(us) do
    case rem(div(us, 1_000_000), @cycle_s) do
      s when s < 10 -> sticks(@neutral, @low, @neutral, false)
      # The throttle stays low until the motors run.
      s when s < 12 -> sticks(@neutral, @low, @neutral, true)
      s when s < 20 -> sticks(@neutral, 1750, @neutral, true)
      s when s < 100 -> sticks(1800, @neutral, 1600, true)
      s when s < 125 -> sticks(@neutral, 1300, @neutral, true)
      s when s < 127 -> sticks(@neutral, @low, @neutral, true)
      _s -> sticks(@neutral, @low, @neutral, false)
    end
  end

  defp sticks(pitch, throttle, yaw, armed?) do
    switch = if armed?, do: @on, else: @low
    [@neutral, pitch, throttle, yaw, switch, switch | List.duplicate(@low, 10)]
  end
end
