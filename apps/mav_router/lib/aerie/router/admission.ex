defmodule Aerie.Router.Admission do
  @moduledoc """
  Lets a vehicle in when its autopilot is heard: starts its processes, at most as many vehicles as
  those who have them allow (`Aerie.Router.Vehicles`). A vehicle that was refused is not tried again for 5 s, so that a flood of invented
  system ids does not keep the supervisor busy.

  A vehicle is made at once, by the process that has its frames, as long as few come: #{20} a second, #{32} at once, and while
  no more than #{64} messages wait for that process, since other vehicles' frames are among them. Further ones are made by
  `Aerie.Router.Nursery`, which gets the frames as well; at most #{1_024} wait there.
  """

  alias Aerie.Allowance
  alias Aerie.Names
  alias Aerie.Router.Nursery
  alias Aerie.Router.Tables
  alias Aerie.Router.AutoSystemId

  @again_ms 5_000
  @max_refused 4_096
  # Made at once: one in so many ms, so many at once.
  @at_once_ms 50
  @at_once 32
  @busy 64
  @max_waiting 1_024
  # Whoever was asked for and is not there after so long is asked for again.
  @waits_ms 15_000

  @doc """
  The vehicle's session, started if need be. `:coming`: it is being made, and gets what `first` gives, as come by `from`.
  `:not_yet`: the gateway does not know who it is, or the vehicle is coming and got frames already.
  """
  @spec session(Names.gateway(), Tables.t(), {String.t(), non_neg_integer}, from, (-> [struct]), integer) ::
          {:ok, pid} | :refused | :coming | :not_yet
        when from: term
  def session(gateway, tables, key, from, first, now) do
    if AutoSystemId.open?(gateway, tables, key, now),
      do: admit(gateway, tables, key, from, first, now),
      else: :not_yet
  end

  defp admit(_gateway, %{vehicles: nil}, _key, _from, _first, _now), do: :not_yet

  defp admit(gateway, tables, key, from, first, now) do
    case :ets.lookup(tables.refused, key) do
      [{_key, until}] when now < until ->
        :refused

      _free ->
        if not busy?() and at_once?(tables, now),
          do: make(gateway, tables, key, now),
          else: ask(gateway, tables, key, from, first, now)
    end
  end

  # Making one takes as long as reading a hundred datagrams.
  defp busy? do
    {:message_queue_len, waiting} = Process.info(self(), :message_queue_len)
    waiting > @busy
  end

  # Two links that ask at the same moment may both be let in.
  defp at_once?(tables, now) do
    case Allowance.take(Tables.setting(tables, :admission, nil), now, @at_once_ms, @at_once) do
      {:ok, full} -> :ets.insert(tables.settings, {:admission, full})
      :none -> false
    end
  end

  # Frames are kept for a vehicle that comes once: what they hold on to is bounded by the number of those that wait.
  defp ask(gateway, tables, key, from, first, now) do
    waits = :ets.lookup_element(tables.waiting, key, 2, now)

    if waits <= now and :ets.info(tables.waiting, :size) < @max_waiting do
      :ets.insert(tables.waiting, {key, now + @waits_ms})
      Nursery.ask(gateway, key, from, first.())
      :coming
    else
      :not_yet
    end
  end

  @doc "Makes the vehicle now."
  @spec make(Names.gateway(), Tables.t(), {String.t(), non_neg_integer}, integer) :: {:ok, pid} | :refused
  def make(gateway, tables, key, now) do
    :ets.delete(tables.waiting, key)

    case tables.vehicles.ensure(gateway, key) do
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
