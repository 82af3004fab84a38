defmodule Aerie.Vehicle.Firmware.GroundStation do
  @moduledoc """
  Which ground station's heartbeats keep the failsafe of a firmware quiet (H5), and the parameters that say so. The
  defaults are those of an unknown one: it is asked for none, and what it sends is read by the most common names.
  """

  defstruct listens_to: :unknown,
            ids: [],
            enabled: ~w(FS_GCS_ENABLE FS_GCS_ENABL),
            timeout: ~w(FS_GCS_TIMEOUT FS_LONG_TIMEOUT),
            timeout_us: 5_000_000,
            asks: []

  @typedoc """
    * `:listens_to` - `:any` ground station, those whose ids the parameters say (`:ids`), or `:unknown`
    * `:ids` - the parameters of the lowest and highest id, as different versions have them: the first that is known
      counts
    * `:enabled`, `:timeout` - the parameters of the failsafe, as different kinds of vehicles have them
    * `:timeout_us` - the silence after which it acts, as long as the parameter is not known
    * `:asks` - the parameters that are read from a vehicle, in this order
  """
  @type t :: %__MODULE__{}

  @doc "The names of all its parameters."
  @spec names(t()) :: [String.t()]
  def names(station),
    do:
      for({low, high} <- station.ids, name <- [low, high], name != nil, do: name) ++
        station.enabled ++ station.timeout
end
