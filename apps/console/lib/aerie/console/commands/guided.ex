defmodule Aerie.Console.Commands.Guided do
  @moduledoc """
  Commands for a place on the map: the menu of the place, and the texts of the card that prepares
  the command. Pure.
  """

  alias Aerie.Control.Commands

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

  @doc "The acts, by the type of their command."
  @spec act(String.t()) :: act() | nil
  def act(type), do: with({_type, act} <- List.keyfind(@acts, type, 0), do: act)

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
          do: %{act: type, label: act.label, refusal: refusal(Commands.lacks(vehicle, type, user))}

    %{vehicle: id, items: items, path: page}
  end

  defp refusal(nil), do: nil
  defp refusal({:firmware, reason}), do: "Not available: #{reason}"
  defp refusal({:permission, _permission, reason}), do: "Not allowed: #{reason}"
end
