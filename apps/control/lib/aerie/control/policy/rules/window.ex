defmodule Aerie.Control.Policy.Rules.Window do
  @moduledoc """
  Some commands are allowed at some times only: where windows name a type, one of them must be open. Times are UTC; a
  window whose end is before its start goes over midnight and belongs to the day on which it starts. On the ground, what
  may make the vehicle take off or arm needs the windows of `takeoff` and `arm` as well.
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.Intent
  alias Aerie.Vehicle.Command.Refusal

  @days {:mon, :tue, :wed, :thu, :fri, :sat, :sun}

  @typedoc "`from` and `to` in minutes of the day; `types` is `:moving` for all commands that may move the vehicle."
  @type window :: %{types: [String.t()] | :moving, days: [atom()], from: 0..1439, to: 0..1440}

  @doc "The days as they are written, Monday first."
  @spec days() :: [atom()]
  def days, do: Tuple.to_list(@days)

  @impl Aerie.Control.Policy.Rules.Rule

  def check(%{windows: []}, _facts, _context), do: :ok

  def check(policy, facts, %{now: now} = context) do
    facts
    |> types(context)
    |> Enum.map(fn type -> Enum.filter(policy.windows, &names?(&1, type, facts)) end)
    |> Enum.find(&(&1 != [] and not Enum.any?(&1, fn window -> open?(window, now) end)))
    |> case do
      nil ->
        :ok

      windows ->
        open = Enum.map_join(windows, " or ", &text/1)
        Refusal.deny(:window, command: Intent.label(facts), windows: open, now: clock(now))
    end
  end

  # Commands that hold the vehicle or bring it down are exempt, but not those that also arm it.
  defp types(%{ends_flight?: true} = facts, context),
    do: facts |> Intent.types(context) |> List.delete(facts.type)

  defp types(facts, context), do: Intent.types(facts, context)

  defp names?(%{types: :moving}, type, facts), do: facts.moves? and type == facts.type
  defp names?(%{types: types}, type, _facts), do: type in types

  defp open?(window, now) do
    minute = Integer.mod(div(now, 60_000_000), 1440)
    day = weekday(now)
    yesterday = if day == 1, do: 7, else: day - 1

    if window.from < window.to,
      do: on?(window, day) and minute >= window.from and minute < window.to,
      else: (on?(window, day) and minute >= window.from) or (on?(window, yesterday) and minute < window.to)
  end

  defp on?(window, day), do: elem(@days, day - 1) in window.days

  defp weekday(now), do: now |> DateTime.from_unix!(:microsecond) |> Date.day_of_week()

  defp text(window) do
    days =
      if length(window.days) == 7, do: "", else: Enum.map_join(window.days, ", ", &Atom.to_string/1) <> " "

    "#{days}#{time(window.from)} to #{time(window.to)} UTC"
  end

  defp clock(now) do
    minute = Integer.mod(div(now, 60_000_000), 1440)
    "#{elem(@days, weekday(now) - 1)} #{time(minute)} UTC"
  end

  defp time(minutes), do: "#{two(div(minutes, 60))}:#{two(rem(minutes, 60))}"
  defp two(number), do: number |> Integer.to_string() |> String.pad_leading(2, "0")
end
