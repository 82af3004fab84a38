defmodule Aerie.Console.Pages.Fleet.Act.Mission.Routes do
  @moduledoc """
  The plan of each vehicle from the files of a sheet, what speaks against it, and how near they come to each other. It
  takes up to some seconds for many, so it is done beside the page.
  """

  alias Aerie.Control.Missions
  alias Aerie.Console.Pages.Fleet.Act.Ask
  alias Aerie.Console.Pages.Plan.MapPayload
  alias Aerie.Fleet
  alias Aerie.Vehicle.Snapshot
  alias Protocols.Mission.Plan

  # Places on the map, for all together.
  @most_places 3_000
  # So many of a kind are said.
  @said 5

  @typedoc """
    * `:name` - of the file; `:text`, `:hash` - the plan as it is stored; `:way` - places for the map
    * `:at` of all - when it was worked out, from where the vehicles were
    * `:error` - why it cannot be sent; `:outside` - how it leaves the fence of its file
    * the rest as `t:Aerie.Fleet.Missions.Comparison.vehicle/0` has it
  """
  @type route :: map()
  @type t :: %{
          vehicles: %{String.t() => route()},
          nearest: map() | nil,
          limit_m: float(),
          spare: [String.t()],
          at: integer(),
          warnings: [String.t()]
        }

  @none %{name: nil, text: nil, hash: nil, items: nil, way: [], outside: []}
  @uncompared %{metres: nil, seconds: nil, assumed: false, notes: [], nearest: nil}

  @doc "The routes of vehicles in their order, by the values of the sheet."
  @spec of([%{name: String.t(), plan: Plan.t()}], [{String.t(), Snapshot.t()}], map(), Ask.t()) :: t()
  def of(files, vehicles, values, ask) do
    {chosen, spare} = chosen(values.how, files, vehicles, ask)

    plans =
      for {{id, snapshot}, n} <- Enum.with_index(vehicles) do
        {id, with({:ok, file} <- chosen.(id), do: plan(file, n, values, snapshot, ask))}
      end

    thin = &thinned(&1, max(div(@most_places, max(length(vehicles), 1)), 2))

    compared = ask.compare.(for({id, {:ok, plan, _route}} <- plans, do: {id, plan}), values.interval)

    routes =
      for {id, made} <- plans, into: %{} do
        case made do
          {:ok, _plan, route} -> {id, route |> Map.update!(:way, thin) |> Map.merge(compared.vehicles[id])}
          {:error, why} -> {id, @none |> Map.merge(@uncompared) |> Map.put(:error, why)}
        end
      end

    found = %{
      vehicles: routes,
      nearest: compared.nearest,
      limit_m: Fleet.least_separation_m(),
      spare: spare,
      at: System.os_time(:microsecond),
      warnings: []
    }

    %{found | warnings: near(found) ++ List.wrap(compared.error && "#{compared.error}.") ++ outside(routes)}
  end

  defp chosen("name", files, vehicles, ask) do
    tags = ask.tags.()
    tagged = for {id, _snapshot} <- vehicles, do: {id, tags[id] || []}
    {own, spare} = Fleet.assign_plans(Enum.map(files, & &1.name), tagged)

    choose = fn id ->
      with {:ok, name} <- own[id], do: {:ok, Enum.find(files, &(&1.name == name))}
    end

    {choose, for(name <- spare, do: "#{name} names none of these vehicles, by id or tag.")}
  end

  defp chosen(_one, [file], _vehicles, _ask), do: {fn _id -> {:ok, file} end, []}

  defp chosen(_one, files, _vehicles, _ask),
    do: {fn _id -> {:error, "there are #{length(files)} files: keep one, or choose By file name"} end, []}

  defp plan(%{name: name, plan: plan}, n, values, snapshot, ask) do
    with false <- Plan.empty?(plan, :mission) && {:error, "#{name} has no mission"},
         {:ok, plan} <- moved(plan, n, values),
         nil <- Missions.unsendable(plan) do
      {:ok, text} = Missions.export(plan, :plan)

      {:ok, plan,
       %{
         name: name,
         text: text,
         hash: :crypto.hash(:sha256, text) |> Base.encode16(case: :lower),
         items: length(plan.items),
         way: for([lat, lon, _n] <- MapPayload.aboard(plan).mission, do: {lat, lon}),
         error: ask.plan_refusal.(plan, snapshot),
         outside:
           for(%{outside?: true, part: :mission, text: text} <- Missions.own_fence(plan, snapshot), do: text)
       }}
    else
      {:error, why} -> {:error, why}
      why -> {:error, why}
    end
  end

  defp thinned(way, most), do: Enum.take_every(way, ceil(length(way) / most))

  defp moved(plan, n, %{how: "offset"} = values),
    do: Fleet.offset_plan(plan, n, Map.take(values, [:east, :north, :up]))

  defp moved(plan, _n, _values), do: {:ok, plan}

  defp near(%{nearest: %{metres: metres}, limit_m: limit} = found) when metres < limit,
    do: ["#{nearest(found)} #{round(limit)} m are wanted."]

  defp near(_found), do: []

  defp outside(routes) do
    texts = for {id, %{outside: texts}} <- Enum.sort(routes), text <- texts, do: "#{id}: #{text}."
    {said, more} = Enum.split(texts, @said)
    said ++ if(more == [], do: [], else: ["And #{length(more)} more leave a fence."])
  end

  @doc "What was worked out, nil as long as it is not there."
  @spec found(known :: map()) :: t() | nil
  def found(known), do: Enum.find_value(known, fn {_id, facts} -> facts[:routes] end)

  @doc "What somebody has to agree to, and the digest of that and of what is sent; nil for nothing."
  @spec agreement(lines :: [map()], known :: map()) :: {[String.t()], digest :: String.t()} | nil
  def agreement(lines, known) do
    with %{warnings: [_ | _] = warnings} <- found(known) do
      hashes = for %{n: n, id: id, route: %{hash: hash}} when n != nil <- lines, do: [id, hash]
      digest = :crypto.hash(:sha256, :erlang.term_to_binary({warnings, hashes}, [:deterministic]))
      {warnings, Base.encode16(digest, case: :lower)}
    else
      _nothing -> nil
    end
  end

  @doc "The nearest pass of all, as a sentence; nil where no two were compared."
  @spec nearest(t()) :: String.t() | nil
  def nearest(%{nearest: nil}), do: nil

  def nearest(%{nearest: pair}) do
    "Nearest #{metres(pair)} at #{clock(pair.at_s)} between #{pair.one} and #{pair.other}" <>
      if(pair.heights?, do: ".", else: ", on the map only, because a height is not known.")
  end

  @doc "The metres of a pass."
  @spec metres(map()) :: String.t()
  def metres(%{metres: metres}) when metres < 100, do: "#{:erlang.float_to_binary(metres, decimals: 1)} m"
  def metres(%{metres: metres}), do: length_of(metres)

  @doc "How many items."
  @spec items(non_neg_integer()) :: String.t()
  def items(1), do: "1 item"
  def items(n), do: "#{n} items"

  @doc "A length in metres or kilometres."
  @spec length_of(float()) :: String.t()
  def length_of(metres) when metres < 1_000, do: "#{round(metres)} m"
  def length_of(metres), do: "#{:erlang.float_to_binary(metres / 1_000, decimals: 1)} km"

  @doc "Minutes and seconds."
  @spec clock(number()) :: String.t()
  def clock(seconds) do
    seconds = round(seconds)
    pad = &String.pad_leading("#{&1}", 2, "0")
    "#{pad.(div(seconds, 60))}:#{pad.(rem(seconds, 60))}"
  end
end
