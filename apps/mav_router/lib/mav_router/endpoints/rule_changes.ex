defmodule MavRouter.Endpoints.RuleChanges do
  @moduledoc """
  A change of a link's or client's rules as a program writes it, by the keys of the configuration: its JSON Schema, and
  what it is for `MavRouter.Router.configure/3`. Messages are named as in the definitions; numbers are accepted as well.
  Pure.

      {"rate_limits": {"ATTITUDE": 4}, "filter_out": {"block_messages": ["RAW_IMU"]}, "bytes_per_s": null}

  null removes a rule. The shape of a value is checked here, its meaning there.
  """

  import Aerie.Base.Json.Schema

  alias MavCodec.Dialects.All
  alias MavRouter.Endpoints.Owner.{Filter, RuleKeys}
  alias MavRouter.Endpoints.Queue.TrafficClass

  @type t :: Aerie.Base.Json.Schema.t()

  @keys Map.new(RuleKeys.changeable(), &{Atom.to_string(&1), &1})
  @filter_keys Map.new(Filter.keys(), &{Atom.to_string(&1), &1})
  @roles %{"full" => :full, "read_only" => :read_only}
  @most 256
  @ids %{messages: 0xFFFFFF, systems: 0xFFFFFFFF, components: 0xFF}

  @doc "The schema of a change."
  @spec schema() :: t()
  def schema do
    at_least_one = %{type: :integer, minimum: 1}
    flag = %{type: :boolean}
    lists = object(Map.new(Filter.keys(), &{&1, list(&1)}))

    rules = %{
      role: %{enum: ~w(full read_only)},
      group: text(64, 0),
      networks: %{type: :array, minItems: 1, maxItems: 16, items: token()},
      filter_in: lists,
      filter_out: lists,
      rate_limits: map(ref("message_name"), described(number(0, 10_000), "at most so many a second")),
      carry: map(%{enum: TrafficClass.classes()}, described(%{type: :string}, "a link, or `all`")),
      id_offsets: map(token(), integer(0, 238)),
      bytes_per_s: at_least_one,
      queue_frames: at_least_one,
      queue_kb: at_least_one,
      sniffer: flag,
      served: flag,
      broadcasts: flag,
      coalesce: flag
    }

    rules |> Map.new(fn {name, schema} -> {name, nullable(schema)} end) |> object([], minProperties: 1)
  end

  defp map(names, values),
    do: %{type: :object, propertyNames: names, additionalProperties: values, maxProperties: @most}

  defp list(key) do
    [_allow_or_block, axis] = key |> Atom.to_string() |> String.split("_")
    %{type: :array, maxItems: @most, items: item(String.to_existing_atom(axis))}
  end

  defp item(:sources), do: described(%{type: :string}, "a link or client")
  defp item(:messages), do: %{anyOf: [ref("message_name"), integer(0, @ids.messages)]}
  defp item(axis), do: integer(0, Map.fetch!(@ids, axis))

  @doc "The schema `message_name` that others refer to."
  @spec message_name() :: t()
  def message_name do
    # Each name of the definitions that is looked up by it.
    names = for id <- All.ids(), name = All.name(id), All.message_id(name) == id, uniq: true, do: name
    described(%{enum: names}, "the name of a MAVLink message")
  end

  @doc "The changes for `MavRouter.Router.configure/3`."
  @spec parse(map()) :: {:ok, map()} | {:error, String.t()}
  def parse(object) when object == %{},
    do: error("nothing to change; give at least one of #{names(@keys)}")

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
         do: error("#{inspect(String.slice(name, 0, 64))} is an unknown key; known are #{names(keys)}")
  end

  defp value(_key, nil), do: {:ok, nil}

  defp value(:role, role) do
    with :error <- Map.fetch(@roles, role), do: error("role must be one of #{names(@roles)}")
  end

  defp value(key, filter)
       when key in [:filter_in, :filter_out] and is_map(filter) and map_size(filter) <= 16 do
    Enum.reduce_while(filter, {:ok, %{}}, fn {name, list}, {:ok, lists} ->
      with {:ok, axis} <- known(name, @filter_keys), true <- is_list(list) and length(list) <= @most do
        {:cont, {:ok, Map.put(lists, axis, list)}}
      else
        {:error, error} -> {:halt, {:error, error}}
        false -> {:halt, error("#{name} must be a list of at most #{@most}")}
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

  defp value(key, _other), do: error("#{key} has a value of the wrong type")

  defp names(keys), do: keys |> Map.keys() |> Enum.sort() |> Enum.join(", ")

  defp error(words), do: {:error, words}
end
