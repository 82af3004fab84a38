defmodule Aerie.Console.Pages.Fleet.Act.Mission.Send do
  @moduledoc """
  A mission to several vehicles: the same for all, moved a little for each, or each its own file. Pure.

  What takes longer than a page may wait (`Aerie.Console.Pages.Fleet.Act.Mission.Routes`) is worked out beside it. The
  press carries the hash of each vehicle's plan. One that leaves its fence or lets vehicles come near to each other is
  sent only after a tick for just these.
  """
  @behaviour Aerie.Console.Pages.Fleet.Act.Sheet

  alias Aerie.Console.Clock
  alias Aerie.Console.Pages.Fleet.Act.Mission.{Routes, SendForm}
  alias Aerie.Console.Pages.Fleet.Act.Sheet
  alias Aerie.Vehicle.Snapshot

  @most_files Sheet.most()
  @most_items 20_000
  @longest_name 80
  @named 5
  @each {:how, "offset"}

  @impl Sheet
  def about do
    %{
      id: "mission",
      title: "Mission to",
      go: "Send to",
      icon: "plan",
      order: "Order of the vehicles",
      in_turn?: true,
      together?: true
    }
  end

  @impl Sheet
  def fields do
    metres = %{unit: "m", range: {-1_000, 1_000}, only: @each}

    [
      %{
        name: :how,
        label: "Plans",
        default: "same",
        options: [{"The same for all", "same"}, {"Each a little beside", "offset"}, {"By file name", "name"}]
      },
      Map.merge(metres, %{name: :east, label: "East, from one to the next", default: 10}),
      Map.merge(metres, %{name: :north, label: "North", default: 0}),
      Map.merge(metres, %{name: :up, label: "Up", default: 3}),
      %{name: :interval, label: "Between two starts", unit: "s", range: {0, 3_600}, default: 10}
    ]
  end

  @impl Sheet
  def rank(vehicle), do: vehicle.id

  @impl Sheet
  def own, do: %{files: [], error: nil, agreed: nil, done: nil}

  @impl Sheet
  def facts(_sheet, vehicle, _n, ask), do: %{refusal: ask.no_mission.(vehicle)}

  @impl Sheet
  def event(sheet, "files", %{"files" => files}, ask) when is_list(files) do
    case ask.parse.(
           for(%{"name" => name, "text" => text} <- files, is_binary(name), is_binary(text), do: {name, text})
         ) do
      {:busy, seconds} -> put(sheet, error: "Too many files at once: try again in #{seconds} s.")
      {:ok, read} -> Enum.reduce(read, put(sheet, error: nil), &add/2)
    end
  end

  def event(sheet, "files", %{"error" => text}, _ask) when is_binary(text),
    do: put(sheet, error: String.slice(text, 0, 200))

  def event(%{own: %{files: files}} = sheet, "drop_file", %{"name" => name}, _ask),
    do: put(sheet, files: Enum.reject(files, &(&1.name == name)), error: nil)

  def event(%{own: %{agreed: agreed}} = sheet, "agree", %{"agreed" => digest}, _ask) when is_binary(digest),
    do: put(sheet, agreed: if(agreed == digest, do: nil, else: digest))

  def event(sheet, _unknown, _value, _ask), do: sheet

  defp add({name, {:error, why}}, sheet), do: put(sheet, error: "#{short(name)}: #{why}")

  defp add({name, {:ok, plan}}, %{own: %{files: files}} = sheet) do
    file = %{name: short(name), plan: plan, key: :erlang.phash2(plan, 4_294_967_296)}
    files = Enum.reject(files, &(&1.name == file.name)) ++ [file]
    items = files |> Enum.map(&length(&1.plan.items)) |> Enum.sum()

    cond do
      length(files) > @most_files -> put(sheet, error: "At most #{@most_files} files.")
      items > @most_items -> put(sheet, error: "At most #{@most_items} items in all files.")
      true -> put(sheet, files: files)
    end
  end

  defp short(name), do: String.slice(name, 0, @longest_name)
  defp put(sheet, changes), do: %{sheet | own: Map.merge(sheet.own, Map.new(changes))}

  @impl Sheet
  def work(%{own: %{files: []}}, _known), do: nil

  def work(sheet, known) do
    key = key(sheet, known)
    vehicles = going(sheet, known)

    if not match?({^key, _routes}, sheet.own.done),
      do: {key, &Routes.of(sheet.own.files, vehicles, Sheet.values(sheet), &1)}
  end

  defp going(sheet, known),
    do: for(id <- sheet.order, id not in sheet.out, %{snapshot: snapshot} <- [known[id]], do: {id, snapshot})

  # One that takes off begins elsewhere.
  defp key(sheet, known) do
    flying =
      for {id, snapshot} <- going(sheet, known), do: {id, Snapshot.data(snapshot, :mode)[:in_air] == true}

    {flying, Sheet.values(sheet), for(file <- sheet.own.files, do: {file.name, file.key})}
  end

  @impl Sheet
  def worked(sheet, key, result), do: put(sheet, done: {key, result})

  # What was worked out for what is shown now.
  defp routes(%{own: %{done: {key, %{} = routes}, files: [_ | _]}} = sheet, known),
    do: if(key(sheet, known) == key, do: routes)

  defp routes(_sheet, _known), do: nil

  @impl Sheet
  def known(sheet, known) do
    routes = routes(sheet, known)
    Map.new(known, fn {id, facts} -> {id, Map.put(facts, :routes, routes)} end)
  end

  @impl Sheet
  def line(sheet, {id, n}, %{routes: %{vehicles: vehicles, limit_m: limit}}, _before) do
    route = n && vehicles[id]
    nearest = route && route.nearest

    %{
      route: route,
      from: route && from(sheet, route, n),
      way: (route && route.way) || [],
      conflict?: nearest != nil and nearest.metres < limit,
      blocks: route && route.error && "#{id}: #{route.error}"
    }
  end

  def line(%{own: %{files: []}}, _place, _facts, _before),
    do: %{
      route: nil,
      from: nil,
      way: [],
      conflict?: false,
      blocks: "Choose a file, or the draft of the page Plan."
    }

  def line(sheet, {id, _n}, facts, _before) do
    failed = match?(%{own: %{done: {_key, {:error, _why}}}}, sheet)

    why =
      if failed,
        do: "The plans could not be compared: choose the files again.",
        else: "The plans are being compared."

    %{
      route: nil,
      from: nil,
      way: [],
      conflict?: false,
      blocks: (facts && facts.refusal && "#{id}: #{facts.refusal}") || why
    }
  end

  defp from(sheet, route, n) do
    case Sheet.values(sheet) do
      %{how: "offset"} = values ->
        for(
          {key, word} <- [east: "E", north: "N", up: "up"],
          metres = n * values[key],
          metres != 0,
          do: "#{signed(metres)} m #{word}"
        )
        |> case do
          [] -> route.name
          words -> Enum.join(words, ", ")
        end

      _same ->
        route.name
    end
  end

  defp signed(metres), do: if(metres > 0, do: "+#{rounded(metres)}", else: "#{rounded(metres)}")
  defp rounded(metres), do: if(is_float(metres), do: Float.round(metres, 1), else: metres)

  @impl Sheet
  def cells(%{route: nil} = line),
    do: [
      text: nil,
      number: nil,
      number: if(line.n, do: nil, else: "left out"),
      badges: [{"plain", line.blocks}]
    ]

  def cells(%{route: route} = line) do
    nearest =
      with %{} = pair <- route.nearest,
           do:
             {if(line.conflict?, do: "bad", else: "plain"),
              "#{Routes.metres(pair)} to #{other(pair, line.id)} at #{Routes.clock(pair.at_s)}"}

    [
      text: line.from,
      number: route.items && Routes.items(route.items),
      number: route.seconds && "#{Routes.length_of(route.metres)}, #{Routes.clock(route.seconds)}",
      badges: [{"bad", line.blocks}] ++ List.wrap(nearest) ++ for(note <- route.notes, do: {"warn", note})
    ]
  end

  defp other(%{one: id, other: other}, id), do: other
  defp other(%{one: one}, _id), do: one

  @impl Sheet
  def summary(_sheet, lines, known) do
    case Routes.found(known) do
      nil ->
        ""

      routes ->
        assumed = for %{id: id, route: %{assumed: true}} <- lines, do: id
        said = routes.spare ++ List.wrap(Routes.nearest(routes)) ++ assumed(assumed)

        Enum.join(said, " ") <>
          " Compared at #{Clock.time(routes.at)} UTC, from where the vehicles were then: straight ways at planned " <>
          "speeds, without wind. The gateway keeps these missions aboard " <>
          "until others are wanted; fences and rally points of the files are not sent. Start missions … starts " <>
          "those in the air."
    end
  end

  defp assumed([]), do: []

  defp assumed(ids) do
    {named, more} = Enum.split(ids, @named)
    more = if more != [], do: " and #{length(more)} more"
    ["Speed not known, 5 m/s assumed: #{Enum.join(named, ", ")}#{more}."]
  end

  @impl Sheet
  def against(sheet, lines, known) do
    case {Routes.agreement(lines, known), sheet.own.agreed} do
      {nil, _agreed} -> nil
      {{_warnings, digest}, digest} -> nil
      _open -> "Somebody has to agree to what is said above: tick it."
    end
  end

  @impl Sheet
  def shown(_sheet, line), do: [line.route && line.route.hash, line.route && line.route.items]

  @impl Sheet
  def prepare(_sheet, %{"vehicles" => vehicles}, known, ask) do
    %{vehicles: routes} = Routes.found(known)
    texts = for [id, hash, _items] <- vehicles, uniq: true, do: {hash, routes[id].text}

    Enum.reduce_while(texts, :ok, fn {hash, text}, :ok ->
      case ask.put_plan.(text) do
        {:ok, ^hash} -> {:cont, :ok}
        {:error, {_kind, why}} -> {:halt, {:error, why}}
      end
    end)
  end

  @impl Sheet
  def request(%{"vehicles" => vehicles}, _known) do
    %{
      "name" => "Send missions",
      "await" => "converged",
      # Each is on its own; a burst of changes has at most 50.
      "step" => 20,
      "halt_ratio" => 1,
      "sequence" =>
        for [id, hash, _items] <- vehicles do
          change = %{"desired" => %{"mission" => %{"plan" => hash}}, "reason" => "mission to many"}
          %{"vehicle" => id, "steps" => [%{"shadow" => change}]}
        end
    }
  end

  @impl Sheet
  def extra(assigns), do: SendForm.form(assigns)
end
