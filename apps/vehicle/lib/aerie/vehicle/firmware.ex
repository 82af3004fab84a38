defmodule Aerie.Vehicle.Firmware do
  @moduledoc """
  The firmwares that Aerie knows, and the adapter of each: a module with the behaviour `Aerie.Vehicle.Protocol`. What is
  particular to a firmware is in the folder of its name, `firmware/NAME`.
  """

  @doc "The adapter of a firmware."
  @spec of(Aerie.Vehicle.Kind.autopilot()) :: module()
  def of(:ardupilot), do: __MODULE__.Ardupilot.Adapter
  def of(:px4), do: __MODULE__.Px4.Adapter
  def of(msp) when msp in [:betaflight, :inav], do: __MODULE__.Msp.Adapter
  def of(:generic), do: __MODULE__.Unknown
end
