defmodule Aerie.Link.Overload do
  @quiet_ms 10_000

  @moduledoc """
  Whether datagrams come faster than a link reads them, or frames faster than the sessions of its vehicles take them: a value each, nil
  while they do not.

  An overload begins with the first datagram or frame that is dropped and ends when none was dropped for #{div(@quiet_ms, 1000)} s.
  """

  @enforce_keys [:since, :datagrams, :last]
  defstruct [:since, :datagrams, :last]

  @typedoc "`since`: unix microseconds; `datagrams` (or frames): dropped so far; `last`: monotonic ms of the last drop"
  @type t :: %__MODULE__{since: integer, datagrams: pos_integer, last: integer}

  @doc "So many datagrams or frames were dropped; whether an overload begins with them."
  @spec dropped(t | nil, pos_integer, {mono :: integer, at :: integer}) :: {:begins | :lasts, t}
  def dropped(nil, n, {mono, at}), do: {:begins, %__MODULE__{since: at, datagrams: n, last: mono}}

  def dropped(%__MODULE__{} = overload, n, {mono, _at}),
    do: {:lasts, %{overload | datagrams: overload.datagrams + n, last: mono}}

  @doc "Whether it is over."
  @spec over?(t | nil, mono :: integer) :: boolean
  def over?(nil, _mono), do: false
  def over?(%__MODULE__{last: last}, mono), do: mono - last >= @quiet_ms
end
