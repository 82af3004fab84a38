defmodule Aerie.Console.Pages.Fleet.Act.TakeOff do
  @moduledoc "A take-off of several vehicles: who, in which order, how high, and when the next one begins. Pure."
  @behaviour Aerie.Console.Pages.Fleet.Act.Sheet

  alias Aerie.Console.Pages.Fleet.Act.Sheet
  alias Aerie.Console.UI.Badge
  alias Aerie.Fleet
  alias Aerie.Vehicle.Snapshot

  # Twice the room of a vehicle.
  @near_m 3.0

  @impl Sheet
  def about do
    %{
      id: "take-off",
      title: "Take off",
      go: "Take off",
      icon: "takeoff",
      order: "Order of the take-off",
      in_turn?: true
    }
  end

  @impl Sheet
  def fields do
    [
      %{name: :height, label: "Height (above home)", unit: "m", range: {1, 1_000}, default: 20},
      %{
        name: :stacked,
        label: "Heights",
        options: [{"Stacked", "true"}, {"The same for all", "false"}],
        default: "true"
      },
      %{
        name: :gap,
        label: "More each",
        unit: "m",
        range: {0, 100},
        default: 3,
        only: {:stacked, "true"}
      },
      %{name: :interval, label: "Between two", unit: "s", range: {0, 600}, default: 6},
      %{name: :above, label: "Next one only above", unit: "m", range: {0.5, 100}, default: &above/1},
      %{
        name: :on_fail,
        label: "If one fails",
        options: [
          {"Hold the rest on the ground", "hold"},
          {"Continue without it", "continue"},
          {"Bring all back", "return"}
        ],
        default: "hold"
      }
    ]
  end

  # 5 m, or half of a height below 10 m.
  defp above(%{height: height}), do: min(5, max(trunc(height / 2), 0.5))

  @impl Sheet
  def errors(%{above: above, height: height}) when is_number(above) and is_number(height) do
    most = Fleet.surely_above_m(height)
    text = "The lowest flies at #{height} m and is not surely above #{above} m: give at most #{most} m."
    if above > most, do: %{above: text}, else: %{}
  end

  # From south to north.
  @impl Sheet
  def rank(vehicle), do: Snapshot.data(vehicle, :position)[:lat] || 90

  @impl Sheet
  def facts(sheet, vehicle, n, ask) do
    commands = [{"arm", nil}, {"takeoff", n && %{altitude: height(sheet, n)}}]
    # It is armed before it takes off.
    %{readiness: ask.readiness.(vehicle), refusal: n && ask.refusal.(vehicle, commands, [:firmware])}
  end

  @impl Sheet
  def line(sheet, {id, n}, facts, before) do
    readiness = facts[:readiness] || %{state: :unknown, points: []}
    near = near(facts, before)
    open? = n != nil and readiness.state == :unknown and not MapSet.member?(sheet.anyway, id)

    %{
      height: n && height(sheet, n),
      after_s: n && n * Sheet.values(sheet).interval,
      state: readiness.state,
      why: worst(readiness) || facts[:refusal],
      anyway?: open?,
      near: near,
      conflict?: match?({_id, metres} when metres < @near_m, near),
      blocks:
        cond do
          readiness.state == :not_ready -> "#{id} is not ready: leave it out."
          open? -> "It is not known whether #{id} is ready: leave it out, or take it along anyway."
          true -> nil
        end
    }
  end

  # The nearest of those before it, with the metres; nil without two places.
  defp near(nil, _before), do: nil

  defp near(%{snapshot: snapshot}, before) do
    distances =
      for {id, %{snapshot: other}} <- before,
          metres = Snapshot.distance(snapshot, Sheet.place(other)),
          do: {id, metres}

    Enum.min_by(distances, &elem(&1, 1), fn -> nil end)
  end

  defp height(sheet, n) do
    %{height: height, gap: gap, stacked: stacked} = Sheet.values(sheet)
    if stacked == "true", do: height + n * gap, else: height
  end

  defp worst(%{state: state, points: points}) when state != :ready,
    do: with(%{title: title, text: text} <- Enum.find(points, &(&1.state == state)), do: "#{title}: #{text}")

  defp worst(_ready), do: nil

  @impl Sheet
  def cells(line) do
    [
      readiness: line.state,
      muted: line.why,
      number: if(line.n, do: "#{line.height} m", else: "left out"),
      number: line.n && "+#{line.after_s} s"
    ]
  end

  @impl Sheet
  def summary(sheet, lines, _known) do
    going = Enum.filter(lines, & &1.n)

    [
      "#{Badge.counts(Enum.map(lines, & &1.state))}.",
      if(Enum.all?(going, &(&1.blocks == nil)),
        do: "Policy and firmware: allowed for all that take off."
      ),
      with(
        {one, other, metres} <- nearest(going),
        do: "Nearest on the ground: #{one} and #{other}, #{Float.round(metres, 1)} m."
      ),
      stack(Sheet.values(sheet), length(going))
    ]
  end

  defp stack(_values, going) when going < 2, do: nil
  defp stack(%{stacked: "true", gap: gap}, _going), do: "In the stack #{gap} m apart in height."
  defp stack(_values, _going), do: "All at the same height."

  @impl Sheet
  def against(_sheet, going, _known) do
    with {one, other, metres} when metres < @near_m <- nearest(going) do
      "#{one} and #{other} stand #{Float.round(metres, 1)} m apart; #{@near_m} m are wanted. Leave one of them out."
    else
      _far -> nil
    end
  end

  # The two nearest to each other; nil without two places.
  defp nearest(going) do
    pairs = for %{id: other, near: {one, metres}} <- going, do: {one, other, metres}
    Enum.min_by(pairs, &elem(&1, 2), fn -> nil end)
  end

  @impl Sheet
  def shown(sheet, line),
    do: [line.height, Atom.to_string(line.state), MapSet.member?(sheet.anyway, line.id)]

  @impl Sheet
  def request(%{"vehicles" => vehicles, "values" => values}, known) do
    plan =
      case values["on_fail"] do
        "hold" -> %{"halt_ratio" => 0}
        "continue" -> %{"halt_ratio" => 1}
        "return" -> %{"halt_ratio" => 0, "on_halt" => "return"}
      end

    Map.merge(plan, %{
      "name" => "Take off",
      "pause_s" => values["interval"],
      "sequence" =>
        for(
          [id, height, _state, anyway?] <- vehicles,
          do: Fleet.take_off(known[id].snapshot, height, values["above"], anyway?)
        ),
      "shown" => for([id, _height, state, _anyway] <- vehicles, into: %{}, do: {id, state})
    })
  end
end
