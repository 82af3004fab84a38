defmodule Aerie.Api.Rest.Commands do
  @moduledoc """
  What a key may command, and what became of a command (`Aerie.Api.Rest.Operations.Commands.Give` gives one).
  """

  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.Command
  alias Aerie.Control.Commands
  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.HTTP.Error

  @doc "The state of a command: its result (`state` is `done`), or its progress (`under_way`)."
  @spec state(term(), String.t(), String.t()) :: {:ok, map()} | {:error, Error.t()}
  def state(gateway, vehicle, id) do
    case Commands.state(gateway, vehicle, id) do
      {:ok, result} ->
        {:ok, Map.put(Command.plain(result), "state", "done")}

      {:under_way, job} ->
        {:ok,
         %{
           "id" => id,
           "vehicle" => job.vehicle,
           "type" => job.type,
           "source" => job.source,
           "progress" => job.progress,
           "state" => "under_way"
         }}

      nil ->
        {:error, Error.new(:not_found, "no command of this vehicle has this id")}

      {:error, reason} ->
        {:error, Error.new(:unavailable, reason)}
    end
  end

  @doc "Cancels a command."
  @spec cancel(term(), String.t(), String.t(), Roles.source()) :: {:ok, map()} | {:error, Error.t()}
  def cancel(gateway, vehicle, id, source) do
    case Commands.cancel(gateway, vehicle, id, source, "rest") do
      :ok -> {:ok, %{"id" => id, "state" => "cancelling"}}
      {:error, :unknown, reason} -> {:error, Error.new(:not_found, reason)}
      {:error, :role, reason} -> {:error, Error.new(:forbidden, reason)}
      {:error, :impossible, reason} -> {:error, Error.new(:conflict, reason)}
    end
  end

  @fields Object.fields([
            {:type, :text, nil, "name of the command"},
            {:lacks, {:one_of, [:firmware, :permission]}, nil, "why it may not be given; null if it may"},
            {:permission, :text, nil, "the permission that is missing"},
            {:reason, :text, nil, "a sentence for people"}
          ])

  @doc "The table of commands: for forms, and for programs that want to know what can be commanded."
  @spec types() :: [map()]
  def types, do: for(type <- Command.types(), do: Object.show(Command.type_fields(), type))

  @doc "The fields of an offer."
  @spec offer_fields() :: [Object.t()]
  def offer_fields, do: @fields

  @doc """
  Each command of the table, and why it need not be offered: `lacks` is `firmware` or `permission`, null if it may be
  given. Whether it would be carried out now is another matter. nil: there is no such vehicle.
  """
  @spec offers(term(), vehicle :: String.t(), Roles.source()) :: map() | nil
  def offers(gateway, id, source) do
    with %{} = vehicle <- Aerie.Fleet.vehicle(gateway, id),
         do: %{
           "commands" =>
             for(%{name: name} <- Command.types(), do: offer(name, Commands.lacks(vehicle, name, source)))
         }
  end

  defp offer(type, nil), do: %{"type" => type, "lacks" => nil, "permission" => nil, "reason" => nil}

  defp offer(type, {:firmware, reason}),
    do: %{"type" => type, "lacks" => "firmware", "permission" => nil, "reason" => reason}

  defp offer(type, {:permission, permission, reason}),
    do: %{"type" => type, "lacks" => "permission", "permission" => permission, "reason" => reason}
end
