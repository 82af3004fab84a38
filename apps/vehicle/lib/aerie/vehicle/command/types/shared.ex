defmodule Aerie.Vehicle.Command.Types.Shared do
  @moduledoc "Parameters that several commands have, so that they mean the same and have the same range everywhere."

  alias Aerie.Vehicle.Command.Param

  # Above any airspace that a vehicle of this kind may use, below the depth of any dive; policy sets the real limits.
  @highest 20_000
  @lowest -11_000

  @doc "Latitude and longitude, WGS 84."
  @spec place(keyword()) :: [Param.t()]
  def place(options \\ []) do
    [
      Param.number(:lat, "°", -90, 90, "latitude, WGS 84, north is positive", options),
      Param.number(:lon, "°", -180, 180, "longitude, east is positive", options)
    ]
  end

  @doc "A height and what it is above."
  @spec altitude(String.t(), keyword()) :: [Param.t()]
  def altitude(meaning, options \\ []) do
    [
      Param.number(:altitude, "m", @lowest, @highest, meaning, options),
      Param.choice(
        :altitude_reference,
        ~w(home msl terrain),
        "what the altitude is above: home, mean sea level, or the ground below",
        default: "home"
      )
    ]
  end

  @doc "A height above mean sea level, and nothing else."
  @spec altitude_msl(keyword()) :: Param.t()
  def altitude_msl(options \\ []),
    do: Param.number(:altitude_msl, "m", @lowest, @highest, "height above mean sea level", options)

  @doc "A heading."
  @spec heading(atom(), String.t()) :: Param.t()
  def heading(name, meaning), do: Param.number(name, "°", 0, 360, meaning)

  @doc "A component of the vehicle that takes the command in place of the usual one."
  @spec component() :: Param.t()
  def component,
    do:
      Param.integer(
        :component,
        nil,
        1,
        255,
        "component id of the device; without it the firmware's usual one"
      )
end
