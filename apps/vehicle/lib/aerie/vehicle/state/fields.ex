defmodule Aerie.Vehicle.State.Fields do
  @moduledoc """
  Every field of a vehicle's state with its unit, meaning, source and number of significant decimals, as the groups declare them
  (`Aerie.Vehicle.State.Groups`). NATS, REST and `state.sock` use these names and units, and round by them when they render
  (`plain/2`, `event/2`), never before. `docs/telemetry.md` is made from it.

  Units are SI and degrees. A ratio is 0..1, never per cent; a height says above what.
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.State.{Group, Groups}

  @type group :: atom()

  all = for group <- Groups.all(), do: {group.name, group.title, group.fields}

  # By atoms and strings, because the position in an event has string keys.
  decimals =
    for {group, _title, fields} <- all, into: %{} do
      named = for %{path: path, decimals: n} when n != nil <- fields, do: {List.last(path), n}
      {group, Map.new(named ++ Enum.map(named, fn {name, n} -> {Atom.to_string(name), n} end))}
    end

  @all all
  @decimals Map.merge(decimals, Map.new(decimals, fn {group, names} -> {Atom.to_string(group), names} end))

  # Seconds, volts and ratios have two decimals; a number without a unit is as the vehicle sent it.
  @event (for %{fields: fields} <- Event.Types.all(),
              %{name: name, unit: unit} when unit in ["s", "0..1", "V"] <- fields,
              into: %{} do
            {name, 2}
          end)

  @doc "All groups with a title and their fields, in the order of the documentation."
  @spec all() :: [{group(), String.t(), [Group.field()]}]
  def all, do: @all

  @doc "A group's data as JSON has it (`Json.plain/1`), with rounded numbers. The group is an atom or a string."
  @spec plain(group() | String.t(), map()) :: map()
  def plain(group, data), do: object(data, Map.get(@decimals, group, %{}), nil)

  @doc "An event as NATS and REST have it. The `epoch` says which start of the gateway numbered it; nil for none."
  @spec event(Event.t(), epoch :: pos_integer() | nil) :: %{String.t() => term()}
  def event(%Event{} = event, epoch) do
    shown = %{
      "id" => event.id,
      "vehicle" => event.vehicle,
      "type" => event.type,
      "seq" => event.seq,
      "time" => Json.time(event.time),
      "time_boot_ms" => event.vehicle_time_ms,
      "data" => event_data(event.data)
    }

    if epoch, do: Map.put(shown, "epoch", epoch), else: shown
  end

  defp event_data(%{"position" => %{} = position} = data),
    do: %{object(data, @event, nil) | "position" => plain(:position, position)}

  defp event_data(data), do: object(data, @event, nil)

  # A field that has no decimals of its own has those of the field above it; 0 gives whole numbers.
  defp object(map, decimals, above),
    do: Json.plain(map, &plain_by(&2, decimals, Map.get(decimals, &1, above)))

  defp plain_by(float, _decimals, 0) when is_float(float), do: round(float)
  defp plain_by(float, _decimals, n) when is_float(float) and is_integer(n), do: Float.round(float, n)

  defp plain_by(map, decimals, above) when is_non_struct_map(map), do: object(map, decimals, above)
  defp plain_by(list, decimals, n) when is_list(list), do: for(item <- list, do: plain_by(item, decimals, n))
  defp plain_by(other, _decimals, _n), do: Json.plain(other)
end
