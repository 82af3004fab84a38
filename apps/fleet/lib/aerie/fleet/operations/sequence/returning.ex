defmodule Aerie.Fleet.Operations.Sequence.Returning do
  @moduledoc """
  The steps of a vehicle that returns with others: to its height first, so that their ways home are apart, and where
  two land at one place, after the other one.

  A firmware may climb by itself before it returns, to the height of a parameter of its own (`own_m/2`).
  """

  alias Aerie.Base.Names
  alias Aerie.Vehicle.Events.Journal
  alias MavCodec.Meaning.Shaping

  # Firmwares descend by 1.5 m/s, and somebody may come down from 400 m.
  @climb_s 300
  @landing_s 900
  # The place is free when the one before has landed, and this later.
  @clear_s 15
  @own for %{meaning: "the height of the way home", name: name, metres: metres} <- Shaping.all(),
           do: {name, metres}

  @doc "A vehicle that returns at `height` (m; nil: as it is), after `other` has landed (nil: at once)."
  @spec steps(vehicle :: String.t(), height :: number() | nil, other :: String.t() | nil) :: map()
  def steps(id, height, other) do
    climb = if height, do: climb(height), else: []

    queue =
      if other,
        do: [
          %{"wait" => "landed", "of" => other, "timeout_s" => @landing_s},
          %{"wait" => "time", "timeout_s" => @clear_s}
        ],
        else: []

    %{"vehicle" => id, "steps" => climb ++ queue ++ [%{"type" => "rtl"}]}
  end

  @doc "To its height, with `more` keys of the wait for it: 300 s, and one that is not there then has failed."
  @spec climb(height :: number(), more :: map()) :: [map()]
  def climb(height, more \\ %{}) do
    wait = %{"wait" => "at", "m" => height, "timeout_s" => @climb_s}
    [%{"type" => "set_altitude", "params" => %{"altitude" => height}}, Map.merge(wait, more)]
  end

  @doc """
  Metres above home to which the firmware climbs by itself before it returns, as its parameters were read the last time:
  0 if it keeps its height, nil if that is not known.
  """
  @spec own_m(Names.gateway(), vehicle :: String.t()) :: number() | nil
  def own_m(gateway, vehicle) do
    known =
      for {name, metres} <- @own,
          {:ok, value} when is_number(value) <- [Journal.param(gateway, vehicle, name)],
          do: max(value * metres, 0)

    Enum.max(known, fn -> nil end)
  end
end
