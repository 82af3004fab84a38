defmodule Protocols.Mission.File.QgcItems do
  @moduledoc """
  The items of a mission in QGroundControl's files.

  SimpleItems are read as they are, also as old files have them: of the type `missionItem`, with `coordinate` for the last three
  parameters, `param1` to `param4` for the first ones, and `id` for `doJumpId`. From ComplexItems (surveys, corridor scans) the items
  are read that QGroundControl stored in them. A ComplexItem without stored items, such as a landing pattern, is an error: only
  QGroundControl can generate its items.
  """

  alias Protocols.Mission.File.Value
  alias Protocols.Mission.{Item, Transfer}
  alias MavCodec.Enums.MavCmd

  @jump MavCmd.value(:MAV_CMD_DO_JUMP)
  @simple ["SimpleItem", "missionItem"]
  @stored ["TransectStyleComplexItem", "StructureScan"]

  @doc "The items of the section `mission`, or an error that says where."
  @spec read(map()) :: {:ok, [Item.t()]} | {:error, String.t()}
  # Old files have their surveys beside the items.
  def read(%{"complexItems" => [_ | _]}),
    do: {:error, "mission.complexItems: only a QGroundControl of that time can generate their items"}

  def read(mission), do: items(mission["items"])

  # Each item with the id that DO_JUMP refers to.
  defp items(values) do
    with {:ok, nested} <- Value.list(values, Transfer.limit(), "mission.items", &item/2) do
      items = Enum.concat(nested)
      limit = Transfer.limit()

      if length(items) <= limit,
        do: jumps(items),
        else:
          {:error,
           "mission.items: #{length(items)} items with those of ComplexItems; at most #{limit} are read"}
    end
  end

  @doc "The items of an entry, each with its id and where it stands."
  @spec item(term(), String.t()) :: {:ok, [{id :: term(), Item.t(), String.t()}]} | {:error, String.t()}
  def item(%{"type" => type} = value, at) when type in @simple do
    with [_, _, _, _, _, _, _] = params <- params(value),
         {:ok, item} <-
           Value.item(value["frame"], value["command"], params, value["autoContinue"] != false, at) do
      {:ok, [{value["doJumpId"] || value["id"], item, at}]}
    else
      {:error, reason} -> {:error, reason}
      _other -> Value.error(at <> ".params", "seven numbers", value["params"])
    end
  end

  def item(%{"type" => "ComplexItem"} = value, at) do
    stored = Enum.find_value(@stored, &if(is_map(value[&1]), do: {&1, value[&1]["Items"]}))

    case stored do
      {name, [_ | _] = items} ->
        with {:ok, nested} <- Value.list(items, Transfer.limit(), "#{at}.#{name}.Items", &item/2),
             do: {:ok, Enum.concat(nested)}

      _none ->
        Value.error(at, "the items of the ComplexItem in the file", value["complexItemType"])
    end
  end

  def item(%{"type" => type}, at), do: Value.error(at <> ".type", "\"SimpleItem\" or \"ComplexItem\"", type)
  def item(other, at), do: Value.error(at, "an item", other)

  defp params(%{"params" => [_, _, _, _] = params, "coordinate" => [_, _, _] = place}), do: params ++ place
  defp params(%{"params" => params}), do: params

  defp params(%{"coordinate" => [_, _, _] = place} = value) when is_map_key(value, "param1"),
    do: Enum.map(1..4, &value["param#{&1}"]) ++ place

  defp params(%{"param7" => _last} = value), do: Enum.map(1..7, &value["param#{&1}"])
  defp params(_none), do: nil

  # From ids to numbers.
  defp jumps(items) do
    numbers = for {{id, _item, _at}, n} <- Enum.with_index(items, 1), is_integer(id), into: %{}, do: {id, n}

    Value.all(items, fn {_id, item, at}, _n ->
      case item do
        %Item{command: @jump, params: {target, repeat, p3, p4}} ->
          jump(item, target, {repeat, p3, p4}, numbers, at)

        item ->
          {:ok, item}
      end
    end)
  end

  defp jump(item, target, {repeat, p3, p4}, numbers, at) do
    case target && numbers[trunc(target)] do
      nil -> Value.error(at <> ".params[0]", "the doJumpId of an item", target)
      number -> {:ok, %{item | params: {number / 1, repeat, p3, p4}}}
    end
  end
end
