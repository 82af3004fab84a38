defmodule Protocols.Mission.File.QgcPlan do
  @moduledoc """
  QGroundControl's `.plan` files (JSON): mission, fence and rally points.

  A file may lack sections: then its plan has nothing of that kind. A section that is there and not understood (an unknown version, a
  misspelt or missing key, null) is an error: read as empty, it would look like a plan without a fence. Fences of version 1 have one
  polygon to stay in. Items are those of `Protocols.Mission.File.QgcItems`. Files are written with SimpleItems only.

  QGroundControl has no place for some items of fences, and for the height of a rally point above anything but home.
  These are written beside its own lists as `others`, a key that it ignores: SimpleItems, those of rally points with
  `index`, their place in the list.
  """

  alias Aerie.Base.Json
  alias Protocols.Mission.File.{QgcItems, Value}
  alias Protocols.Mission.{Onboard, Plan}
  alias Aerie.Base.Files.Text

  @max_bytes 4 * 1024 * 1024
  @max_zones Plan.limits().zones
  @max_corners 2_000
  @max_rally Plan.limits().rally
  @sections ["mission", "geoFence", "rallyPoints"]
  # Hand-written names, without capitals and the plural's s.
  @misspelt %{
    "mission" => "mission",
    "geofence" => "geoFence",
    "fence" => "geoFence",
    "rallypoint" => "rallyPoints",
    "rally" => "rallyPoints"
  }
  # The versions of each section that are read, and the keys of the sections that have no others.
  @versions %{"mission" => [1, 2], "geoFence" => [1, 2], "rallyPoints" => [1, 2]}
  @fence_keys %{
    1 => ["polygon", "breachReturn", "parameters"],
    2 => ["polygons", "circles", "breachReturn", "others"]
  }
  @advice "open it in a current QGroundControl and save it again"

  @doc "The plan of a text, or an error that says where."
  @spec read(binary()) :: {:ok, Plan.t()} | {:error, String.t()}
  def read(text) when byte_size(text) > @max_bytes, do: {:error, "the file is larger than 4 MiB"}

  def read(text) do
    case text |> Text.unmarked() |> JSON.decode() do
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
        "items" => simple(plan.items)
      },
      "geoFence" => written(plan),
      "rallyPoints" => written_rally(plan)
    })
  end

  # --- Reading

  defp plan(file) do
    with :ok <- version(file, [1], ""),
         :ok <- spelt(Map.keys(file)),
         {:ok, mission} <- section(file, "mission"),
         {:ok, fence} <- section(file, "geoFence"),
         {:ok, rally} <- section(file, "rallyPoints"),
         {:ok, plan} <- mission(mission, %Plan{}),
         {:ok, plan} <- fence(fence, plan),
         do: rally(rally, plan)
  end

  defp section(file, name) do
    case Map.fetch(file, name) do
      :error -> {:ok, nil}
      {:ok, %{} = section} -> with :ok <- version(section, @versions[name], name <> "."), do: {:ok, section}
      {:ok, other} -> Value.error(name, "an object", other)
    end
  end

  # Where it is missing, the keys tell.
  defp version(section, known, at) do
    version = Map.get(section, "version", List.last(known))

    if Enum.any?(known, &(&1 == version)),
      do: :ok,
      else:
        {:error,
         "#{at}version: expected #{Enum.join(known, " or ")}, got #{Json.shown(version, 40)}: #{@advice}"}
  end

  defp spelt(keys) do
    Enum.find_value(keys -- @sections, :ok, fn key ->
      name =
        @misspelt[key |> String.downcase() |> String.replace(~r/[^a-z]/, "") |> String.trim_trailing("s")]

      if name, do: {:error, "#{inspect(key, printable_limit: 40)}: expected \"#{name}\""}
    end)
  end

  defp mission(nil, plan), do: {:ok, plan}

  defp mission(mission, plan) do
    with {:ok, home} <- home(mission["plannedHomePosition"]),
         {:ok, items} <- QgcItems.read(mission),
         do: {:ok, %{plan | home: home, items: items}}
  end

  defp fence(nil, plan), do: {:ok, plan}

  defp fence(fence, plan) do
    version = if fence["version"] == 1, do: 1, else: 2

    with :ok <- only(fence, @fence_keys[version], "geoFence"),
         {:ok, zones} <- zones(version, fence),
         {:ok, back} <- back(fence["breachReturn"]),
         {:ok, others} <- others(fence, "geoFence"),
         do: {:ok, %{plan | fence: zones, fence_return: back, fence_others: Enum.map(others, &elem(&1, 1))}}
  end

  defp zones(1, fence) do
    case fence do
      %{"polygon" => []} ->
        {:ok, []}

      %{"polygon" => _corners} ->
        with {:ok, zone} <- corners(:inclusion, fence, "geoFence"), do: {:ok, [zone]}

      _none ->
        Value.error("geoFence.polygon", "a list", nil)
    end
  end

  defp zones(2, fence) when not is_map_key(fence, "polygons") and not is_map_key(fence, "circles"),
    do: {:error, "geoFence: expected polygons or circles: #{@advice}"}

  defp zones(2, fence) do
    with {:ok, polygons} <-
           Value.list(Map.get(fence, "polygons", []), @max_zones, "geoFence.polygons", &polygon/2),
         {:ok, circles} <-
           Value.list(Map.get(fence, "circles", []), @max_zones, "geoFence.circles", &circle/2),
         do: {:ok, polygons ++ circles}
  end

  defp rally(nil, plan), do: {:ok, plan}

  defp rally(rally, plan) do
    with :ok <- only(rally, ["points", "others"], "rallyPoints"),
         {:ok, points} <- Value.list(rally["points"], @max_rally, "rallyPoints.points", &place/2),
         {:ok, others} <- others(rally, "rallyPoints"),
         do: {:ok, Enum.reduce(others, %{plan | rally: points}, &put_rally/2)}
  end

  defp put_rally({index, item}, plan) do
    case Onboard.rally_point(item) do
      nil -> %{plan | rally_others: plan.rally_others ++ [item]}
      point -> %{plan | rally: List.insert_at(plan.rally, index, point)}
    end
  end

  defp others(section, name),
    do: Value.list(Map.get(section, "others", []), @max_rally, name <> ".others", &other/2)

  defp other(value, at) do
    with {:ok, [{_id, item, _at}]} <- QgcItems.item(value, at),
         {:ok, index} <- Value.integer(Map.get(value, "index", @max_rally), 0..@max_rally, at <> ".index"),
         do: {:ok, {index, item}}
  end

  defp only(section, keys, at) do
    case Map.keys(section) -- ["version" | keys] do
      [] ->
        :ok

      [key | _] ->
        {:error, "#{at}: expected only #{Enum.join(keys, ", ")}, got #{inspect(key, printable_limit: 40)}"}
    end
  end

  # QGroundControl writes 0, 0 if there is none.
  defp home(nil), do: {:ok, nil}
  # As old files have it: an item.
  defp home(%{"coordinate" => place}), do: home(place)
  # The vehicle knows better how high its home is.
  defp home([lat, lon | rest]) when rest in [[], [nil]], do: home([lat, lon, 0.0])

  defp home(value) do
    with {:ok, {position, altitude}} <- place(value, "mission.plannedHomePosition"),
         do: {:ok, if(position == {0, 0}, do: nil, else: {position, altitude})}
  end

  defp back(nil), do: {:ok, nil}
  # As old files have it; no firmware keeps its height.
  defp back([lat, lon]), do: back([lat, lon, 0.0])
  defp back(value), do: place(value, "geoFence.breachReturn")

  defp place([lat, lon | rest], at) when length(rest) <= 1 do
    with {:ok, position} <- Value.position(lat, lon, at),
         {:ok, altitude} <- Value.number(List.first(rest), at <> " altitude"),
         do: {:ok, {position, altitude}}
  end

  defp place(other, at), do: Value.error(at, "[latitude, longitude, altitude]", other)

  defp corner([lat, lon | _altitude], at), do: Value.position(lat, lon, at)
  defp corner(other, at), do: Value.error(at, "[latitude, longitude]", other)

  defp polygon(%{"polygon" => _corners} = zone, at),
    do: with({:ok, kind} <- kind(zone, at), do: corners(kind, zone, at))

  defp polygon(other, at), do: Value.error(at, "an object with polygon", other)

  defp corners(kind, %{"polygon" => corners}, at) do
    with {:ok, corners} <- Value.list(corners, @max_corners, at <> ".polygon", &corner/2) do
      if length(corners) >= 3,
        do: {:ok, {kind, {:polygon, corners}}},
        else: {:error, "#{at}.polygon: expected three corners or more, got #{length(corners)}"}
    end
  end

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

  # --- Writing

  defp written_rally(plan) do
    {points, others} =
      plan.rally |> Enum.with_index() |> Enum.split_with(fn {{_place, height}, _n} -> is_number(height) end)

    others =
      for {point, n} <- others, do: point |> Onboard.rally_item() |> simple(n + 1) |> Map.put("index", n)

    points = for {{position, altitude}, _n} <- points, do: Value.degrees(position) ++ [altitude]
    beside(%{"version" => 2, "points" => points}, others ++ simple(plan.rally_others))
  end

  defp beside(section, []), do: section
  defp beside(section, others), do: Map.put(section, "others", others)

  defp simple(items), do: for({item, n} <- Enum.with_index(items, 1), do: simple(item, n))

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

  defp written(plan) do
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

    fence = beside(%{"version" => 2, "polygons" => polygons, "circles" => circles}, simple(plan.fence_others))

    case plan.fence_return do
      nil -> fence
      {position, altitude} -> Map.put(fence, "breachReturn", Value.degrees(position) ++ [altitude])
    end
  end
end
