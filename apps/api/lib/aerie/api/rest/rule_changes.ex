defmodule Aerie.Api.Rest.RuleChanges do
  @moduledoc """
  Checks the body of `PATCH /api/rules/ID`. Pure.

      {"rate_limits": {"ATTITUDE": 4}, "filter_out": {"block_messages": ["RAW_IMU"]}, "bytes_per_s": null}

  The keys are those of the configuration (`MavRouter.Endpoints.Owner.RuleKeys.changeable/0`); null removes a rule. This
  module checks the shape of a value; `MavRouter.Router.configure/3` checks its meaning.
  """

  alias MavRouter.Endpoints.Owner.Filter
  alias MavRouter.Endpoints.Owner.RuleKeys
  alias Aerie.Access.HTTP.{Error, Request}

  @keys Map.new(RuleKeys.changeable(), &{Atom.to_string(&1), &1})
  @filter_keys Map.new(Filter.keys(), &{Atom.to_string(&1), &1})
  @roles %{"full" => :full, "read_only" => :read_only}
  @most 256

  @doc "The changes for `MavRouter.Router.configure/3`."
  @spec parse(map()) :: {:ok, map()} | {:error, Error.t()}
  def parse(object) when object == %{},
    do: Error.invalid("nothing to change; give at least one of #{names(@keys)}")

  def parse(object) do
    Enum.reduce_while(object, {:ok, %{}}, fn {name, value}, {:ok, changes} ->
      with {:ok, key} <- known(name, @keys), {:ok, value} <- value(key, value) do
        {:cont, {:ok, Map.put(changes, key, value)}}
      else
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  defp known(name, keys) do
    with :error <- Map.fetch(keys, name),
         do: Request.unknown(name, Map.keys(keys))
  end

  defp value(_key, nil), do: {:ok, nil}

  defp value(:role, role) do
    with :error <- Map.fetch(@roles, role), do: Error.invalid("role must be one of #{names(@roles)}")
  end

  defp value(key, filter)
       when key in [:filter_in, :filter_out] and is_map(filter) and map_size(filter) <= 16 do
    Enum.reduce_while(filter, {:ok, %{}}, fn {name, list}, {:ok, lists} ->
      with {:ok, axis} <- known(name, @filter_keys), true <- is_list(list) and length(list) <= @most do
        {:cont, {:ok, Map.put(lists, axis, list)}}
      else
        {:error, error} -> {:halt, {:error, error}}
        false -> {:halt, Error.invalid("#{name} must be a list of at most #{@most}")}
      end
    end)
  end

  defp value(key, map)
       when key in [:rate_limits, :carry, :id_offsets] and is_map(map) and map_size(map) <= @most,
       do: {:ok, map}

  defp value(:networks, list) when is_list(list) and length(list) in 1..16, do: {:ok, list}

  defp value(key, n) when key in [:bytes_per_s, :queue_frames, :queue_kb] and is_integer(n) and n > 0,
    do: {:ok, n}

  defp value(:group, text) when is_binary(text) and byte_size(text) <= 256, do: {:ok, text}

  defp value(key, flag) when key in [:sniffer, :served, :broadcasts, :coalesce] and is_boolean(flag),
    do: {:ok, flag}

  defp value(key, _other), do: Error.invalid("#{key} has a value of the wrong type")

  defp names(keys), do: keys |> Map.keys() |> Enum.sort() |> Enum.join(", ")
end
