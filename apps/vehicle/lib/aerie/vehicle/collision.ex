defmodule Aerie.Vehicle.Collision do
  @moduledoc """
  Two vehicles with one id on one network, as others ask about it. `Aerie.Vehicle.Twin` finds them; `Aerie.Vehicle.Rivals`
  says which of them keeps the id where each has links, or peers of links, of its own; the router keeps them apart
  (`Aerie.Router.Apart`). The snapshot shows `collision: %{at, sign, links, ways}` for a minute after the last sign: those
  of the one that keeps the id first, `links` in words.
  """

  alias Aerie.Store
  alias Aerie.Names

  @type t :: %{at: integer(), sign: String.t(), links: [[String.t()]], ways: [[Aerie.Vehicle.Rivals.way()]]}

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
      %{ways: ways} ->
        [ones, others] = for side <- ways, do: Enum.map(side, &Aerie.Vehicle.Rivals.link/1)
        split?(ones, others, link, other) or split?(ones, others, other, link)

      nil ->
        false
    end
  end

  defp split?(ones, others, a, b), do: a in ones and a not in others and b in others and b not in ones
end
