defmodule Aerie.Control.Policy.Rules.Mode do
  @moduledoc """
  Modes that may not be asked for, and from which mode which others may be. Only changes of mode by their name are judged
  (`set_mode`, SET_MODE, DO_SET_MODE, and a switch's function); that `goto` makes ArduPilot change to GUIDED is `goto`'s matter. A mode
  with several names (`HOLD` is PX4's AUTO_LOITER, `MODE(4)` ArduPilot's GUIDED) is the same mode under each of them. A mode without a name
  counts as denied if anything is.

  Channels and buttons that change the mode are judged by the mode that they change to (`Aerie.Control.Policy.Switches`); while that is not known they
  are refused.

  In a mission only `denied` counts: from which mode the vehicle will change then, is not known.
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.{Intent, Switches}
  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Vehicle.Firmware.Modes

  @typedoc "Names in capitals. A mode that is not in `transitions` may be left for any other."
  @type modes :: %{denied: [String.t()], transitions: %{String.t() => [String.t()]}}

  @doc "Whether a policy limits modes."
  @spec limits?(Aerie.Control.Policy.t()) :: boolean()
  def limits?(%{modes: modes}), do: modes.denied != [] or modes.transitions != %{}

  @impl Aerie.Control.Policy.Rules.Rule
  def check(policy, facts, context), do: if(limits?(policy), do: limited(policy, facts, context), else: :ok)

  defp limited(_policy, %{mode: nil, standard_mode: nil, switches: nil}, _context), do: :ok

  defp limited(policy, %{mode: nil, standard_mode: nil} = facts, context) do
    case Switches.modes(facts, context) do
      {:ok, names} -> wanted(policy.modes, Enum.map(names, &known_as(&1, context)), facts, context)
      {:unknown, why} -> Refusal.deny(:mode_switched, command: Intent.label(facts), unknown: why)
    end
  end

  defp limited(policy, %{mode: nil, standard_mode: name} = facts, context) do
    case context.standard_modes do
      %{^name => mode} -> wanted(policy.modes, [known_as(mode, context)], facts, context)
      _unknown -> Refusal.deny(:mode_standard, mode: name)
    end
  end

  defp limited(policy, facts, context) do
    names = Enum.flat_map([facts.mode | facts.modes], &[known_as(&1, context) | effects(&1, context)])
    wanted(policy.modes, Enum.uniq(names), facts, context)
  end

  defp wanted(modes, names, facts, context) do
    Enum.find_value(names, :ok, fn name ->
      cond do
        nameless?(name, context) ->
          Refusal.deny(:mode_unknown, mode: name)

        named?(modes.denied, name, context) ->
          Refusal.deny(:mode_denied, mode: name)

        facts.type == "mission_upload" ->
          nil

        true ->
          with :ok <- transition(modes.transitions, name, context), do: nil
      end
    end)
  end

  defp transition(transitions, _wanted, _context) when transitions == %{}, do: :ok

  defp transition(_transitions, wanted, %{mode: nil}), do: Refusal.deny(:mode_change_unknown, mode: wanted)

  defp transition(transitions, wanted, context) do
    mode = known_as(context.mode, context)

    # Several names may mean the mode (`LOITER` is PX4's AUTO_LOITER): what each of them allows.
    allowed = for {from, to} <- Enum.sort(transitions), known_as(from, context) == mode, do: to

    case Enum.reject(allowed, &(wanted == mode or named?(&1, wanted, context))) do
      [] -> :ok
      [to | _] -> Refusal.deny(:mode_change, from: mode, allowed: listed(to), mode: wanted)
    end
  end

  defp listed([]), do: "no other one"
  defp listed(names), do: Enum.join(names, ", ") <> " only"

  defp named?(names, wanted, context), do: Enum.any?(names, &(known_as(&1, context) == wanted))

  # The firmware's own name for it, or the one that the vehicle reported.
  defp known_as(name, %{autopilot: autopilot, vehicle_type: kind} = context) do
    with true <- known_firmware?(context),
         {:ok, number} <- Modes.number(autopilot, kind, name),
         # The flag says that the number counts.
         [own | _] <- Modes.asked(autopilot, kind, 1, number) do
      if Modes.unnamed?(own), do: String.upcase(context.mode_names[number] || own), else: own
    else
      _no_such_mode -> String.upcase(name)
    end
  end

  # The firmware's reading of the number: PX4 ignores some sub modes.
  defp effects(name, %{autopilot: autopilot, vehicle_type: kind} = context) do
    with true <- known_firmware?(context),
         {:ok, number} <- Modes.number(autopilot, kind, name),
         [_own | others] <- Modes.asked(autopilot, kind, 1, number) do
      others
    else
      _no_such_mode -> []
    end
  end

  defp nameless?("MODE(" <> _number, _context), do: true

  defp nameless?(name, %{autopilot: autopilot, vehicle_type: kind} = context) do
    known_firmware?(context) and Modes.number(autopilot, kind, name) == :error and
      not Enum.any?(context.mode_names, fn {_number, told} -> String.upcase(told) == name end)
  end

  defp known_firmware?(context),
    do: Modes.known?(context.autopilot) and is_binary(context.vehicle_type)
end
