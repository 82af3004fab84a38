defmodule MavRouter.Endpoints.RulesSchema do
  @moduledoc """
  The JSON Schema of a change of a link's or client's rules, with the keys of the configuration: what `MavRouter.Router.configure/3` takes over
  HTTP. Messages are named as in the definitions; numbers are accepted as well. Pure.
  """

  import Aerie.Base.Json.Schema

  alias MavCodec.Dialects.All
  alias MavRouter.Endpoints.Owner.Filter
  alias MavRouter.Endpoints.Queue.TrafficClass

  @type t :: Aerie.Base.Json.Schema.t()

  @most 256
  @ids %{messages: 0xFFFFFF, systems: 0xFFFFFFFF, components: 0xFF}

  @doc "The schema; null removes a rule."
  @spec change() :: t()
  def change do
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
end
