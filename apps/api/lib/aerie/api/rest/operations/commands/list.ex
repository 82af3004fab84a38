defmodule Aerie.Api.Rest.Operations.Commands.List do
  @moduledoc """
  Each command of the table, and why it need not be offered: `lacks` is `firmware` or `permission`, null if it may be
  given. Whether it would be carried out now is another matter.
  """
  use Aerie.Control.Operations.Operation

  alias Aerie.Base.Json.Object
  alias Aerie.Control.Commands
  alias Aerie.Fleet
  alias Aerie.Vehicle.Command

  @offer Object.fields([
           {:type, :text, nil, "name of the command"},
           {:lacks, {:one_of, [:firmware, :permission]}, nil, "why it may not be given; null if it may"},
           {:permission, :text, nil, "the permission that is missing"},
           {:reason, :text, nil, "a sentence for people"}
         ])
  @answer Object.fields([{:commands, {:list, {:object, @offer}}, nil, "all of them"}])

  @impl true
  def operation do
    %Operation{
      name: "command.list",
      meaning: "Lists the commands, and which of them may not be given to a vehicle.",
      transfer?: false,
      answer: @answer,
      routes: [get("/api/vehicles/:id/commands", "Which commands this key may give to the vehicle.")]
    }
  end

  @impl true
  def run(_input, %{gateway: gateway, vehicle: id, source: source}) do
    if vehicle = Fleet.vehicle(gateway, id) do
      offers = for %{name: name} <- Command.types(), do: offer(name, Commands.lacks(vehicle, name, source))
      {:ok, Object.show(@answer, %{commands: offers})}
    else
      {:error, {:unknown, "no vehicle has this name; see /api/vehicles"}}
    end
  end

  defp offer(type, nil), do: %{type: type}
  defp offer(type, {:firmware, reason}), do: %{type: type, lacks: :firmware, reason: reason}

  defp offer(type, {:permission, permission, reason}),
    do: %{type: type, lacks: :permission, permission: permission, reason: reason}
end
