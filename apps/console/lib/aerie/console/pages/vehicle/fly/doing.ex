defmodule Aerie.Console.Pages.Vehicle.Fly.Doing do
  @moduledoc """
  One sentence of what a vehicle does now: `Returning, 118 m from home, 20 s`. It comes from the command that it carries
  out (`Aerie.Console.Commands.Outcome`), or else from its mode: a failsafe or a pilot gives no command. Pure.
  """

  alias Aerie.Console.Commands.Outcome
  alias Aerie.Console.Pages.Vehicle.View
  alias Aerie.Vehicle.Firmware

  # Words for an action, and the command whose progress says how far it is.
  @actions %{
    return: {"Returning", "rtl"},
    land: {"Landing", "land"},
    mission: {"Flying the mission", "resume"},
    take_off: {"Taking off", "hold"},
    hold: {"Holding position", "hold"},
    hold_height: {"Holding its height", "hold"},
    orbit: {"Circling", "hold"},
    follow: {"Following", "hold"},
    waits: {"Waiting for a command", "hold"}
  }
  @moving_m_s 1

  @doc "The sentence, of the latest commands and their courses by id."
  @spec of(View.t(), [map()], %{String.t() => Outcome.t()}) :: String.t()
  def of(%View{vehicle: %{status: :lost}} = view, entries, courses),
    do: "Last known: #{now(view, entries, courses)}"

  def of(view, entries, courses), do: now(view, entries, courses)

  defp now(view, entries, courses) do
    going = Enum.find_value(entries, &if(match?(%{stage: :going}, courses[&1.id]), do: courses[&1.id]))
    mode = View.get(view, [:mode, :mode])

    case {going, View.get(view, [:mode, :in_air]), View.get(view, [:mode, :armed])} do
      {%{label: label, text: text}, _in_air, _armed} -> sentence(label, text)
      {nil, false, true} -> "Armed on the ground"
      {nil, false, false} -> "On the ground, disarmed"
      {nil, false, nil} -> "On the ground"
      {nil, nil, false} -> "Disarmed"
      {nil, nil, nil} -> "State unknown"
      {nil, in_air, _armed} -> by_mode(view, Firmware.action(mode), mode, in_air)
    end
  end

  defp by_mode(view, nil, mode, in_air) do
    words = if in_air, do: "Flying", else: "Armed"
    sentence(if(mode, do: "#{words} in #{mode}", else: "#{words}, mode unknown"), height(view))
  end

  # A program may steer it by set-points, or it is on its way since before the gateway was started.
  defp by_mode(view, :guided, mode, in_air) do
    speed = View.get(view, [:velocity, :groundspeed])

    if is_number(speed) and speed >= @moving_m_s,
      do: by_mode(view, nil, mode, in_air),
      else: by_mode(view, :waits, mode, in_air)
  end

  defp by_mode(view, action, _mode, _in_air) do
    {words, type} = @actions[action]
    sentence(words, Outcome.progress(%{type: type}, view.vehicle))
  end

  defp height(view), do: Outcome.progress(%{type: "hold"}, view.vehicle)

  defp sentence(words, nil), do: words
  defp sentence(words, progress), do: "#{words}, #{progress}"
end
