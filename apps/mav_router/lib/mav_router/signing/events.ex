defmodule MavRouter.Signing.Events do
  @moduledoc """
  The module that keeps the events of vehicles, given to `MavRouter.Signing.Supervisor` (`:events`). Without one, events of keys and
  signatures are in the log and in telemetry only.
  """

  @doc """
  Keeps an event of a vehicle: its type (`signing.rejected`), data and time (unix microseconds). A vehicle that is not known has none.
  """
  @callback event(
              Aerie.Base.Names.gateway(),
              {network :: String.t(), system :: non_neg_integer},
              type :: String.t(),
              data :: map,
              at :: integer
            ) :: :ok
end
