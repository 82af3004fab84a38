defmodule MavRouter.Signing.Alarm do
  @many 20
  @window_ms 10_000
  @quiet_ms 60_000

  @moduledoc """
  Reports bursts of refused frames: telemetry, a counter, a line in the log, and an event `signing.rejected` of the
  vehicle that they claim to come from, if it is known. It also reports clocks of senders that are far ahead: a line in
  the log, and the event `signing.clock`.

  #{@many} refused frames of one source within #{div(@window_ms, 1_000)} s are a burst. It is reported every
  #{div(@quiet_ms, 1_000)} s while it lasts. Fewer are only counted: PX4 1.18 forwards the frames of other ground
  stations with garbage for a signature, each of them once a second.
  """

  alias Aerie.Base.{Names, Store}
  alias MavRouter.Signing.Audit
  alias MavRouter.Signing.Tables

  require Logger

  @max_sources 1024
  # For each link, however many sources somebody invents.
  @every_ms 1_000
  @clock_ms 60_000

  @doc "`n` frames of a source were refused."
  @spec rejected(
          Names.gateway(),
          Tables.t(),
          map,
          {non_neg_integer, 0..255},
          atom,
          pos_integer,
          integer | nil
        ) :: :ok
  def rejected(gateway, tables, %{id: link} = source, {system, component}, reason, n, at) do
    key = {link, system, component}

    burst =
      case :ets.lookup(tables.bursts, key) do
        [{_key, burst}] -> burst
        [] -> if :ets.info(tables.bursts, :size) < @max_sources, do: new()
      end

    if burst do
      {burst, verdict} = add(burst, reason, n, System.monotonic_time(:millisecond))
      :ets.insert(tables.bursts, {key, burst})
      raise_alarm(verdict, gateway, source, {system, component}, at)
    end

    :ok
  end

  @typedoc "The refused frames of one {link, system, component}; times in monotonic ms."
  @type burst :: %{
          since: integer | nil,
          count: non_neg_integer,
          reported: integer | nil,
          reasons: %{atom => pos_integer}
        }

  @doc "No refused frame yet."
  @spec new() :: burst
  def new, do: %{since: nil, count: 0, reported: nil, reasons: %{}}

  @doc """
  `n` frames were refused for a reason (monotonic ms): `{:alarm, %{reason => count}}` of this window when an alarm is
  due.
  """
  @spec add(burst, atom, pos_integer, integer) :: {burst, :quiet | {:alarm, %{atom => pos_integer}}}
  def add(burst, reason, n, now) do
    burst =
      if burst.since == nil or now - burst.since >= @window_ms,
        do: %{burst | since: now, count: 0, reasons: %{}},
        else: burst

    burst = %{burst | count: burst.count + n, reasons: Map.update(burst.reasons, reason, n, &(&1 + n))}

    if burst.count >= @many and (burst.reported == nil or now - burst.reported >= @quiet_ms),
      do: {%{burst | reported: now}, {:alarm, burst.reasons}},
      else: {burst, :quiet}
  end

  @doc """
  A sender that has the key signs with a time that is so many microseconds ahead of this machine's. Reported once a
  minute while it lasts.
  """
  @spec ahead(Names.gateway(), map, {non_neg_integer, 0..255, pos_integer}, integer | nil) :: :ok
  def ahead(gateway, %{id: link} = source, {system, component, _by_us} = leads, at) do
    if Store.claim(gateway, {:signing_clock, link, system, component}, @clock_ms),
      do: tell_ahead(gateway, source, leads, at),
      else: :ok
  end

  defp tell_ahead(gateway, %{id: link, network: network}, {system, component, by_us}, at) do
    hours = by_us / 3_600_000_000
    ahead = span(hours)

    Logger.warning(
      "link #{link}: the signing clock of #{system}/#{component} is #{ahead} ahead of this machine's. Set the clock " <>
        "that is wrong: until then one of them may refuse what the other signs"
    )

    data = %{"link" => link, "component" => component, "ahead_s" => div(by_us, 1_000_000), "ahead" => ahead}
    Audit.event(gateway, {network, system}, "signing.clock", data, at || System.os_time(:microsecond))
  end

  defp span(hours) when hours < 48, do: "#{Float.round(hours, 1)} hours"
  defp span(hours) when hours < 48 * 365, do: "#{round(hours / 24)} days"
  defp span(hours), do: "#{Float.round(hours / 24 / 365.25, 1)} years"

  defp raise_alarm(:quiet, _gateway, _source, _who, _at), do: :ok

  defp raise_alarm({:alarm, reasons}, gateway, source, {system, component}, at) do
    if Store.claim(gateway, {:signing_alarm, source.id}, @every_ms) do
      Store.count(gateway, {:signing, source.id, :alarms})
      {reason, _most} = Enum.max_by(reasons, &elem(&1, 1))

      metadata = %{
        gateway: gateway,
        link: source.id,
        network: source.network,
        system: system,
        component: component,
        reason: reason
      }

      :telemetry.execute(
        [:aerie, :signing, :alarm],
        %{rejected: reasons |> Map.values() |> Enum.sum()},
        metadata
      )

      Logger.warning(
        "link #{source.id}: frames that claim to come from #{system}/#{component} are refused: " <>
          Enum.map_join(reasons, ", ", fn {reason, n} -> "#{n} #{reason}" end)
      )

      event(gateway, source, {system, component}, reasons, at)
    end

    :ok
  end

  # A vehicle that is not known has no events.
  defp event(gateway, %{id: link, network: network}, {system, component}, reasons, at) do
    data = %{
      "link" => link,
      "component" => component,
      "reasons" => Map.new(reasons, fn {reason, n} -> {Atom.to_string(reason), n} end)
    }

    at = at || System.os_time(:microsecond)
    Audit.event(gateway, {network, system}, "signing.rejected", data, at)
  end
end
