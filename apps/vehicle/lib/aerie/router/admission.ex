defmodule Aerie.Router.Admission do
  @moduledoc """
  Lets a vehicle in when its autopilot is heard: starts its processes, at most as many vehicles as
  `Aerie.Vehicle.Supervisor` allows. A vehicle that was refused is not tried again for 5 s, so that a flood of invented
  system ids does not keep the supervisor busy.
  """

  alias Aerie.Names
  alias Aerie.Router.Tables
  alias Aerie.Vehicle.Identity.Latch

  @again_ms 5_000
  @max_refused 4_096

  @doc "The vehicle's session, started if need be. `:not_yet`: the gateway does not know who it is."
  @spec session(Names.gateway(), Tables.t(), {String.t(), non_neg_integer}, integer) ::
          {:ok, pid} | :refused | :not_yet
  def session(gateway, tables, key, now) do
    if Latch.open?(gateway, tables, key, now), do: admit(gateway, tables, key, now), else: :not_yet
  end

  defp admit(gateway, tables, key, now) do
    case :ets.lookup(tables.refused, key) do
      [{_key, until}] when now < until -> :refused
      _free -> ensure(gateway, tables, key, now)
    end
  end

  defp ensure(gateway, tables, key, now) do
    case Aerie.Vehicle.Supervisor.ensure(gateway, key, []) do
      {:ok, session} ->
        {network, system} = key

        :telemetry.execute([:aerie, :router, :vehicle_found], %{}, %{
          gateway: gateway,
          network: network,
          system: system
        })

        {:ok, session}

      {:error, reason} ->
        refuse(gateway, tables, key, reason, now)
    end
  end

  defp refuse(gateway, tables, {network, system} = key, reason, now) do
    if :ets.info(tables.refused, :size) < @max_refused,
      do: :ets.insert(tables.refused, {key, now + wait(reason)})

    metadata = %{gateway: gateway, network: network, system: system, reason: reason}
    :telemetry.execute([:aerie, :router, :vehicle_refused], %{}, metadata)
    :refused
  end

  # Vehicles that are just being restarted will be there with the next heartbeat.
  defp wait(:too_many), do: @again_ms
  defp wait(_passing), do: 0
end
