defmodule Aerie.Fleet.Replay.Settings do
  @moduledoc "What a replay needs to know: of vehicles, and how their frames are read."
  use Aerie.Base.Settings

  part :vehicle, Aerie.Vehicle.Settings
  part :link, MavRouter.Link.Settings
end
