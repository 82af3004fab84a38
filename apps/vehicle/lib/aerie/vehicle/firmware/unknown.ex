defmodule Aerie.Vehicle.Firmware.Unknown do
  @moduledoc "A firmware that is not in the list: the default of everything."

  use Aerie.Vehicle.Firmware.Adapter
end
