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

  def silent_us(%{last_heard: last_heard, links: ids}, links, now) do
    case for link <- links, link.id in ids, do: link do
      [_ | _] = own -> since(last_heard, clock(own, now))
      [] -> since(last_heard, now)
    end
  end

  defp since(then, now) when is_integer(then) and is_integer(now), do: max(now - then, 0)

  defp clock(links, now) do
    if Enum.all?(links, &(&1.kind == :replay)) do
      links |> Enum.map(&(&1.last_heard || 0)) |> Enum.max()
    else
      now
    end
  end
end
