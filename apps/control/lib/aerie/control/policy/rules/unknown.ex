defmodule Aerie.Control.Policy.Rules.Unknown do
  @moduledoc """
  What no table of the gateway knows is refused: a command of MAV_CMD without a row (`MavCodec.Meaning.Commands`), a
  message without one. `policy.open` opens single ones to sources with `maintain`, `policy.unknown: maintain` all of
  them.
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Vehicle.Command.Refusal

  @impl Aerie.Control.Policy.Rules.Rule
  def check(_policy, %{unknown: nil}, _context), do: :ok
  def check(%{unknown: :maintain}, _facts, _context), do: :ok

  def check(policy, %{unknown: what}, _context), do: if(what in policy.open, do: :ok, else: unlisted(what))

  defp unlisted({:command, id}), do: Refusal.deny(:command_unlisted, id: id)
  defp unlisted({:message, id}), do: Refusal.deny(:message_unlisted, id: id)
end
