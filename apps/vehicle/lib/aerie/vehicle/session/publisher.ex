defmodule Aerie.Vehicle.Session.Publisher do
  @moduledoc """
  Publishes the state of vehicles, and knows after a restart what was published last. `Aerie.Fleet.Bridge` is one; it is given to
  `Aerie.Vehicle.Supervisor` as `:publisher`. Without a publisher, nothing is published or remembered.
  """

  alias Aerie.Base.Names

  @doc "Publishes a sample of a vehicle's state group without waiting: `%{data: map, time_boot_ms: ms or nil}`."
  @callback publish_state(Names.gateway(), vehicle :: String.t(), group :: atom, sample :: map, at :: integer) ::
              :ok

  @doc "The vehicle's state as last published before the gateway was started, or nil."
  @callback remembered(Names.gateway(), vehicle :: String.t()) ::
              Aerie.Vehicle.Events.Detector.OfflineChanges.t()
end
