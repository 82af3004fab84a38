defmodule Aerie.Console.Pages.Fleet.Act.Return do
  @moduledoc """
  A return of several vehicles as it is prepared: each at a height of its own, the nearest to its home lowest, and one
  after the other where they land at one place. Pure.

  A firmware that climbs by itself to a height of its own before it returns undoes its place in the stack: the line
  says so.
  """
  @behaviour Aerie.Console.Pages.Fleet.Act.Sheet

  alias Aerie.Base.Geo.Earth
  alias Aerie.Console.Pages.Fleet.Act.Sheet
  alias Aerie.Vehicle.Snapshot

  @enforce_keys [:order]
  defstruct [:order, out: MapSet.new(), base: 30, step: 3, error: nil]

  @typedoc "`:base` - the lowest height, m above home; `:step` - how much higher the next one flies"
  @type t :: %__MODULE__{}

  @typedoc """
  What is known of a vehicle: its snapshot, the height of its firmware's own (0: it keeps its height, nil: not known),
  whether it takes another height, and why the policy or the firmware refuses it.
  """
  @type facts :: %{
          snapshot: Snapshot.t(),
          own: number() | nil,
          climbs?: boolean(),
          refusal: String.t() | nil
        }

  @typedoc """
  A line of the sheet: `:height` - nil for one that takes none; `:after` - the vehicle that lands at the same place
  before it; `:warn` - what undoes its height; `:blocks` - why nothing begins with it
  """
  @type line :: %{
          id: String.t(),
          n: pos_integer() | nil,
          height: number() | nil,
          home_m: number() | nil,
          after: String.t() | nil,
          warn: String.t() | nil,
          blocks: String.t() | nil
        }

  # Homes nearer than this are one place to land.
  @pad_m 3
  @limits %{base: {5, 500}, step: {3, 50}}

  @doc "The limits of the numbers."
  @spec limits() :: Sheet.limits()
  def limits, do: @limits

  @doc "A sheet for these vehicles, the nearest to its home first. Distances that change later change no order."
  @spec new([Snapshot.t(), ...]) :: t()
  def new(vehicles),
    do: %__MODULE__{order: vehicles |> Enum.sort_by(&{home_m(&1), &1.id}) |> Enum.map(& &1.id)}

  @impl Sheet
  def event(sheet, "change", fields) do
    {numbers, error} = Sheet.numbers(@limits, fields)
    struct!(sheet, Map.put(numbers, :error, error))
  end

  def event(sheet, "leave", %{"id" => id}), do: Sheet.leave(sheet, id)
  def event(sheet, _unknown, _value), do: sheet

  @doc "The height of the one that so many fly below."
  @spec height(t(), n :: non_neg_integer()) :: number()
  def height(sheet, n), do: sheet.base + n * sheet.step

  @doc "The lines in their order, with what is known of each vehicle, by id."
  @spec lines(t(), %{String.t() => facts()}) :: [line()]
  def lines(sheet, facts) do
    {lines, _landing} =
      Enum.map_reduce(Sheet.places(sheet), [], fn {id, n}, landing ->
        line = line(sheet, {id, n}, facts[id], landing)
        home = n && facts[id] && Sheet.place(facts[id].snapshot, :home)
        {line, if(home, do: [{id, home} | landing], else: landing)}
      end)

    lines
  end

  defp line(sheet, {id, n}, facts, landing) do
    height = n && facts && facts.climbs? && height(sheet, n)

    %{
      id: id,
      n: n && n + 1,
      height: height || nil,
      home_m: facts && metres(home_m(facts.snapshot)),
      after: n && facts && before(Sheet.place(facts.snapshot, :home), landing),
      warn: n && facts && warn(facts, height),
      blocks: n && blocks(id, facts)
    }
  end

  # The last one before it that lands there.
  defp before(nil, _landing), do: nil

  defp before(home, landing),
    do: Enum.find_value(landing, fn {id, other} -> if apart(home, other) < @pad_m, do: id end)

  defp apart({lat, lon}, {other_lat, other_lon}),
    do: Earth.distance(Earth.point(lat, lon), Earth.point(other_lat, other_lon))

  defp warn(%{climbs?: false}, _height), do: "It takes no other height: it returns at its own."

  defp warn(%{snapshot: snapshot, own: own}, height) do
    cond do
      Sheet.place(snapshot, :home) == nil -> "Its home is not known, so its place to land is not compared."
      own == nil -> "Its own return height is not known: it may climb."
      own > height -> "It climbs to its own #{round(own)} m."
      true -> nil
    end
  end

  defp blocks(id, nil), do: "#{id} is not known any more: leave it out."

  defp blocks(id, %{snapshot: snapshot, refusal: refusal}) do
    cond do
      Snapshot.data(snapshot, :mode)[:in_air] != true -> "#{id} is not in the air: leave it out."
      refusal -> "#{id}: #{refusal}"
      true -> nil
    end
  end

  # What is not known is far away.
  defp home_m(snapshot), do: Snapshot.distance(snapshot, Sheet.place(snapshot, :home)) || :unknown
  defp metres(:unknown), do: nil
  defp metres(metres), do: round(metres)

  @impl Sheet
  def refusal(sheet, facts) do
    going = for %{n: n} = line when n != nil <- lines(sheet, facts), do: line

    cond do
      sheet.error -> sheet.error
      going == [] -> "All are left out."
      true -> Enum.find_value(going, & &1.blocks)
    end
  end

  @impl Sheet
  def shown(sheet, facts) do
    vehicles =
      for %{n: n} = line when n != nil <- lines(sheet, facts),
          do: [line.id, line.height, line.after, line.warn]

    %{"return" => vehicles}
  end

  @doc "The operation that such a press asks for. `steps` gives a vehicle's part of it (`Aerie.Fleet.return_home/3`)."
  @spec request(id :: String.t(), shown :: map(), (String.t(), number() | nil, String.t() | nil -> map())) ::
          map()
  def request(id, %{"return" => vehicles}, steps) do
    %{
      "id" => id,
      "name" => "Return",
      "step" => Sheet.most(),
      "halt_ratio" => 1,
      "sequence" => for([vehicle, height, other, _warn] <- vehicles, do: steps.(vehicle, height, other))
    }
  end
end
