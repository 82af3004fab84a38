defmodule MavRouter.Link.Core.Overload do
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

  # So many datagrams or frames were dropped; whether an overload begins with them.
  defp dropped(nil, n, {mono, at}), do: {:begins, %__MODULE__{since: at, datagrams: n, last: mono}}

  defp dropped(%__MODULE__{} = overload, n, {mono, _at}),
    do: {:lasts, %{overload | datagrams: overload.datagrams + n, last: mono}}

  defp over?(nil, _mono), do: false
  defp over?(%__MODULE__{last: last}, mono), do: mono - last >= @quiet_ms

  # For `MavRouter.Link.Core`: its actions.

  @doc "Datagrams of a link were dropped before they were read."
  @spec datagrams(core, pos_integer, {integer, integer}) :: {core, [term]}
        when core: %{:overload => t() | nil, optional(atom) => term}
  def datagrams(core, n, now) do
    {change, overload} = dropped(core.overload, n, now)
    actions = if change == :begins, do: [{:emit, :overload, %{datagrams: n}, %{}}], else: []
    {%{core | overload: overload}, actions}
  end

  @doc "Frames of a link were dropped because a vehicle's session is behind."
  @spec frames(core, pos_integer, {integer, integer}) :: {core, [term]}
        when core: %{:behind => t() | nil, optional(atom) => term}
  def frames(core, n, now) do
    {change, behind} = dropped(core.behind, n, now)

    warn =
      "a vehicle's session does not keep up: #{n} frames dropped so far. Give the gateway more CPU, or lower the stream rates"

    {%{core | behind: behind}, if(change == :begins, do: [{:warn, warn}], else: [])}
  end

  @doc "Ends overloads that are over by now."
  @spec relieved(core, integer) :: {core, [term]}
        when core: %{:overload => t() | nil, :behind => t() | nil, optional(atom) => term}
  def relieved(core, mono) do
    core = if over?(core.behind, mono), do: %{core | behind: nil}, else: core

    if over?(core.overload, mono),
      do: {%{core | overload: nil}, [{:emit, :relieved, %{datagrams: core.overload.datagrams}, %{}}]},
      else: {core, []}
  end
end
