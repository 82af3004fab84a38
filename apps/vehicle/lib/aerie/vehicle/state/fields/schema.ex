defmodule Aerie.Vehicle.State.Fields.Schema do
  @moduledoc """
  JSON Schemas of a vehicle's state groups and of the data of its events, from their tables. Every field may be null or missing, and later
  versions may have more. Pure.
  """

  import Aerie.Base.Json.Schema

  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.State.{Group, Groups}

  @type t :: Aerie.Base.Json.Schema.t()

  @doc "The data of a state group."
  @spec group(Group.t()) :: t()
  def group(%Group{} = group) do
    aggregated = %{
      samples:
        described(
          %{type: :integer, minimum: 1},
          "with the strategy `aggregate`: how many values this is the mean of"
        ),
      min: described(numbers(), "with the strategy `aggregate`: the least of each number"),
      max: described(numbers(), "with the strategy `aggregate`: the largest of each number")
    }

    group.fields |> properties() |> Map.merge(aggregated) |> object([], open: true)
  end

  defp numbers, do: %{type: :object, additionalProperties: %{type: [:number, :null]}}

  defp properties(fields) do
    for %{path: [name]} = field <- fields, into: %{}, do: {name, property(field, fields)}
  end

  defp property(field, fields) do
    below =
      for %{path: [parent, name]} = nested <- fields, [parent] == field.path, do: %{nested | path: [name]}

    beside = for %{path: [_name], type: type} = field <- fields, not is_tuple(type), do: field

    schema =
      case field.type do
        {:list, :group} -> %{type: :array, items: object(properties(beside ++ below), [], open: true)}
        {:list, :object} -> %{type: :array, items: object(properties(below), [], open: true)}
        {:list, type} -> %{type: :array, items: nullable(value(type, field.range))}
        {:object, _decimals} -> object(properties(below), [], open: true)
        type -> value(type, field.range)
      end

    schema |> nullable() |> described(field.meaning, field.unit)
  end

  defp value(0, range), do: limited(%{type: :integer}, range)
  defp value(n, range) when is_integer(n), do: limited(%{type: :number}, range)
  defp value(:text, _range), do: %{type: :string}
  defp value(:boolean, _range), do: %{type: :boolean}
  defp value(:time, _range), do: %{type: :string, format: :"date-time"}
  defp value({:one_of, texts}, _range), do: %{enum: texts}

  defp limited(schema, {min, max}) do
    for {key, limit} when limit != nil <- [minimum: min, maximum: max], into: schema, do: {key, limit}
  end

  @types %{
    string: %{type: :string},
    number: %{type: :number},
    integer: %{type: :integer},
    boolean: %{type: :boolean},
    list: %{type: :array},
    object: %{type: :object}
  }

  @doc "The data of an event of a type."
  @spec event(Event.Types.t()) :: t()
  def event(%{fields: fields}) do
    properties =
      for field <- fields, into: %{} do
        schema = if field.type == :any, do: %{}, else: nullable(Map.fetch!(@types, field.type))
        {field.name, described(schema, field.meaning, field.unit)}
      end

    object(Map.put(properties, "position", ref("event_position")), [], open: true)
  end

  @doc "The schema that those of events refer to, by its name."
  @spec shared() :: %{String.t() => t()}
  def shared do
    %{properties: place} = Groups.all() |> Enum.find(&(&1.name == :position)) |> group()
    place = place |> Map.drop([:samples, :min, :max]) |> object([], open: true)
    %{"event_position" => described(place, "where the vehicle was then")}
  end
end
