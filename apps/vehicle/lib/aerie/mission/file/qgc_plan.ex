defmodule Aerie.Mission.File.QgcPlan do
  @moduledoc """
  QGroundControl's `.plan` files (JSON): mission, fence and rally points.

  SimpleItems are read as they are. From ComplexItems (surveys, corridor scans) the items are read that QGroundControl stored in
  them. A ComplexItem without stored items, such as a landing pattern, is an error: only QGroundControl can generate its items.
  Files are written with SimpleItems only.
  """

  alias Aerie.Mission.File.Value
  alias Aerie.Mission.{Item, Plan, Transfer}
  alias MavCodec.Enums.MavCmd

  @max_bytes 4 * 1024 * 1024
  @max_zones 200
  @max_corners 2_000
  @max_rally 500
  @jump MavCmd.value(:MAV_CMD_DO_JUMP)
  @stored ["TransectStyleComplexItem", "StructureScan"]

  @doc "The largest numbers of polygons, of circles, and of rally points in a file."
  @spec limits() :: %{zones: pos_integer(), rally: pos_integer()}
  def limits, do: %{zones: @max_zones, rally: @max_rally}

  @doc "The plan of a text, or an error that says where."
  @spec read(binary()) :: {:ok, Plan.t()} | {:error, String.t()}
  def read(text) when byte_size(text) > @max_bytes, do: {:error, "the file is larger than 4 MiB"}

  def read(text) do
    case JSON.decode(text) do
      {:ok, %{"fileType" => "Plan"} = file} -> plan(file)
      {:ok, _other} -> {:error, "fileType: expected \"Plan\": this is not a plan of QGroundControl"}
      {:error, {:invalid_byte, at, _byte}} -> {:error, "this is not JSON: wrong character at byte #{at}"}
      {:error, {:unexpected_end, _at}} -> {:error, "this is not JSON: it ends too early"}
      {:error, _reason} -> {:error, "this is not JSON"}
    end
  end

  @doc "A plan as text."
  @spec write(Plan.t()) :: binary()
  def write(plan) do
    {position, altitude} = plan.home || {{0, 0}, 0.0}

    JSON.encode!(%{
      "fileType" => "Plan",
      "groundStation" => "Aerie",
      "version" => 1,
      "mission" => %{
        "version" => 2,
        "firmwareType" => 0,
        "vehicleType" => 0,
        "cruiseSpeed" => 15,
        "hoverSpeed" => 5,
        "globalPlanAltitudeMode" => 0,
        "plannedHomePosition" => Value.degrees(position) ++ [altitude],
        "items" => for({item, n} <- Enum.with_index(plan.items, 1), do: simple(item, n))
      },
      "geoFence" => fence(plan),
      "rallyPoints" => %{
        "version" => 2,
        "points" => for({position, altitude} <- plan.rally, do: Value.degrees(position) ++ [altitude])
      }
    })
  end

  # --- Reading

  defp plan(file) do
    with {:ok, mission} <- object(file, "mission"),
         {:ok, fence} <- object(file, "geoFence"),
         {:ok, rally} <- object(file, "rallyPoints"),
         {:ok, home} <- home(mission["plannedHomePosition"]),
         {:ok, items} <- items(mission["items"]),
         {:ok, polygons} <- list(fence["polygons"], @max_zones, "geoFence.polygons", &polygon/2),
         {:ok, circles} <- list(fence["circles"], @max_zones, "geoFence.circles", &circle/2),
         {:ok, back} <- back(fence["breachReturn"]),
         {:ok, points} <- list(rally["points"], @max_rally, "rallyPoints.points", &place/2) do
      {:ok, %Plan{home: home, items: items, fence: polygons ++ circles, fence_return: back, rally: points}}
    end
  end

  defp object(file, name) do
    case Map.get(file, name) || %{} do
      %{} = object -> {:ok, object}
      other -> Value.error(name, "an object", other)
    end
  end

  defp list(nil, _most, _at, _fun), do: {:ok, []}

  defp list(values, most, at, fun) when is_list(values) do
    if length(values) <= most,
      do: Value.all(values, &fun.(&1, "#{at}[#{&2 - 1}]")),
      else: {:error, "#{at}: #{length(values)} entries; at most #{most} are read"}
  end

  defp list(other, _most, at, _fun), do: Value.error(at, "a list", other)

  # QGroundControl writes 0, 0 if there is none.
  defp home(nil), do: {:ok, nil}

  defp home(value) do
    with {:ok, {position, altitude}} <- place(value, "mission.plannedHomePosition"),
         do: {:ok, if(position == {0, 0}, do: nil, else: {position, altitude})}
  end

  defp back(nil), do: {:ok, nil}
  defp back(value), do: place(value, "geoFence.breachReturn")

  defp place([lat, lon | rest], at) when length(rest) <= 1 do
    with {:ok, position} <- Value.position(lat, lon, at),
         {:ok, altitude} <- Value.float(List.first(rest), at <> " altitude"),
         do: {:ok, {position, altitude || 0.0}}
  end

  defp place(other, at), do: Value.error(at, "[latitude, longitude, altitude]", other)

  defp corner([lat, lon | _altitude], at), do: Value.position(lat, lon, at)
  defp corner(other, at), do: Value.error(at, "[latitude, longitude]", other)

  defp polygon(%{"polygon" => corners} = zone, at) do
    with {:ok, kind} <- kind(zone, at),
         {:ok, corners} <- list(corners, @max_corners, at <> ".polygon", &corner/2) do
      if length(corners) >= 3,
        do: {:ok, {kind, {:polygon, corners}}},
        else: {:error, "#{at}.polygon: expected three corners or more, got #{length(corners)}"}
    end
  end

  defp polygon(other, at), do: Value.error(at, "an object with polygon", other)

  defp circle(%{"circle" => %{"center" => center, "radius" => radius}} = zone, at) do
    with {:ok, kind} <- kind(zone, at),
         {:ok, center} <- corner(center, at <> ".circle.center"),
         {:ok, radius} <- Value.number(radius, at <> ".circle.radius") do
      if radius > 0,
        do: {:ok, {kind, {:circle, center, radius}}},
        else: Value.error(at <> ".circle.radius", "metres above 0", radius)
    end
  end

  defp circle(other, at), do: Value.error(at, "an object with circle, its center and radius", other)

  defp kind(%{"inclusion" => true}, _at), do: {:ok, :inclusion}
  defp kind(%{"inclusion" => false}, _at), do: {:ok, :exclusion}
  defp kind(zone, at), do: Value.error(at <> ".inclusion", "true or false", zone["inclusion"])

  # Each item with the id that DO_JUMP refers to.
  defp items(values) do
    with {:ok, nested} <- list(values, Transfer.limit(), "mission.items", &item/2) do
      items = Enum.concat(nested)
      limit = Transfer.limit()

      if length(items) <= limit,
        do: jumps(items),
        else:
          {:error,
           "mission.items: #{length(items)} items with those of ComplexItems; at most #{limit} are read"}
    end
  end

  defp item(%{"type" => "SimpleItem"} = value, at) do
    with [_, _, _, _, _, _, _] = params <- value["params"],
         {:ok, item} <-
           Value.item(value["frame"], value["command"], params, value["autoContinue"] != false, at) do
      {:ok, [{value["doJumpId"], item, at}]}
    else
      {:error, reason} -> {:error, reason}
      other -> Value.error(at <> ".params", "seven numbers", other)
    end
  end

  defp item(%{"type" => "ComplexItem"} = value, at) do
    stored = Enum.find_value(@stored, &if(is_map(value[&1]), do: {&1, value[&1]["Items"]}))

    case stored do
      {name, [_ | _] = items} ->
        with {:ok, nested} <- list(items, Transfer.limit(), "#{at}.#{name}.Items", &item/2),
             do: {:ok, Enum.concat(nested)}

      _none ->
        Value.error(at, "the items of the ComplexItem in the file", value["complexItemType"])
    end
  end

  defp item(%{"type" => type}, at), do: Value.error(at <> ".type", "\"SimpleItem\" or \"ComplexItem\"", type)
  defp item(other, at), do: Value.error(at, "an item", other)

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

  # --- Writing

  defp simple(item, number) do
    %{
      "type" => "SimpleItem",
      "doJumpId" => number,
      "command" => item.command,
      "frame" => item.frame,
      "autoContinue" => item.autocontinue == 1,
      "params" => Value.numbers(item)
    }
  end

  defp fence(plan) do
    polygons =
      for {kind, {:polygon, corners}} <- plan.fence,
          do: %{
            "version" => 1,
            "inclusion" => kind == :inclusion,
            "polygon" => Enum.map(corners, &Value.degrees/1)
          }

    circles =
      for {kind, {:circle, center, radius}} <- plan.fence do
        circle = %{"center" => Value.degrees(center), "radius" => radius}
        %{"version" => 1, "inclusion" => kind == :inclusion, "circle" => circle}
      end

    fence = %{"version" => 2, "polygons" => polygons, "circles" => circles}

    case plan.fence_return do
      nil -> fence
      {position, altitude} -> Map.put(fence, "breachReturn", Value.degrees(position) ++ [altitude])
    end
  end
end
