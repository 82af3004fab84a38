defmodule Aerie.Api.Rest.Operations.Commands.Get do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Commands
  alias Aerie.Vehicle.Command

  @impl true
  def operation do
    summary = "The progress of a command, or its result."

    %Operation{
      name: "command.get",
      meaning: summary,
      transfer?: false,
      fields: [field(:command, {:bytes, 512}, "its id", required: true)],
      answer: [:result, :under_way],
      routes: [get("/api/vehicles/:id/commands/:command", summary)]
    }
  end

  @impl true
  def run(%{command: id}, %{gateway: gateway, vehicle: vehicle}) do
    case Commands.state(gateway, vehicle, id) do
      {:ok, result} -> {:ok, Map.put(Command.plain(result), "state", "done")}
      {:under_way, job} -> {:ok, job |> Map.take([:vehicle, :type, :source, :progress]) |> under_way(id)}
      nil -> {:error, {:unknown, "no command of this vehicle has this id"}}
      {:error, reason} -> {:error, {:unavailable, reason}}
    end
  end

  defp under_way(job, id), do: Map.merge(job, %{id: id, state: "under_way"})
end
