defmodule MavRouter.Signing.Alarm do
  @moduledoc """
  Reports bursts of refused frames (`MavRouter.Signing.Burst`): telemetry, a counter, a line in the log, and an event
  `signing.rejected` of the vehicle that they claim to come from, if it is known.
  """

  alias Aerie.Base.{Names, Store}
  alias MavRouter.Signing.{Audit, Burst, Tables}

  require Logger

  @max_sources 1024
  # For each link, however many sources somebody invents.
  @every_ms 1_000

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
        [] -> if :ets.info(tables.bursts, :size) < @max_sources, do: Burst.new()
      end

    if burst do
      {burst, verdict} = Burst.add(burst, reason, n, System.monotonic_time(:millisecond))
      :ets.insert(tables.bursts, {key, burst})
      raise_alarm(verdict, gateway, source, {system, component}, at)
    end

    :ok
  end

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
