defmodule MavRouter.Signing.Audit do
  @moduledoc """
  Records who gave a key to a vehicle or took it away, by which link, and whether it worked: an event of the vehicle
  (`signing.enrolled`, `signing.revoked`, `signing.failed`), telemetry, and a line in the log. They contain nothing of a key (S9).
  """

  alias Aerie.Base.Names
  alias MavRouter.Signing.Tables

  require Logger

  @doc "Records a result, and gives it back."
  @spec record(result, map, :enrolled | :revoked) :: result
        when result: {:ok, map} | {:error, Aerie.Base.Error.t()}
  def record(result, %{key: {network, system}} = job, what) do
    metadata = %{gateway: job.gateway, network: network, system: system, link: job.link, by: job.by}

    case result do
      {:ok, _map} ->
        :telemetry.execute([:aerie, :signing, what], %{count: 1}, metadata)
        Logger.notice("signing of #{network}/#{system}: #{what} by link #{job.link}, requested by #{job.by}")
        event(job, "signing.#{what}", %{})

      {:error, error} ->
        reason = Exception.message(error)
        metadata = Map.merge(metadata, %{what: what, reason: reason})
        :telemetry.execute([:aerie, :signing, :failed], %{count: 1}, metadata)
        Logger.warning("signing of #{network}/#{system}: not #{what} by link #{job.link}: #{reason}")
        event(job, "signing.failed", %{"what" => Atom.to_string(what), "reason" => reason})
    end

    result
  end

  defp event(job, type, data) do
    data = Map.merge(data, %{"link" => job.link, "component" => job.component, "by" => job.by})
    event(job.gateway, job.key, type, data, System.os_time(:microsecond))
  end

  @doc "An event of a vehicle, if somebody keeps events (`MavRouter.Signing.Events`)."
  @spec event(Names.gateway(), {String.t(), non_neg_integer}, String.t(), map, integer) :: :ok
  def event(gateway, key, type, data, at) do
    case Tables.of(gateway) do
      %{events: events} when events != nil -> events.event(gateway, key, type, data, at)
      _nobody -> :ok
    end
  end
end
