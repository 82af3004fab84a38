defmodule Aerie.Vehicle.Fleet do
  @moduledoc """
  Who carries what vehicles say to the fleet, and remembers over restarts what it was told: a module that is given to
  `Aerie.Vehicle.Supervisor` (`:fleet`). Without one nothing is told and nothing remembered.
  """

  alias Aerie.Names

  @doc "Publishes a sample of a state group of a vehicle, without waiting: `%{data: map, time_boot_ms: number or nil}`."
  @callback publish_state(Names.gateway(), vehicle :: String.t(), group :: atom, sample :: map, at :: integer) ::
              :ok

  @doc "What the last life of the gateway told of a vehicle, or nil."
  @callback remembered(Names.gateway(), vehicle :: String.t()) :: Aerie.Vehicle.Detector.Found.t()
end
