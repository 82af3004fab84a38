defmodule Aerie.Console.Map.Tiles.Area.Plan do
  @moduledoc """
  The tiles of an area in which somebody will fly without internet: those of a box, from the layer's first zoom to a
  chosen one. They are fetched two at a time. One that fails is asked for again; after 20 failures in a row the work
  ends. Pure.
  """

  @most 50_000
  @at_once 2
  @again_ms 5_000
  @failures 20

  @enforce_keys [:box, :zoom, :ranges, :total, :most]
  defstruct @enforce_keys ++ [next: 0, done: 0, bytes: 0, failures: 0, ended: nil]

  @typedoc "`most`: bytes that may come; `ended`: `:done` or why it ended before."
  @type t :: %__MODULE__{
          box: box(),
          zoom: non_neg_integer(),
          ranges: [{zoom :: non_neg_integer(), Range.t(), Range.t(), first :: non_neg_integer()}],
          total: non_neg_integer(),
          most: pos_integer(),
          next: non_neg_integer(),
          done: non_neg_integer(),
          bytes: non_neg_integer(),
          failures: non_neg_integer(),
          ended: nil | :done | String.t()
        }
  @type box :: %{west: number(), south: number(), east: number(), north: number()}
  @type event ::
          :begin
          | {:again, number :: non_neg_integer()}
          | {:cancel, String.t()}
          | {:fetched, number :: integer(), result}
  @type result :: {:ok, bytes :: non_neg_integer()} | {:error, String.t()}
  @type action ::
          {:fetch, number :: non_neg_integer()} | {:wait, ms :: pos_integer(), number :: non_neg_integer()}

  @doc "A plan; `most`: bytes that may come."
  @spec new(box(), Range.t(), most :: pos_integer()) :: {:ok, t()} | {:error, String.t()}
  def new(%{west: west, south: south, east: east, north: north} = box, zooms, most)
      when west < east and south < north and west >= -180 and east <= 180 and south >= -85 and north <= 85 do
    {ranges, total} =
      Enum.map_reduce(zooms, 0, fn zoom, first ->
        xs = column(west, zoom)..column(east, zoom)
        ys = row(north, zoom)..row(south, zoom)
        {{zoom, xs, ys, first}, first + Range.size(xs) * Range.size(ys)}
      end)

    if total <= @most,
      do: {:ok, %__MODULE__{box: box, zoom: zooms.last, ranges: ranges, total: total, most: most}},
      else:
        {:error, "#{total} tiles; at most #{@most} at a time: look at a smaller area, or take a lower zoom"}
  end

  def new(_box, _zooms, _most),
    do: {:error, "the area must lie between 85° south and north, and not on both sides of 180°"}

  defp column(lon, zoom), do: within((lon + 180) / 360, zoom)

  defp row(lat, zoom) do
    angle = lat * :math.pi() / 180
    within((1 - :math.log(:math.tan(angle) + 1 / :math.cos(angle)) / :math.pi()) / 2, zoom)
  end

  defp within(share, zoom), do: (share * 2 ** zoom) |> floor() |> max(0) |> min(2 ** zoom - 1)

  @doc "The place of a tile by its number."
  @spec tile(t(), non_neg_integer()) :: {integer(), integer(), integer()}
  def tile(%{ranges: ranges}, number) do
    {zoom, xs, ys, first} =
      ranges |> Enum.reverse() |> Enum.find(fn {_z, _xs, _ys, first} -> first <= number end)

    {zoom, xs.first + div(number - first, Range.size(ys)), ys.first + rem(number - first, Range.size(ys))}
  end

  @doc "What follows from an event."
  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(%{ended: ended} = plan, _event) when ended != nil, do: {plan, []}

  def handle(plan, :begin),
    do: Enum.reduce(1..@at_once, {plan, []}, fn _n, {plan, more} -> next(plan, more) end)

  def handle(plan, {:again, number}), do: {plan, [{:fetch, number}]}
  def handle(plan, {:cancel, words}), do: {%{plan | ended: words}, []}

  def handle(plan, {:fetched, _number, {:ok, bytes}}) do
    plan = %{plan | done: plan.done + 1, bytes: plan.bytes + bytes, failures: 0}

    cond do
      plan.done == plan.total ->
        {%{plan | ended: :done}, []}

      plan.bytes > plan.most ->
        {%{plan | ended: "the gateway's room for tiles is full (console.map.cache_mb)"}, []}

      true ->
        next(plan, [])
    end
  end

  def handle(plan, {:fetched, number, {:error, words}}) do
    plan = %{plan | failures: plan.failures + 1}
    if plan.failures < @failures, do: {plan, [{:wait, @again_ms, number}]}, else: {%{plan | ended: words}, []}
  end

  defp next(%{next: number, total: total} = plan, more) when number < total,
    do: {%{plan | next: number + 1}, more ++ [{:fetch, number}]}

  defp next(plan, more), do: {plan, more}
end
