defmodule Aerie.Console.Pages.Replay.TimeLine do
  @moduledoc "The rows of the time line and the chunks of the map, as the browser gets them. Pure."

  # Samples of one minute each; one may come a little late.
  @apart_s 90

  @typedoc "`[from, to, state]`: unix seconds; 1 heard, 2 in the air, 3 lost. Where there is none, nothing is known."
  @type span :: [integer(), ...]

  @doc "What a vehicle did, from its samples of about a minute (`Aerie.Fleet.tracks/6`)."
  @spec spans([map()]) :: [span()]
  def spans(samples) do
    samples
    |> Enum.map(&{div(&1.at, 1_000_000), state(&1)})
    |> Enum.reduce([], &span/2)
    |> Enum.reverse()
    |> Enum.map(&Tuple.to_list/1)
  end

  defp span({at, state}, [{from, to, state} | rest]) when at - to <= @apart_s, do: [{from, at, state} | rest]

  # What a sample says is true until the next one.
  defp span({at, state}, [{from, to, before} | rest]) when at - to <= @apart_s,
    do: [{at, at, state}, {from, at, before} | rest]

  defp span({at, state}, spans), do: [{at, at, state} | spans]

  defp state(%{status: :lost}), do: 3
  defp state(%{in_air: true}), do: 2
  defp state(_heard), do: 1

  @doc """
  A vehicle's samples for the map: `[second, lat, lon, height, heading, speed, battery, mode, state, in_air]`, with what
  the map calls its state. Those without a place are left out.
  """
  @spec rows([map()]) :: [[term(), ...]]
  def rows(samples) do
    for %{lat: lat, lon: lon} = sample when lat != nil and lon != nil <- samples do
      [
        Float.round(sample.at / 1_000_000, 1),
        lat,
        lon,
        sample.height,
        sample.heading,
        sample.speed,
        sample.battery,
        sample.mode,
        drawn(sample),
        sample.in_air
      ]
    end
  end

  defp drawn(%{status: status}) when status != :online, do: status
  defp drawn(%{armed: true}), do: :armed
  defp drawn(_sample), do: :disarmed
end
