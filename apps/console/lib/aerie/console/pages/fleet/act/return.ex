defmodule Aerie.Console.Pages.Fleet.Act.Return do
  @moduledoc """
  A return of several vehicles: each at a height of its own, the nearest to its home lowest, and one after the other
  where they land at one place. Pure.

  A firmware that climbs by itself to a height of its own before it returns undoes its place in the stack: the line
  says so.
  """
  @behaviour Aerie.Console.Pages.Fleet.Act.Sheet

  alias Aerie.Base.Geo.Earth
  alias Aerie.Console.Pages.Fleet.Act.Sheet
  alias Aerie.Fleet
  alias Aerie.Vehicle.Snapshot

  # Homes nearer than this are one place to land.
  @pad_m 3

  @impl Sheet
  def about do
    %{
      id: "return",
      title: "Return",
      go: "Return",
      icon: "rtl",
      order: "The nearest to its home flies lowest",
      in_turn?: false
    }
  end

  @impl Sheet
  def fields do
    [
      %{name: :base, label: "Lowest, above home", unit: "m", range: {5, 500}, default: 30},
      %{name: :step, label: "More each", unit: "m", range: {3, 50}, default: 3}
    ]
  end

  @impl Sheet
  def rank(vehicle), do: home_m(vehicle)

  # What is not known is far away: an atom is greater than a number.
  defp home_m(snapshot), do: Snapshot.distance(snapshot, Sheet.place(snapshot, :home)) || :unknown

  # `climbs?`: whether it takes another height; `own`: that of its firmware (0: it keeps its height).
  @impl Sheet
  def facts(sheet, vehicle, n, ask) do
    climbs? = ask.refusal.(vehicle, [{"set_altitude", nil}], []) == nil
    climb = if n && climbs?, do: [{"set_altitude", %{altitude: height(sheet, n)}}], else: []

    %{
      own: ask.own_return_m.(vehicle),
      climbs?: climbs?,
      refusal: ask.refusal.(vehicle, [{"rtl", %{}} | climb], [])
    }
  end

  defp height(sheet, n) do
    %{base: base, step: step} = Sheet.values(sheet)
    base + n * step
  end

  @impl Sheet
  def line(_sheet, _place, nil, _before), do: %{height: nil, home_m: nil, after: nil, warn: nil, blocks: nil}

  def line(sheet, {id, n}, %{snapshot: snapshot} = facts, before) do
    height = if n && facts.climbs?, do: height(sheet, n)
    home = Sheet.place(snapshot, :home)
    other = n && same_place(home, before)

    %{
      height: height,
      home_m: metres(home_m(snapshot)),
      way: List.wrap(home),
      after: other,
      conflict?: other != nil,
      warn: n && warn(facts, height),
      blocks:
        if(Snapshot.data(snapshot, :mode)[:in_air] != true, do: "#{id} is not in the air: leave it out.")
    }
  end

  defp metres(:unknown), do: nil
  defp metres(metres), do: round(metres)

  # The last one before it that lands there.
  defp same_place(nil, _before), do: nil

  defp same_place(home, before) do
    Enum.find_value(before, fn {id, %{snapshot: other}} ->
      if apart(home, Sheet.place(other, :home)) < @pad_m, do: id
    end)
  end

  # An atom is greater than a number.
  defp apart(_home, nil), do: :unknown

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

  @impl Sheet
  def cells(line) do
    [
      number:
        cond do
          line.n == nil -> "left out"
          line.height == nil -> "own height"
          true -> "#{line.height} m"
        end,
      number: if(line.home_m, do: "#{line.home_m} m away", else: "distance unknown"),
      badges: [
        {"bad", line.after && "One place with #{line.after}: waits until that has landed"},
        {"warn", line.warn}
      ]
    ]
  end

  @impl Sheet
  def summary(_sheet, lines, _known) do
    undone = Enum.count(lines, & &1.warn)

    [
      "Each goes to its height first, then home; one that does not reach it stays where it is.",
      if(Enum.any?(lines, & &1.after),
        do: "Those that wait go on 15 s after the other landing: clear the place by then."
      ),
      if(undone > 0, do: "#{undone} may leave the stack.")
    ]
  end

  @impl Sheet
  def shown(_sheet, line), do: [line.height, line.after, line.warn]

  @impl Sheet
  def request(%{"vehicles" => vehicles}, _known) do
    %{
      "name" => "Return",
      "step" => Sheet.most(),
      "halt_ratio" => 1,
      "sequence" => for([id, height, other, _warn] <- vehicles, do: Fleet.return_home(id, height, other))
    }
  end
end
