defmodule Aerie.Vehicle.Session.Capacity do
  @moduledoc """
  Which vehicle makes room for a new one when there are `limits.max_vehicles`: the one that has been lost for the
  longest time. Three exceptions protect real vehicles from ids that a bad radio or an attacker made up:

    * A vehicle with a name in the configuration keeps its place.
    * A vehicle that was armed when it was lost goes last: its last position helps those who search for it.
    * A vehicle that was never here before has to wait until the other one has been lost for `limits.displace_lost_s`. A
      vehicle with a name, or one that was itself displaced, need not wait.

  Only the events and the event numbering of a displaced vehicle are kept. Its public name follows from network and
  system id, so it is the same when the vehicle comes back.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle
  alias Aerie.Vehicle.Events.{Detector, Journal}
  alias Aerie.Vehicle.Events.Detector.Observation

  require Logger

  @typedoc """
  `since`: when it was lost (ms, any clock); `armed`: whether it was armed when last heard; `named`: has a name in the
  configuration.
  """
  @type lost :: %{key: Store.vehicle_key(), since: integer(), armed: boolean(), named: boolean()}

  @doc "The vehicle that makes room `now`, out of those that have been lost for at least `wait_ms`; or nil."
  @spec pick([lost()], wait_ms :: number(), now :: integer()) :: Store.vehicle_key() | nil
  def pick(lost, wait_ms, now) do
    lost
    |> Enum.filter(&(not &1.named and now - &1.since >= wait_ms))
    |> Enum.min_by(&{&1.armed, &1.since, &1.key}, fn -> %{key: nil} end)
    |> Map.fetch!(:key)
  end

  @doc "Notes that a vehicle is lost from now on, or that it is not lost."
  @spec note(Names.gateway(), Store.vehicle_key(), status :: atom()) :: :ok
  def note(gateway, key, :lost), do: Store.remember(gateway, {:lost, key}, now())
  def note(gateway, key, _heard), do: Store.forget(gateway, {:lost, key})

  @doc "The vehicle that makes room for a newcomer now, and for how long it has been lost (ms); nil if none does."
  @spec displaced_by(Names.gateway(), Store.vehicle_key()) ::
          {Store.vehicle_key(), non_neg_integer()} | nil
  def displaced_by(gateway, newcomer) do
    settings = Vehicle.Settings.of(gateway)
    now = now()

    with {_network, _system} = key <- pick(lost(gateway, settings), wait_ms(gateway, settings, newcomer), now) do
      {key, now - Store.recall(gateway, {:lost, key})}
    end
  end

  defp lost(gateway, settings) do
    for {{:lost, key}, since} <- Store.remembered(gateway), Names.whereis(gateway, :tree, key) != nil do
      %{key: key, since: since, armed: armed?(gateway, key), named: Vehicle.Options.named?(settings, key)}
    end
  end

  defp armed?(gateway, key) do
    match?(%{groups: %{mode: %{data: %{armed: true}}}}, Store.vehicle(gateway, key))
  end

  defp wait_ms(gateway, settings, newcomer) do
    known? =
      Vehicle.Options.named?(settings, newcomer) or
        Journal.state(gateway, Vehicle.Options.id(settings, newcomer)) != nil

    if known?, do: 0, else: settings.displace_lost_ms
  end

  @doc "Reports that a vehicle, whose tree is stopped, was displaced: event `displaced`, a counter, a line in the log."
  @spec report(Names.gateway(), Store.vehicle_key(), by :: Store.vehicle_key(), non_neg_integer()) ::
          :ok
  def report(gateway, {network, system} = key, by, lost_ms) do
    settings = Vehicle.Settings.of(gateway)
    options = Vehicle.Options.new(settings, key)
    detector = Journal.state(gateway, options.id) || Detector.new(options)
    data = %{"by" => Vehicle.Options.id(settings, by), "lost_s" => Float.round(lost_ms / 1000, 1)}
    external = %{type: "displaced", data: data}
    observation = Observation.new(:external, System.os_time(:microsecond), nil, external)
    {detector, [event], _params} = Detector.observe(detector, observation)
    Journal.commit(gateway, options.id, detector, [event])
    Vehicle.Events.committed(gateway, options.id, event)
    Store.count(gateway, {:vehicles, :displaced})

    :telemetry.execute([:aerie, :vehicle, :displaced], %{lost_ms: lost_ms}, %{
      gateway: gateway,
      vehicle: options.id,
      network: network,
      system: system,
      by: data["by"]
    })

    Logger.warning(
      "#{options.id} has been lost for #{data["lost_s"]} s and makes room for #{data["by"]}: " <>
        "limits.max_vehicles is reached"
    )
  end

  defp now, do: System.monotonic_time(:millisecond)
end
