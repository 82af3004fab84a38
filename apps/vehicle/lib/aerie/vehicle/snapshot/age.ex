defmodule Aerie.Vehicle.Snapshot.Age do
  @moduledoc """
  The age of what the read model shows. Pure.

  A vehicle that is heard only from recordings lives in the recording's time, so its silence is measured against the
  last frame that was played, not against the present time.
  """

  @doc """
  Microseconds since a vehicle was last heard, at `now` (unix microseconds); nil if it never was. `links` are the
  gateway's link snapshots.
  """
  @spec silent_us(vehicle :: map(), links :: [map()], now :: integer()) :: non_neg_integer() | nil
  def silent_us(%{last_heard: nil}, _links, _now), do: nil

  def silent_us(%{last_heard: last_heard} = vehicle, links, now),
    do: since(now(vehicle, links, now), last_heard)

  defp since(now, at) when is_integer(now) and is_integer(at), do: max(now - at, 0)

  @doc """
  The time (unix microseconds) that the ages of a vehicle's state refer to: `now`, or the recording's time for a
  vehicle that is heard only from recordings.
  """
  @spec now(vehicle :: map(), links :: [map()], now :: integer()) :: integer()
  def now(%{links: ids}, links, now) do
    own = for link <- links, link.id in ids, do: link

    if own != [] and Enum.all?(own, &match?(%{spec: %{recorded: true}}, &1)),
      do: own |> Enum.map(&(&1.last_heard || 0)) |> Enum.max(),
      else: now
  end
end
