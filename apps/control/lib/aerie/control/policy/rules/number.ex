defmodule Aerie.Control.Policy.Rules.Number do
  @moduledoc """
  A number that firmwares read in different ways is refused: an enumeration, a flag or an index that is not an integer, or out of
  its range (`MavCodec.Meaning.Commands`). PX4 takes 0.6 for 1, and ArduPilot 257 as well.
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.Intent
  alias Aerie.Vehicle.Command.Refusal

  @impl Aerie.Control.Policy.Rules.Rule
  def check(_policy, %{number: nil}, _context), do: :ok

  def check(_policy, facts, _context),
    do: Refusal.deny(:number, command: Intent.label(facts), wrong: facts.number)
end
