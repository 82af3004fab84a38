defmodule Aerie.Router.PolicyGate do
  @moduledoc """
  Asks `Aerie.Router.Policy` about the commands of clients, and answers those that it refuses. They are counted as `denied`.

  A command for all systems is judged for each vehicle that it would reach, and goes to none of them if it is refused for one.
  """

  alias Aerie.Router.CommandGate
  alias Aerie.Router.ControlMessages
  alias Aerie.Router.Delivery
  alias Aerie.Router.EndpointCounters
  alias Aerie.Router.Renumber
  alias Aerie.Router.StreamRequests
  alias Aerie.Store
  alias MavCodec.Frame

  @doc "The frames that may go on, and those that take the place of refused ones."
  @spec pass([Frame.t()], Delivery.t()) :: [Frame.t()]
  def pass(frames, %{tables: %{policy: nil}}), do: frames

  # A vehicle's frames, an endpoint that nobody commands by, and one that may not: `Aerie.Router.CommandGate` has them.
  def pass(frames, %{path: %{heard_vehicle: true}}), do: frames
  def pass(frames, %{path: %{role: :read_only}}), do: frames
  def pass(frames, %{path: %{commands: false}}), do: frames

  def pass(frames, delivery) do
    if CommandGate.free?(frames), do: frames, else: Enum.flat_map(frames, &judged(&1, delivery))
  end

  defp judged(frame, delivery) do
    if ControlMessages.kind(frame) == :command,
      do: frame |> vehicles(delivery) |> decided(frame, delivery),
      else: [frame]
  end

  defp decided(vehicles, frame, %{gateway: gateway, tables: %{policy: policy}, path: path}) do
    sender = %{endpoint: path.key, owner: path.owner, peer: path.text}

    Enum.find_value(vehicles, [frame], fn {network, _system} = vehicle ->
      case policy.decide(gateway, sender, vehicle, frame) do
        :forward ->
          nil

        {:answer, answers} ->
          answer(answers, path, network)
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
  defp vehicles(frame, %{gateway: gateway, path: path}) do
    case Frame.target(frame) do
      {system, _component} when system != 0 ->
        [
          List.first(
            for(network <- path.networks, id = known(gateway, path, network, system), do: {network, id})
          ) || unknown(path, system)
        ]

      _all ->
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
