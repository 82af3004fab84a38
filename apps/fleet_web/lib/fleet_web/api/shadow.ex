defmodule FleetWeb.API.Shadow do
  @moduledoc "Desired and reported state over REST: `Aerie.Fleet.Shadow` in the name of a key, like commands (`FleetWeb.API.Commands`)."

  alias Aerie.Fleet.Shadow
  alias FleetWeb.API.{Access, Commands, Error}
  alias FleetWeb.WorkLimit

  @codes %{
    role: :forbidden,
    invalid: :invalid,
    conflict: :conflict,
    limit: :too_large,
    rate: :too_many,
    unavailable: :unavailable
  }

  @doc "The desired and reported state, with the state of each field."
  @spec get(term(), String.t()) :: {:ok, map()} | {:error, Error.t()}
  def get(gateway, vehicle), do: gateway |> Shadow.get(vehicle) |> answer()

  @doc "The desired fields that differ."
  @spec delta(term(), String.t()) :: {:ok, map()} | {:error, Error.t()}
  def delta(gateway, vehicle), do: gateway |> Shadow.delta(vehicle) |> answer()

  @doc "Changes the desired state."
  @spec update(term(), String.t(), map(), Access.requester()) :: {:ok, map()} | {:error, Error.t()}
  def update(gateway, vehicle, object, requester),
    do: gateway |> Shadow.update(vehicle, object, Commands.source(requester), "rest") |> answer()

  @doc "Removes all fields; `version` (a text from the query) is the version that this is based on, nil for any."
  @spec delete(term(), String.t(), String.t() | nil, Access.requester()) :: {:ok, map()} | {:error, Error.t()}
  def delete(gateway, vehicle, version, requester) do
    with {:ok, object} <- version(version),
         do: gateway |> Shadow.delete(vehicle, object, Commands.source(requester), "rest") |> answer()
  end

  @doc "The largest `.plan` file that is accepted."
  @spec max_plan_bytes() :: pos_integer()
  defdelegate max_plan_bytes, to: Shadow

  @doc "Stores a `.plan` file; returns the hash by which a desired state refers to it."
  @spec store_plan(term(), binary(), Access.requester()) :: {:ok, map()} | {:error, Error.t()}
  def store_plan(gateway, text, requester) do
    work = fn -> Shadow.put_plan(gateway, text, Commands.source(requester)) end

    case WorkLimit.run(gateway, :parse, {:name, requester.name}, work) do
      {:ok, {:ok, hash}} -> {:ok, %{"plan" => hash}}
      {:ok, refused} -> answer(refused)
      {:busy, seconds} -> {:error, Error.busy(seconds)}
    end
  end

  defp version(nil), do: {:ok, %{}}

  defp version(text) do
    case Integer.parse(text) do
      {version, ""} -> {:ok, %{"version" => version}}
      _other -> Error.invalid("version: expected the number of a version")
    end
  end

  defp answer({:ok, object}), do: {:ok, object}
  defp answer({:error, {:malformed, errors}}), do: {:error, Error.malformed(errors)}
  defp answer({:error, {kind, text}}), do: {:error, Error.new(Map.fetch!(@codes, kind), text)}
end
