defmodule Aerie.Console.Pages.Vehicle.Events.Timeline do
  @moduledoc "A vehicle's events and texts as lines that can be filtered by severity. Pure."

  alias Aerie.Fleet

  @max 200
  @levels [all: 7, notice: 5, warning: 4, error: 3]
  @names ~w(emergency alert critical error warning notice info debug)

  @typedoc "`:tone` of `severity` (0 emergency to 7 debug): `:bad` to 3, `:warn` for 4, `:plain` for the rest."
  @type line :: %{
          id: String.t(),
          vehicle: String.t(),
          time: integer(),
          type: String.t(),
          severity: 0..7,
          name: String.t(),
          tone: :bad | :warn | :plain,
          text: String.t()
        }

  @doc "The levels to choose from, by name."
  @spec levels() :: [String.t()]
  def levels, do: for({name, _least} <- @levels, do: Atom.to_string(name))

  @doc "The lines of events, newest first, at most #{@max}. `level`: one of `levels/0`; `search`: a part of the type or text."
  @spec lines([map()], level :: String.t(), search :: String.t()) :: [line()]
  def lines(events, level \\ "all", search \\ ""),
    do: events |> Enum.reverse() |> Stream.map(&line/1) |> keep(level, search)

  @doc "The first #{@max} of these lines that are of the level and have the text."
  @spec keep(Enumerable.t(line()), level :: String.t(), search :: String.t()) :: [line()]
  def keep(lines, level, search) do
    least = for({name, least} <- @levels, Atom.to_string(name) == level, do: least) |> List.first(7)
    search = String.downcase(search)

    lines
    |> Stream.filter(
      &(&1.severity <= least and String.contains?(String.downcase("#{&1.type} #{&1.text}"), search))
    )
    |> Enum.take(@max)
  end

  @doc "The line of an event."
  @spec line(map()) :: line()
  def line(event) do
    shown = Fleet.describe_event(event)

    event
    |> Map.take([:id, :vehicle, :time, :type])
    |> Map.merge(shown)
    |> named()
  end

  @doc "A line with the name and the tone of its severity."
  @spec named(map()) :: line()
  def named(%{severity: severity} = line),
    do: Map.merge(line, %{name: Enum.at(@names, severity), tone: tone(severity)})

  defp tone(severity) when severity <= 3, do: :bad
  defp tone(4), do: :warn
  defp tone(_severity), do: :plain
end
