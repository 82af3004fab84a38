defmodule Aerie.Console.Pages.Replay.Overview do
  @moduledoc "A day of the fleet for a time line: a row for each vehicle, marks, and notes on what is missing."

  alias Aerie.Access.WorkLimit
  alias Aerie.Console.Pages.Replay.{Marks, TimeLine}
  alias Aerie.Fleet

  @day_us 24 * 3_600_000_000
  @max_vehicles 200
  # A day of 200 vehicles, a sample a minute.
  @samples 300_000

  @typedoc "`from`, `to`: unix seconds; `known`: the ids of all vehicles that can be chosen."
  @type t :: %{
          from: integer(),
          to: integer(),
          rows: [map()],
          marks: [Marks.mark()],
          notes: [String.t()],
          since: integer() | nil,
          known: [String.t()]
        }

  @doc "The most rows."
  @spec max_vehicles() :: pos_integer()
  def max_vehicles, do: @max_vehicles

  @doc "Reads it in a task of the page, whose answer is that of `Aerie.Access.WorkLimit.run/4`."
  @spec task(term(), map(), :all | [String.t()], now :: integer()) :: Task.t()
  def task(gateway, user, whose, now) do
    Task.async(fn ->
      WorkLimit.run(gateway, :read, {:name, user.name}, fn -> read(gateway, user, whose, now) end)
    end)
  end

  @doc "The day before `now` (unix microseconds) of these vehicles, as this user may see it."
  @spec read(term(), map(), :all | [String.t()], now :: integer()) :: {:ok, t()} | {:error, String.t()}
  def read(gateway, user, whose, now) do
    from = now - @day_us

    with {:ok, %{vehicles: found, since: since, next: next}} <-
           Fleet.tracks(gateway, whose, from, now, 60, limit: @samples) do
      {marks, notes} = Marks.read(gateway, user, from, now)
      kinds = for vehicle <- Fleet.vehicles(gateway), into: %{}, do: {vehicle.id, vehicle.vehicle_type}
      marks = if whose == :all, do: marks, else: Enum.filter(marks, &(&1.vehicle in whose))
      {shown, more} = found |> Enum.sort() |> Enum.split(@max_vehicles)

      notes =
        for(
          {true, text} <- [
            {more != [], "#{length(more)} further vehicles: choose some"},
            {next != nil, "The newest part of the time line is missing: choose fewer vehicles"}
          ],
          do: text
        ) ++ notes

      rows = for {id, samples} <- shown, do: %{id: id, kind: kinds[id], spans: TimeLine.spans(samples)}

      {:ok,
       %{
         from: div(from, 1_000_000),
         to: div(now, 1_000_000),
         rows: rows,
         marks: marks,
         notes: notes,
         since: since,
         known: (Map.keys(kinds) ++ Map.keys(found)) |> Enum.uniq() |> Enum.sort()
       }}
    end
  end
end
