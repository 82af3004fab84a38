defmodule Aerie.Console.Pages.Vehicle.Fly.Instruments do
  @moduledoc "The values for a vehicle's flight display: the newest ones, and null for those that are too old. Pure."

  # Instruments show present values or nothing. HIGH_LATENCY2 has no attitude, so its slow rate does not matter here.
  @fresh_us 3_000_000
  @values [
    roll: {:attitude, :roll},
    pitch: {:attitude, :pitch},
    height: {:position, :alt_rel},
    speed: {:velocity, :groundspeed},
    airspeed: {:velocity, :airspeed},
    climb: {:velocity, :climb}
  ]

  @doc "The values of a vehicle's snapshot, whose ages refer to `Aerie.Vehicle.Snapshot.now/3`."
  @spec sample(map(), integer()) :: map()
  def sample(vehicle, now) do
    for({name, path} <- @values, into: %{}, do: {name, value(vehicle, path, now)})
    |> Map.put(:heading, heading(vehicle, now))
    |> Map.put(:vehicle, vehicle.id)
  end

  # The position's heading is 0..360; a vehicle without a position has its yaw.
  defp heading(vehicle, now) do
    with nil <- value(vehicle, {:position, :heading}, now),
         yaw when is_number(yaw) <- value(vehicle, {:attitude, :yaw}, now),
         do: if(yaw < 0, do: yaw + 360, else: yaw)
  end

  defp value(%{groups: groups}, {group, key}, now) do
    with %{at: at, data: data} when now - at <= @fresh_us <- groups[group],
         number when is_number(number) <- data[key],
         do: Float.round(number * 1.0, 3),
         else: (_none -> nil)
  end
end
