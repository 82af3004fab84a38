defmodule Aerie.Router.Load do
  @moduledoc """
  Whether a vehicle's session keeps up. A session that does not take its messages (stuck, or flooded beyond the machine's
  power) must not fill the memory: when more than #{2_000} reads wait for it, further ones are dropped and counted until it
  has caught up. Looked at four times a second for each vehicle, not for each read.
  """

  alias Aerie.Router.Tables

  @max_waiting 2_000
  @every_ms 250

  @doc "Whether frames for the session have to be dropped now (monotonic ms)."
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
