defmodule Aerie.Vehicle.Firmware.Modes.Flags do
  @moduledoc "The modes of a firmware whose numbers nobody here knows: the flags of its heartbeat."

  @behaviour Aerie.Vehicle.Firmware.Modes

  import Bitwise

  alias Aerie.Vehicle.Firmware.Modes

  # MAV_MODE_FLAG
  @custom 0x01
  @auto 0x04
  @guided 0x08
  @stabilize 0x10
  @manual 0x40

  @impl true
  def kinds, do: []

  @impl true
  def name(_kind, base, custom) do
    cond do
      band(base, @auto) != 0 -> "AUTO"
      band(base, @guided) != 0 -> "GUIDED"
      band(base, @stabilize) != 0 -> "STABILIZE"
      band(base, @manual) != 0 -> "MANUAL"
      band(base, @custom) != 0 -> Modes.numbered(custom)
      true -> "PREFLIGHT"
    end
  end

  @impl true
  def number(_kind, _name), do: :error

  @impl true
  def asked(kind, base, custom) do
    if band(base, @custom) != 0,
      do: [name(kind, base, custom), Modes.numbered(custom)],
      else: [name(kind, base, 0)]
  end

  @impl true
  def wrong(_number), do: nil

  # The vehicle itself says which ones it has (AVAILABLE_MODES).
  @impl true
  def all(_kind), do: []

  @impl true
  def standard(_kind), do: %{}

  @impl true
  def arm_first(_kind, _mode), do: nil
end
