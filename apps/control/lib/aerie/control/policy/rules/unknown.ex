defmodule Aerie.Control.Policy.Rules.Unknown do
  @moduledoc """
  What no table of the gateway knows is refused: a command of MAV_CMD without a row (`MavCodec.Meaning.Commands`), a
  message without one. `policy.open` opens single ones to sources with `maintain`, `policy.unknown: maintain` all of
  them.
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  @impl Aerie.Control.Policy.Rules.Rule
  def check(_policy, %{unknown: nil}, _context), do: :ok
  def check(%{unknown: :maintain}, _facts, _context), do: :ok

  def check(policy, %{unknown: what}, _context) do
    if what in policy.open, do: :ok, else: {:deny, text(what) <> ", and policy.open does not open it"}
  end

  defp text({:command, id}), do: "the gateway does not know the command #{id} (MAV_CMD)"
  defp text({:message, id}), do: "the gateway does not know the message #{id}"
end
