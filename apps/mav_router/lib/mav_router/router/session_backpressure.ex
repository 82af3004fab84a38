defmodule MavRouter.Router.SessionBackpressure do
  @max_waiting 2_000
  @every_ms 250

  @moduledoc """
  Whether a vehicle's session keeps up. A session that does not take its messages (stuck, or flooded beyond the machine's
  power) must not fill the memory: while more than #{@max_waiting} reads wait for it, further ones are dropped and counted. Looked
  at every #{@every_ms} ms for each vehicle, not for each read.
  """

  alias MavRouter.Tables

  @doc "Whether frames for a vehicle's session have to be dropped at `now` (monotonic ms)."
  @spec over?(Tables.t(), term, pid, integer) :: boolean
  def over?(tables, key, session, now) do
    case :ets.lookup(tables.load, key) do
      [{_key, checked, over?}] when now - checked < @every_ms -> over?
      _old_or_none -> check(tables, key, session, now)
    end
  end

  defp check(tables, key, session, now) do
    over? = waiting(session) > @max_waiting
    :ets.insert(tables.load, {key, now, over?})
    over?
  end

  @doc "How many messages wait for a process; 0 for one that is gone."
  @spec waiting(pid) :: non_neg_integer
  def waiting(pid) do
    case Process.info(pid, :message_queue_len) do
      {:message_queue_len, n} -> n
      nil -> 0
    end
  end
end
