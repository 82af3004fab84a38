defmodule Aerie.Vehicle.Collision do
  @moduledoc """
  Two vehicles with one id on one network, as others ask about it. `Aerie.Vehicle.Twin` finds them; the snapshot shows
  `collision: %{at, sign, links}` for a minute after the last sign.
  """

  alias Aerie.Fleet.Store
  alias Aerie.Names

  @type t :: %{at: integer(), sign: String.t(), links: [[term()]]}

  @doc "The collision that there is just now on a vehicle's id: its sign, and the links of the one and of the other; or nil."
  @spec of(Names.gateway(), Store.vehicle_key()) :: t() | nil
  def of(gateway, key) do
    case Store.vehicle(gateway, key) do
      %{collision: collision} -> collision
      _none -> nil
    end
  end

  @doc """
  Whether two links carry different vehicles under this id: then they are not redundant ways to one, and what one of them
  brings is no copy of what the other does.
  """
  @spec apart?(Names.gateway(), Store.vehicle_key(), term(), term()) :: boolean()
  def apart?(gateway, key, link, other) do
    case of(gateway, key) do
      %{links: [ones, others]} -> split?(ones, others, link, other) or split?(ones, others, other, link)
      nil -> false
    end
  end

  defp split?(ones, others, a, b), do: a in ones and a not in others and b in others and b not in ones
end
