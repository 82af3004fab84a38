defmodule MavRouter.Link.Core.Stall do
  @moduledoc """
  What is done about the peer of a link that takes nothing. For a second its frames wait in its queue and are tried often; after
  that senders drop its frames themselves (`MavRouter.Endpoints.Endpoint.limit/2`), so it costs the link's process
  nothing, and a quarter of a second passes between two attempts. Only data that the peer requested still waits for it,
  within its own bounds. After ten seconds its connection is ended. Pure but for that limit.

  The value is when the peer took something last, nil while it takes everything.
  """

  alias MavRouter.Endpoints.Endpoint

  @retry_ms 10
  @stalled_ms 1_000
  @stalled_retry_ms 250
  @stuck_ms 10_000

  @type t :: integer | nil

  @doc "The peer took nothing; how long to wait for the next attempt."
  @spec busy(t, Endpoint.t(), integer) :: {t, pos_integer}
  def busy(nil, _endpoint, now), do: {now, @retry_ms}
  def busy(since, _endpoint, now) when now - since < @stalled_ms, do: {since, @retry_ms}

  def busy(since, endpoint, _now) do
    :ok = Endpoint.limit(endpoint, 0)
    {since, @stalled_retry_ms}
  end

  @doc "The peer took something: it gets its room in the mailbox back."
  @spec took(t, Endpoint.t(), room :: pos_integer) :: t
  def took(nil, _endpoint, _room), do: nil

  def took(_since, endpoint, room) do
    :ok = Endpoint.limit(endpoint, room)
    nil
  end

  @doc "Whether the connection of such a peer is to be ended."
  @spec stuck?(t, integer) :: boolean
  def stuck?(since, now), do: since != nil and now - since >= @stuck_ms

  @doc "How long that takes, for people."
  @spec stuck_s() :: pos_integer
  def stuck_s, do: div(@stuck_ms, 1000)
end
