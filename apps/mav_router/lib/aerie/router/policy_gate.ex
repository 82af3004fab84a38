defmodule Aerie.Router.PolicyGate do
  @moduledoc """
  Asks `Aerie.Router.Policy` about the commands of clients, and answers those that it refuses. They are counted as `denied`.

  A command for all systems is judged for each vehicle that it would reach, and goes to none of them if it is refused for one.

  A vehicle's link is judged as well where anybody may command by it: saying a vehicle's heartbeat costs nothing, and a router on
  this machine brings vehicles and ground stations by one endpoint. Not judged is what such an endpoint says to ground stations,
  and to the system that sends it while no other endpoint has an autopilot of that id.
  """

  import Aerie.Router.ControlMessages, only: [is_station: 1]

  alias Aerie.Router.CommandGate
  alias Aerie.Router.ControlMessages
  alias Aerie.Router.Delivery
  alias Aerie.Router.EndpointCounters
  alias Aerie.Router.Forward
  alias Aerie.Router.Renumber
  alias Aerie.Router.Routes
  alias Aerie.Router.StreamRequests
  alias Aerie.Store
  alias MavCodec.Frame

  @doc "The frames that may go on, and those that take the place of refused ones."
  @spec pass([Frame.t()], Delivery.t()) :: [Frame.t()]
  def pass(frames, %{tables: %{policy: nil}}), do: frames

  # An endpoint that nobody commands by, and one that may not: `Aerie.Router.CommandGate` has them.
  def pass(frames, %{path: %{role: :read_only}}), do: frames
  def pass(frames, %{path: %{commands: false}}), do: frames

  def pass(frames, delivery) do
    if CommandGate.free?(frames), do: frames, else: Enum.flat_map(frames, &judged(&1, delivery))
  end

  defp judged(frame, delivery) do
    if ControlMessages.kind(frame) == :command do
      target = Forward.target(frame, delivery)

      if own?(target, frame, delivery),
        do: [frame],
        else: target |> vehicles(delivery) |> decided(target, frame, delivery)
    else
      [frame]
    end
  end

  # Nothing of it reaches another vehicle.
  defp own?(_target, _frame, %{path: %{heard_vehicle: heard?}}) when heard? != true, do: false
  defp own?(:all, _frame, %{source: source}), do: source.collided
  defp own?({system, _component}, %{system: system}, delivery), do: not elsewhere?(system, delivery)
  defp own?({system, _component}, _frame, delivery), do: station?(system, delivery)

  # A vehicle has two links, or somebody has taken its id.
  defp elsewhere?(system, %{tables: tables, path: path, forwarding: %{paths: paths}}) do
    for network <- path.networks,
        key <- Routes.endpoints(tables, {network, system}),
        key != path.key,
        reduce: false do
      found? -> found? or match?(%{^key => %{heard_vehicle: true}}, paths)
    end
  end

  defp station?(system, %{gateway: gateway, path: path}) do
    Enum.all?(path.networks, fn network ->
      case Store.system(gateway, {network, system}) do
        %{vehicle: vehicle?} -> not vehicle?
        nil -> is_station(system)
      end
    end)
  end

  defp decided(vehicles, target, frame, delivery) do
    %{gateway: gateway, tables: %{policy: policy}, path: path, source: source} = delivery
    sender = %{endpoint: path.key, owner: path.owner, peer: path.text}

    Enum.find_value(vehicles, [frame], fn {network, _system} = vehicle ->
      case policy.decide(gateway, sender, vehicle, frame) do
        :forward ->
          nil

        {:answer, answers} ->
          answer(answers, path, network)
          []

        {:refuse, _answers, _instead} when target == :all and source.autopilot ->
          # Much of what an autopilot says to all is meant for its ground station. The gate keeps it from vehicles, and counts it.
          Forward.frames([frame], %{delivery | path: %{path | commands: false}})
          []

        {:refuse, answers, instead} ->
          EndpointCounters.add(path.counters, :denied, 1)
          answer(answers, path, network)
          List.wrap(instead)
      end
    end)
  end

  defp answer(answers, path, network),
    do: Enum.each(answers, &StreamRequests.answer(path, network, IO.iodata_to_binary(&1)))

  # Vehicles that it is for. Of one that is not known yet, nothing is known, and that counts, too.
  defp vehicles(target, %{gateway: gateway, path: path}) do
    case target do
      {system, _component} ->
        [
          List.first(
            for(network <- path.networks, id = known(gateway, path, network, system), do: {network, id})
          ) || unknown(path, system)
        ]

      :all ->
        for %{network: network, system_id: system} <- Store.vehicles(gateway),
            network in path.networks,
            do: {network, system}
    end
  end

  defp known(gateway, path, network, system) do
    id = Renumber.meant(path.renumber, network, system)
    if id != nil and Store.vehicle(gateway, {network, id}), do: id
  end

  defp unknown(path, system) do
    network = hd(path.networks)
    {network, Renumber.meant(path.renumber, network, system) || system}
  end
end
