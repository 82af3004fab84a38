defmodule Aerie.Console.Pages.Fleet.Act.Mission.Start do
  @moduledoc """
  The missions of several vehicles, started one after the other. Pure. The first one that fails ends it: the others do
  not begin.
  """
  @behaviour Aerie.Console.Pages.Fleet.Act.Sheet

  alias Aerie.Console.Pages.Fleet.Act.Sheet
  alias Aerie.Vehicle.Snapshot

  @impl Sheet
  def about do
    %{
      id: "start",
      title: "Start the missions of",
      go: "Start",
      icon: "play",
      order: "Order of the starts",
      in_turn?: true
    }
  end

  @impl Sheet
  def fields, do: [%{name: :interval, label: "Between two", unit: "s", range: {0, 3_600}, default: 10}]

  @impl Sheet
  def rank(vehicle), do: vehicle.id

  @impl Sheet
  def facts(_sheet, vehicle, _n, ask), do: %{refusal: ask.refusal.(vehicle, [{"mission_start", %{}}], [])}

  @impl Sheet
  def line(sheet, {id, n}, facts, _before) do
    data = &if(facts, do: Snapshot.data(facts.snapshot, &1), else: %{})
    items = data.(:mission)[:total]

    %{
      items: items,
      after_s: n && n * Sheet.values(sheet).interval,
      blocks:
        cond do
          items == 0 -> "#{id} has no mission aboard: leave it out."
          data.(:mode)[:in_air] != true -> "#{id} is not in the air: leave it out."
          true -> nil
        end
    }
  end

  @impl Sheet
  def cells(line),
    do: [text: items(line.items), number: if(line.n, do: "+#{line.after_s} s", else: "left out")]

  defp items(nil), do: "mission not known"
  defp items(0), do: "no mission"
  defp items(1), do: "1 item"
  defp items(n), do: "#{n} items"

  @impl Sheet
  def summary(_sheet, _lines, _known) do
    "Each begins when the one before flies its mission. If one fails, the others do not begin. " <>
      "Whether the ways come near to each other is not compared."
  end

  @impl Sheet
  def shown(_sheet, line), do: [line.items]

  @impl Sheet
  def request(%{"vehicles" => vehicles, "values" => values}, _known) do
    %{
      "name" => "Start missions",
      "pause_s" => values["interval"],
      "halt_ratio" => 0,
      "sequence" =>
        for([id, _items] <- vehicles, do: %{"vehicle" => id, "steps" => [%{"type" => "mission_start"}]})
    }
  end
end
