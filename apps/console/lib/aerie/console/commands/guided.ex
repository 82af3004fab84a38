defmodule Aerie.Console.Commands.Guided do
  @moduledoc """
  Commands for a place on the map: the menu of the place, and the texts of the card that prepares
  the command. Pure.
  """

  alias Aerie.Control.Commands
  alias Aerie.Fleet

  @typedoc "`fields`: parameters beside the place, in their order. `moves?`: the vehicle flies there."
  @type act :: %{
          label: String.t(),
          title: String.t(),
          press: String.t(),
          icon: String.t(),
          fields: [String.t()],
          moves?: boolean()
        }

  @acts [
    {"goto",
     %{
       label: "Go here",
       title: "Go to a place",
       press: "Go there",
       icon: "goto",
       fields: ~w(altitude speed),
       moves?: true
     }},
    {"land_here",
     %{
       label: "Land here",
       title: "Land at a place",
       press: "Land there",
       icon: "land",
       fields: ~w(altitude speed),
       moves?: true
     }},
    {"set_roi",
     %{
       label: "Look here",
       title: "Look at a place",
       press: "Look there",
       icon: "eye",
       fields: ~w(altitude),
       moves?: false
     }},
    {"orbit",
     %{
       label: "Orbit",
       title: "Circle around a place",
       press: "Circle there",
       icon: "restart",
       fields: ~w(radius altitude speed),
       moves?: true
     }},
    {"set_home",
     %{
       label: "Set home",
       title: "Set home at a place",
       press: "Set home there",
       icon: "home",
       fields: ~w(altitude_msl),
       moves?: false
     }}
  ]

  @doc "The acts, by the type of their command, or the name of the operation."
  @spec act(String.t()) :: act() | nil
  def act(type), do: with({_type, act} <- List.keyfind(@acts, type, 0), do: act)

  @doc "The commands of an act, of which the first has its fields."
  @spec commands(String.t()) :: [String.t(), ...]
  def commands("land_here"), do: ~w(goto land)
  def commands(type), do: [type]

  @doc "Why a vehicle cannot do it now, beside what its firmware lacks and the policy says."
  @spec cannot(vehicle :: map(), String.t()) :: String.t() | nil
  def cannot(vehicle, "land_here"), do: Fleet.cannot_land_at(vehicle)
  def cannot(_vehicle, _type), do: nil

  @doc """
  The menu of a vehicle's places, as the map has it: what the firmware lacks, or the user may not do, has the reason.
  `page`: the path of the vehicle's page, if a choice leads there.
  """
  @spec menu(vehicle :: map(), map(), page :: String.t() | nil) :: map()
  def menu(vehicle, user, page \\ nil)

  def menu(%{id: id}, %{role: :viewer, name: name}, _page),
    do: %{vehicle: id, items: [], note: "#{name} can only watch this vehicle."}

  def menu(%{id: id} = vehicle, user, page) do
    items =
      for {type, act} <- @acts,
          do: %{act: type, label: act.label, refusal: refusal(vehicle, type, user)}

    %{vehicle: id, items: items, path: page}
  end

  defp refusal(vehicle, type, user) do
    case Enum.find_value(commands(type), &Commands.lacks(vehicle, &1, user)) do
      nil -> with(<<why::binary>> <- cannot(vehicle, type), do: "Not now: #{why}")
      {:firmware, reason} -> "Not available: #{reason}"
      {:permission, _permission, reason} -> "Not allowed: #{reason}"
    end
  end
end
