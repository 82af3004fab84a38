defmodule Aerie.Replay.Settings do
  @moduledoc "What a replay needs to know: of vehicles, and how their frames are read."
  use Aerie.Settings

  part :vehicle, Aerie.Vehicle.Settings
  part :link, Aerie.Link.Settings
end
