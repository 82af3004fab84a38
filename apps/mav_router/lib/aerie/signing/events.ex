defmodule Aerie.Signing.Events do
  @moduledoc """
  Who keeps the events of vehicles: a module that is given to `Aerie.Signing.Supervisor` (`:events`). Without one what happens
  to keys and signatures is in the log and in telemetry only.
  """

  @doc """
  Something happened to a vehicle at a time (unix microseconds): the type of the event (`signing.rejected`) and its data.
  Nothing is kept for a vehicle that is not known.
  """
  @callback event(
              Aerie.Names.gateway(),
              {network :: String.t(), system :: non_neg_integer},
              type :: String.t(),
              data :: map,
              at :: integer
            ) :: :ok
end
