defmodule Aerie.Control.Policy.Switches do
  @moduledoc """
  What the channels and buttons that an override or a joystick works do to a vehicle, as its firmware has it
  (`Aerie.Vehicle.Firmware.Inputs`) and by its parameters as far as they are known (`Aerie.Vehicle.Services.Switches`).
  Each effect is judged like the command that does the same: a kill switch needs `terminate`, a mode switch changes the
  mode.

  The four sticks are a pilot's and pass. A channel or button whose effect nobody here knows needs the most, because it
  may be the one that stops the motors. Vehicles that are steered by channels are not meant: these need `receiver`.
  """

  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Mavlink.AuxFunctions
  alias Aerie.Control.Policy.Switches.Gestures
  alias Aerie.Vehicle.Firmware

  @sticks 4

  @typedoc "What a channel or button does, and which one in words; `:unknown` for what is not known."
  @type effect :: {why :: String.t(), Intent.t() | :unknown}

  @doc """
  The facts with all that its channels and buttons need and amount to. Where modes are limited, the rule `mode`
  refuses what is not known, whatever
  the permissions.
  """
  @spec judge(Intent.t(), Context.t(), modes_limited? :: boolean()) :: Intent.t()
  def judge(%{switches: nil} = facts, _context, _modes_limited?), do: facts

  def judge(facts, context, modes_limited?) do
    if Firmware.reading(context.autopilot).steered_by == :channels,
      do: facts,
      else: judged(facts, context, modes_limited?)
  end

  defp judged(facts, context, modes_limited?) do
    facts.switches
    |> effects(context)
    |> Enum.reject(fn {_why, effect} -> effect == :unknown and modes_limited? end)
    # The first one gives the reason.
    |> Enum.sort_by(fn {_why, effect} -> effect == :unknown end)
    |> Enum.reduce(facts, fn {why, effect}, facts ->
      {needs, implies} = needs(effect)

      %{
        facts
        | also: Enum.uniq(facts.also ++ needs),
          implies: Enum.uniq(facts.implies ++ implies),
          reasons: Map.merge(Map.new(needs, &{&1, why}), facts.reasons)
      }
    end)
  end

  defp needs(:unknown), do: {Intent.most(), ["takeoff", "arm"]}

  defp needs(effect) do
    arms = if effect.type == "arm", do: ["arm"], else: []
    {[effect.permission | effect.also], arms ++ effect.implies}
  end

  @doc "The modes that may be entered by it, by their names, or what would have to be known."
  @spec modes(Intent.t(), Context.t()) :: {:ok, [String.t()]} | {:unknown, String.t()}
  def modes(%{switches: nil}, _context), do: {:ok, []}

  def modes(%{switches: switches}, context) do
    effects = effects(switches, context)

    case Enum.find(effects, &unknown_mode?/1) do
      {why, _effect} -> {:unknown, why}
      nil -> {:ok, for({_why, %Intent{mode: mode}} <- effects, mode != nil, uniq: true, do: mode)}
    end
  end

  defp unknown_mode?({_why, :unknown}), do: true
  defp unknown_mode?({_why, %Intent{type: "set_mode", mode: nil}}), do: true
  defp unknown_mode?(_known), do: false

  @spec effects(Intent.switches(), Context.t()) :: [effect()]
  defp effects(:unknown, _context), do: [{"which channels it works cannot be read", :unknown}]

  defp effects(switches, context) do
    case Firmware.traits(context.autopilot).inputs do
      nil ->
        # One firmware works more channels by a message than another.
        channels = Enum.reduce(Firmware.inputs(), %{}, &Map.merge(&2, &1.worked(switches.channels)))
        worked = %{switches | channels: channels}
        unknown(worked) ++ Gestures.effects(worked, context)

      inputs ->
        worked = %{switches | channels: inputs.worked(switches.channels)}

        for(
          {why, what} <- inputs.effects(worked, context.vehicle_type, context.params),
          do: {why, facts(what)}
        ) ++
          Gestures.effects(worked, context)
    end
  end

  defp facts({:mode, []}), do: Intent.named("set_mode", implies: ["takeoff"])
  defp facts({:mode, [mode | others]}), do: Intent.named("set_mode", mode: mode, modes: others)
  defp facts({:command, type, also}), do: Intent.named(type, also: also)
  defp facts({:function, number, level}), do: AuxFunctions.facts(number, level)

  defp facts({:output, permission, also}),
    do: %Intent{type: "aux_function", permission: permission, also: also}

  defp facts(:parameter), do: Intent.set_parameters([nil])
  defp facts(:unknown), do: :unknown

  defp unknown(worked) do
    whats =
      for({n, _us} <- Enum.sort(worked.channels), n > @sticks, do: "what channel #{n} switches") ++
        for(n <- worked.buttons, do: "what button #{n} does") ++
        for n <- worked.aux, do: "what AUX #{n} does"

    for what <- whats, do: {"#{what} is not known, because the vehicle's firmware is not", :unknown}
  end
end
