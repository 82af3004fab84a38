defmodule Aerie.FifthFirmware.Modes do
  @moduledoc "The flight modes of `Aerie.FifthFirmware.Adapter`: one, with the number 5."

  @behaviour Aerie.Vehicle.Firmware.Modes

  alias Aerie.Vehicle.Firmware.Modes

  @impl true
  def kinds, do: ["any"]
  @impl true
  def name(_kind, _base, custom), do: if(custom == 5, do: "FIVE", else: Modes.numbered(custom))
  @impl true
  def number(_kind, name), do: if(name == "FIVE", do: {:ok, 5}, else: :error)
  @impl true
  def asked(kind, base, custom), do: [name(kind, base, custom)]
  @impl true
  def wrong(_number), do: nil
  @impl true
  def all(_kind), do: ["FIVE"]
  @impl true
  def standard(_kind), do: %{}
  @impl true
  def arm_first(_kind, _mode), do: nil
end
