defmodule Aerie.Api.Rest.Operations.Commands.Cancel do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Commands

  @impl true
  def operation do
    %Operation{
      name: "command.cancel",
      meaning: "Cancels a command.",
      changes?: true,
      transfer?: false,
      fields: [field(:command, {:bytes, 512}, "its id", required: true)],
      answer: %{id: token(), state: %{const: "cancelling"}},
      routes: [
        delete("/api/vehicles/:id/commands/:command", "Cancels a command.",
          change: :cancel_command,
          status: 202
        )
      ]
    }
  end

  @impl true
  def run(%{command: id}, %{gateway: gateway, vehicle: vehicle, source: source, via: via}) do
    case Commands.cancel(gateway, vehicle, id, source, via) do
      :ok -> {:ok, %{id: id, state: "cancelling"}}
      {:error, :impossible, reason} -> {:error, {:conflict, reason}}
      {:error, unknown_or_role, reason} -> {:error, {unknown_or_role, reason}}
    end
  end
end
