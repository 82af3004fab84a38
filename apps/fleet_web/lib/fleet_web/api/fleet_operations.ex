defmodule FleetWeb.API.FleetOperations do
  @moduledoc "Operations on many vehicles over REST: `Aerie.Fleet.Operations` in the name of a key, as commands are (`FleetWeb.API.Commands`)."

  alias Aerie.Fleet.Operations
  alias FleetWeb.API.{Access, Commands, Error}

  @codes %{
    role: :forbidden,
    busy: :too_many,
    conflict: :conflict,
    unknown: :not_found,
    unavailable: :unavailable
  }

  @doc "All operations, without their vehicles."
  @spec list(term()) :: map()
  def list(gateway), do: %{operations: Operations.list(gateway)}

  @doc "An operation with what became of each vehicle."
  @spec get(term(), String.t()) :: {:ok, map()} | {:error, Error.t()}
  def get(gateway, id), do: gateway |> Operations.get(id) |> answer()

  @doc "Begins an operation, which goes on without the caller."
  @spec begin(term(), map(), Access.requester()) :: {:ok, map()} | {:error, Error.t()}
  def begin(gateway, object, requester),
    do: gateway |> Operations.begin(object, Commands.source(requester), "rest") |> answer()

  @doc "Nothing of it begins any more."
  @spec stop(term(), String.t(), Access.requester()) :: {:ok, map()} | {:error, Error.t()}
  def stop(gateway, id, requester), do: gateway |> Operations.stop(id, Commands.source(requester)) |> answer()

  defp answer({:ok, operation}), do: {:ok, operation}
  defp answer({:error, {:malformed, errors}}), do: {:error, Error.malformed(errors)}
  defp answer({:error, {kind, text}}), do: {:error, Error.new(Map.fetch!(@codes, kind), text)}
end
