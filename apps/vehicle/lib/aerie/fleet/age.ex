defmodule Aerie.Fleet.Age do
  @moduledoc """
  How old something in the read model is: pure.

  A vehicle that is heard only from recordings lives in the recording's time, so its silence is measured against the last
  frame of the recording that was played, not against today.
  """

  @doc """
  Microseconds since a vehicle was last heard at `now` (unix microseconds); nil when it never was. `links` are the
  gateway's link snapshots.
  """
  @spec silent_us(vehicle :: map(), links :: [map()], now :: integer()) :: non_neg_integer() | nil
  def silent_us(%{last_heard: nil}, _links, _now), do: nil

  def silent_us(%{last_heard: last_heard} = vehicle, links, now),
    do: since(now(vehicle, links, now), last_heard)

  defp since(now, at) when is_integer(now) and is_integer(at), do: max(now - at, 0)

  @doc """
  The time (unix microseconds) to measure the ages of a vehicle's state against: `now`, or the recording's own for a vehicle
  that is heard from recordings only.
  """
  @spec now(vehicle :: map(), links :: [map()], now :: integer()) :: integer()
  def now(%{links: ids}, links, now) do
    own = for link <- links, link.id in ids, do: link

    if own != [] and Enum.all?(own, &(&1[:kind] == :replay)),
      do: own |> Enum.map(&(&1.last_heard || 0)) |> Enum.max(),
      else: now
  end
end
