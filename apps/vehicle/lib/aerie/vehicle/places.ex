defmodule Aerie.Vehicle.Places do
  @moduledoc """
  Whose place a vehicle takes when as many are there as `limits.max_vehicles` allows.

  Somebody's who is lost, and of those the one that is lost for the longest time; with three exceptions, because a place is
  worth more to one that was ever heard than to one that a bad radio, or somebody, made up:

    * A vehicle with a name in the configuration keeps its place.
    * A vehicle that was armed when it was lost goes last: where it was then is what those who search for it need.
    * A vehicle that was never here waits until the other is lost for `limits.displace_lost_s`. One that has a name, or that
      was here before and lost its place itself, need not wait.

  What is known of the displaced one is forgotten but for its events and the numbers of the next ones; its public name
  follows from its network and system id, so it is the same when it comes back.
  """

  alias Aerie.{Fleet, Names, RunningConfig, Store, Vehicle}

  require Logger

  @default_wait_s 60.0

  @typedoc "`since`: when it was lost, in ms of any clock; `armed`: when last heard; `named`: in the configuration."
  @type lost :: %{key: Store.vehicle_key(), since: integer(), armed: boolean(), named: boolean()}

  @doc "The one whose place is taken `now` by one that has been waiting for `wait_ms` of their being lost, or nil."
  @spec pick([lost()], wait_ms :: number(), now :: integer()) :: Store.vehicle_key() | nil
  def pick(lost, wait_ms, now) do
    lost
    |> Enum.filter(&(not &1.named and now - &1.since >= wait_ms))
    |> Enum.min_by(&{&1.armed, &1.since, &1.key}, fn -> %{key: nil} end)
    |> Map.fetch!(:key)
  end

  @doc "Notes that a vehicle is lost, as of now, or that it is not."
  @spec note(Names.gateway(), Store.vehicle_key(), status :: atom()) :: :ok
  def note(gateway, key, :lost), do: Store.remember(gateway, {:lost, key}, now())
  def note(gateway, key, _heard), do: Store.forget(gateway, {:lost, key})

  @doc "Whose place a vehicle may take now, with how long that one has been lost (ms); nil for nobody's."
  @spec taken_by(Names.gateway(), Store.vehicle_key()) ::
          {Store.vehicle_key(), non_neg_integer()} | nil
  def taken_by(gateway, newcomer) do
    config = RunningConfig.of(gateway)
    now = now()

    with {_network, _system} = key <- pick(lost(gateway, config), wait_ms(gateway, config, newcomer), now) do
      {key, now - Store.recall(gateway, {:lost, key})}
    end
  end

  defp lost(gateway, config) do
    for {{:lost, key}, since} <- Store.remembered(gateway), Names.whereis(gateway, :tree, key) != nil do
      %{key: key, since: since, armed: armed?(gateway, key), named: Vehicle.Options.named?(config, key)}
    end
  end

  defp armed?(gateway, key) do
    match?(%{groups: %{mode: %{data: %{armed: true}}}}, Store.vehicle(gateway, key))
  end

  defp wait_ms(gateway, config, newcomer) do
    known? =
      Vehicle.Options.named?(config, newcomer) or
        Fleet.Journal.state(gateway, Vehicle.Options.id(config, newcomer)) != nil

    if known?, do: 0, else: 1000 * Vehicle.Options.displace_lost_s(config, @default_wait_s)
  end

  @doc "Tells that a vehicle, whose tree is gone, lost its place: an event of its own, a counter, a line in the log."
  @spec tell(Names.gateway(), Store.vehicle_key(), by :: Store.vehicle_key(), non_neg_integer()) ::
          :ok
  def tell(gateway, {network, system} = key, by, lost_ms) do
    config = RunningConfig.of(gateway)
    options = Vehicle.Options.new(config, key)
    detector = Fleet.Journal.state(gateway, options.id) || Vehicle.Detector.new(options)
    data = %{"by" => Vehicle.Options.id(config, by), "lost_s" => Float.round(lost_ms / 1000, 1)}
    observation = {:alarm, System.os_time(:microsecond), nil, "displaced", data}
    {detector, [event], _params} = Vehicle.Detector.observe(detector, observation)
    Fleet.Journal.commit(gateway, options.id, detector, [event])
    Vehicle.Events.told(gateway, options.id, event)
    Store.count(gateway, {:vehicles, :displaced})

    :telemetry.execute([:aerie, :vehicle, :displaced], %{lost_ms: lost_ms}, %{
      gateway: gateway,
      vehicle: options.id,
      network: network,
      system: system,
      by: data["by"]
    })

    Logger.warning(
      "#{options.id}, lost for #{data["lost_s"]} s, makes room for #{data["by"]}: " <>
        "limits.max_vehicles are there"
    )
  end

  defp now, do: System.monotonic_time(:millisecond)
end
