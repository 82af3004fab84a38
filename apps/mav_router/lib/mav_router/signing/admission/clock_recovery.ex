defmodule MavRouter.Signing.Admission.ClockRecovery do
  @moduledoc """
  Moves the clock of a vehicle that has the key but whose frames are refused as replayed or stale: its time stamps are behind those
  that were heard of it before. ArduPilot's clock nearly stands still while it hears nothing, and after a reboot starts from what it
  had stored; the gateway may have been killed, and then goes on from the latest time stamp that it may have heard. A rightly signed
  frame with a later time stamp sets the vehicle's clock (S5). So such a vehicle gets a heartbeat and a TIMESYNC of ours, signed with
  the key, at once and then twice a second (on a link of high latency once a minute) for as long as it is
  refused. Somebody who replays old frames gets them too, which is of
  no use to them.
  """

  alias MavRouter.LinkProcess
  alias Aerie.Base.Names
  alias MavRouter.Signing.{Scope, Tables}

  @again_ms 500
  @again_high_latency_ms 60_000
  @max 1024

  @doc "Frames of a system were refused although their signature is right by the scope's key."
  @spec refused(Names.gateway(), Tables.t(), map, Scope.t(), system :: non_neg_integer) :: :ok
  def refused(gateway, tables, %{id: link} = source, scope, system) do
    key = {link, source[:peer], scope.id}
    now = System.monotonic_time(:millisecond)

    if due?(tables, key, now, if(source[:high_latency], do: @again_high_latency_ms, else: @again_ms)) do
      :ets.insert(tables.announced, {key, now})
      LinkProcess.announce(gateway, link, source[:peer], scope, system)
    end

    :ok
  end

  # When there are too many, a further one waits until earlier ones are forgotten.
  defp due?(tables, key, now, again_ms) do
    case :ets.lookup(tables.announced, key) do
      [{_key, at}] -> now - at >= again_ms
      [] -> room?(tables, now)
    end
  end

  defp room?(tables, now) do
    old = [{{:_, :"$1"}, [{:<, :"$1", now - @again_ms}], [true]}]
    :ets.info(tables.announced, :size) < @max or :ets.select_delete(tables.announced, old) > 0
  end
end
