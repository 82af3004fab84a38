defmodule Aerie.Signing.Wake do
  @moduledoc """
  A vehicle that has the key and whose frames are refused as replayed or stale: its clock is behind what was heard of it
  before. ArduPilot's stands nearly still between what it hears, and after a reboot begins with what it had stored; ours may
  have been killed, and goes on with the latest that may have been heard. What sets its clock is a frame that is signed
  rightly with a later time stamp (S5). So whoever is refused like this gets a heartbeat and a TIMESYNC of ours, signed with
  the key, at once and then twice a second for as long as it lasts. Somebody who plays old frames gets them too, and nothing
  by them.
  """

  alias Aerie.LinkProcess
  alias Aerie.Names
  alias Aerie.Signing.{Scope, Tables}

  @again_ms 500
  @max 1024

  @doc "Frames of a system were refused that a peer of a link brought, with a signature that is right by the scope's key."
  @spec refused(Names.gateway(), Tables.t(), map, Scope.t(), system :: non_neg_integer) :: :ok
  def refused(gateway, tables, %{id: link} = source, scope, system) do
    key = {link, source[:peer], scope.id}
    now = System.monotonic_time(:millisecond)

    if due?(tables, key, now) do
      :ets.insert(tables.woken, {key, now})
      LinkProcess.announce(gateway, link, source[:peer], scope, system)
    end

    :ok
  end

  # Whoever comes when there are too many waits until those before are forgotten.
  defp due?(tables, key, now) do
    case :ets.lookup(tables.woken, key) do
      [{_key, at}] -> now - at >= @again_ms
      [] -> room?(tables, now)
    end
  end

  defp room?(tables, now) do
    old = [{{:_, :"$1"}, [{:<, :"$1", now - @again_ms}], [true]}]
    :ets.info(tables.woken, :size) < @max or :ets.select_delete(tables.woken, old) > 0
  end
end
