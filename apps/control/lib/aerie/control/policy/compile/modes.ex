defmodule Aerie.Control.Policy.Compile.Modes do
  @moduledoc """
  The section `policy.modes`, checked: each name is a mode of a firmware, or a number as `MODE(27)`. A misspelt one would deny
  nothing.
  """

  alias Aerie.Control.Policy.Compile
  alias Aerie.Control.Policy.Rules
  alias Aerie.Vehicle.Firmware.Modes
  alias Aerie.Base.Settings.Schema

  @path "policy.modes"
  @expected "a flight mode of ArduPilot or PX4, or MODE(27) for one by its number"

  @doc "The modes in capitals, and what is wrong."
  @spec compile(map()) :: {Rules.Mode.modes(), [Compile.error()]}
  def compile(%{denied: denied, transitions: transitions}) do
    listed =
      for {from, to} <- Enum.sort(transitions), do: {String.upcase(from), Enum.map(to, &String.upcase/1)}

    denied = Enum.map(denied, &String.upcase/1)

    errors =
      unknown("#{@path}.denied", denied) ++
        unknown("#{@path}.transitions", Enum.map(listed, &elem(&1, 0))) ++
        Enum.flat_map(listed, fn {from, to} -> unknown("#{@path}.transitions.#{from}", to) end) ++
        twice(listed) ++ denied(listed, denied)

    {%{denied: denied, transitions: Map.new(listed)}, errors}
  end

  defp unknown(path, names) do
    for name <- names, Modes.meanings(name) == [] do
      hint = with hint when hint != nil <- Schema.did_you_mean(name, Modes.names()), do: " (#{hint})"
      {path, @expected, ~s("#{name}"#{hint})}
    end
  end

  # Names differ by more than their case.
  defp twice(listed) do
    names = Enum.map(listed, &elem(&1, 0))

    for name <- Enum.uniq(names -- Enum.uniq(names)),
        do: {"#{@path}.transitions", "each mode once", "#{name} twice"}
  end

  # By any of its names: every mode that the name may mean is denied.
  defp denied(listed, denied) do
    meanings = Enum.flat_map(denied, &Modes.meanings/1)

    for {from, to} <- listed,
        mode <- to,
        Modes.meanings(mode) != [] and Modes.meanings(mode) -- meanings == [] do
      {"#{@path}.transitions.#{from}", "modes that may be asked for", "#{mode}, which modes.denied denies"}
    end
  end
end
