defmodule Aerie.Policy.Rules.Mode do
  @moduledoc """
  Modes that may not be asked for, and from which mode which others may be. Only changes of mode by their name are judged
  (`set_mode`, SET_MODE, DO_SET_MODE); that `goto` makes ArduPilot change to GUIDED is `goto`'s matter. A mode with several
  names (`HOLD` is PX4's AUTO_LOITER, `MODE(4)` ArduPilot's GUIDED) is the same mode under each of them.
  """

  @behaviour Aerie.Policy.Rule

  alias Aerie.Protocol.Modes

  @typedoc "Names in capitals. A mode that is not in `transitions` may be left for any other."
  @type modes :: %{denied: [String.t()], transitions: %{String.t() => [String.t()]}}

  @impl Aerie.Policy.Rule
  def check(_policy, %{mode: nil, standard_mode: nil}, _context), do: :ok
  def check(%{modes: %{denied: [], transitions: none}}, _facts, _context) when none == %{}, do: :ok

  def check(policy, %{mode: nil, standard_mode: name}, context) do
    case context.standard_modes do
      %{^name => mode} -> wanted(policy.modes, mode, context)
      _unknown -> {:deny, "which of its modes the standard mode #{name} is for this vehicle is not known"}
    end
  end

  def check(policy, facts, context), do: wanted(policy.modes, facts.mode, context)

  defp wanted(modes, wanted, context) do
    wanted = known_as(wanted, context)

    if named?(modes.denied, wanted, context),
      do: {:deny, "the mode #{wanted} may not be asked for (modes.denied)"},
      else: transition(modes.transitions, wanted, context)
  end

  defp transition(transitions, _wanted, _context) when transitions == %{}, do: :ok

  defp transition(_transitions, wanted, %{mode: nil}),
    do: {:deny, "whether the mode may change to #{wanted} depends on the vehicle's mode, which is not known"}

  defp transition(transitions, wanted, context) do
    mode = known_as(context.mode, context)

    # Several names may mean the mode (`LOITER` is PX4's AUTO_LOITER): what each of them allows.
    allowed = for {from, to} <- Enum.sort(transitions), known_as(from, context) == mode, do: to

    case Enum.reject(allowed, &(wanted == mode or named?(&1, wanted, context))) do
      [] -> :ok
      [to | _] -> {:deny, "from #{mode} the mode may change to #{listed(to)}, not to #{wanted}"}
    end
  end

  defp listed([]), do: "no other one"
  defp listed(names), do: Enum.join(names, ", ") <> " only"

  defp named?(names, wanted, context), do: Enum.any?(names, &(known_as(&1, context) == wanted))

  # The firmware's own name for it.
  defp known_as(name, %{autopilot: autopilot, vehicle_type: kind}) do
    with true <- autopilot != nil and is_binary(kind),
         {:ok, number} <- Modes.number(autopilot, kind, name) do
      # The flag says that the number counts.
      Modes.name(autopilot, kind, 1, number)
    else
      _no_such_mode -> String.upcase(name)
    end
  end
end
