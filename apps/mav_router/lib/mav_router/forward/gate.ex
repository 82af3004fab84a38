defmodule MavRouter.Forward.Gate do
  @moduledoc """
  Decides for each frame whether it may reach vehicles: the table (`MavCodec.Meaning.Messages`) says what it needs, the sender's
  principal (`Aerie.Base.Principal`) what he has.

  | scope | reaches |
  |---|---|
  | `:cleared` | every receiver |
  | `:clients` | clients only |
  | `:related` | clients, and those vehicles and parts that the sender's relation to them allows (`MavRouter.Forward.Reach`) |

  - Frames of vehicles, their parts and strangers are `:related`. By a link with `parts: true` a part asks its own
    system what it likes, and a companion commands its own system as an operator does, unless the same endpoint brings
    parts of several vehicles.
  - Telemetry, heartbeats, questions, input and answers of a client are `:cleared` if the client has the row's permission, and
    nobody else is in charge of the vehicle. Otherwise they go to clients only. A question of a client that may not ask is
    answered from the gateway's copies, or asked by the gateway (`MavRouter.Forward.Gate.Questions`).
  - Everything else of a client is judged by `MavRouter.Router.Policy`, and so is input by which a vehicle may be led around a
    fence (`limited` in the table). A refused command goes nowhere, and is counted as `denied`.
  - A message without a row reaches no vehicle, unless the policy opens it.

  A command for all systems is judged for each vehicle that it would reach, and goes to none if it is refused for one. A peer of
  a link that was not heard yet, and a vehicle without a session, is one of which nothing is known.

  A vehicle on a link by which its sender counts as a client is judged as such when it commands: saying a vehicle's heartbeat costs
  nothing, and a router on this machine brings vehicles and ground stations by one endpoint. Not judged is what it says to
  ground stations, to this gateway (the items of a plan that is read are orders as well), and to its own system while no other
  endpoint has an autopilot of that id.
  """

  import MavCodec.Meaning.Heartbeat, only: [is_station: 1]

  alias MavCodec.Meaning.Commands
  alias MavCodec.Meaning.Messages
  alias Aerie.Base.Principal
  alias MavCodec.Command
  alias MavCodec.Enums.MavComponent
  alias MavRouter.Forward.Gate.Questions
  alias MavRouter.Forward.Delivery
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Forward
  alias MavRouter.Forward.Refusal
  alias MavRouter.Endpoints.Output
  alias MavRouter.Endpoints.Owner.Renumber
  alias MavRouter.Routes
  alias MavRouter.Tables
  alias Aerie.Base.Store

  # Companions of a vehicle, by their component ids.
  @companions Enum.map(["" | ~w(2 3 4)], &MavComponent.value(:"MAV_COMP_ID_ONBOARD_COMPUTER#{&1}"))

  @type scope :: :cleared | :clients | :related

  @doc "The frames that go on, in their order: a delivery for each run of frames of one scope."
  @spec sort(Delivery.t()) :: [Delivery.t()]
  def sort(%{frames: frames} = delivery), do: frames |> sort(delivery) |> deliveries(delivery)

  defp deliveries([], _delivery), do: []

  defp deliveries([{scope, frames} | rest], delivery),
    do: [%{delivery | scope: scope, frames: frames} | deliveries(rest, delivery)]

  defp sort(frames, %{path: %{role: :read_only}}), do: [{:clients, frames}]
  defp sort(frames, %{source: %{standing: :claim}}), do: [{:clients, frames}]

  defp sort(frames, %{path: %{side: :vehicle, commands: false} = path, source: source} = delivery) do
    cond do
      path.parts and not source.vehicle and not source.collided -> of_part(frames, delivery)
      path.heard_vehicle == true or source.collided -> [{:related, frames}]
      true -> of_client(frames, delivery)
    end
  end

  defp sort(frames, %{path: %{side: :vehicle}, source: %{vehicle: true}} = delivery) do
    if Enum.any?(frames, &Messages.order?(&1.id)),
      do: frames |> Enum.flat_map(&of_vehicle(&1, delivery)) |> runs(),
      else: [{:related, frames}]
  end

  defp sort(frames, delivery), do: of_client(frames, delivery)

  defp principal(%{gateway: gateway, tables: %{policy: policy}, path: path}) do
    if policy, do: policy.principal(gateway, path), else: anybody(path)
  end

  # A router without a policy.
  defp anybody(%{commands: true} = path),
    do: %Principal{kind: :client, name: path.owner, role: :operator, may: :all}

  defp anybody(path), do: %Principal{kind: :stranger, name: path.owner, role: :viewer}

  defp of_vehicle(frame, delivery) do
    if Messages.order?(frame.id) do
      target = Forward.target(frame, delivery)

      if own?(target, frame, delivery),
        do: [{:related, frame}],
        else: order(frame, target, principal(delivery), delivery)
    else
      [{:related, frame}]
    end
  end

  defp of_part(frames, delivery), do: frames |> Enum.flat_map(&part(&1, delivery)) |> runs()

  # What is for another system, or for all, is judged by the relation alone.
  defp part(%{system: system} = frame, %{source: %{component: component}} = delivery) do
    with %{part: false} = row <- Messages.row(frame.id),
         {^system, _component} = target <- Forward.target(frame, delivery),
         false <- others_too?(system, delivery) do
      cond do
        row.class == :question or question?(frame) ->
          [{:cleared, frame}]

        row.order? and (component in @companions or least(frame, row) == :telemetry) ->
          # Its link has an entry of its own, or it is an operator of this system.
          order(frame, target, principal(%{delivery | path: %{delivery.path | commands: true}}), delivery)

        true ->
          [{:related, frame}]
      end
    else
      _not_to_its_own -> [{:related, frame}]
    end
  end

  # Whether it says that it is part of several vehicles.
  defp others_too?(system, %{gateway: gateway, tables: tables, path: path}) do
    Enum.any?(Routes.heard_by(tables, path.key), fn {_network, other} = key ->
      other != system and Store.vehicle(gateway, key) != nil
    end)
  end

  defp least(frame, row) do
    case Command.of(frame) do
      nil -> row.permission
      number -> Commands.permission(number)
    end
  end

  defp of_client(frames, delivery) do
    principal = principal(delivery)
    frames |> Enum.flat_map(&decision(&1, principal, delivery)) |> runs()
  end

  defp runs([]), do: []

  defp runs(sorted) do
    sorted
    |> Enum.chunk_by(&elem(&1, 0))
    |> Enum.map(fn [{scope, _frame} | _] = run -> {scope, Enum.map(run, &elem(&1, 1))} end)
  end

  defp decision(frame, principal, %{path: path} = delivery) do
    case Messages.row(frame.id) do
      nil ->
        unknown(frame, principal, delivery)

      # A vehicle may not have said what it is yet.
      %{class: :telemetry} = row when path.side == :vehicle ->
        if row.part and not Principal.may?(principal, row.permission),
          do: [{:clients, frame}],
          else: [{:related, frame}]

      %{order?: order?, permission: permission, limited: limited?} = row
      when order? or limited? or permission == :manual ->
        cond do
          question?(frame) ->
            if Principal.may?(principal, :telemetry),
              do: [{:cleared, frame}],
              else: asked(frame, row, delivery)

          # Nobody commands from here, or nobody may send it: `MavRouter.Forward` keeps it from vehicles, and says so.
          not path.commands or permission == nil ->
            [{:clients, frame}]

          not order? and not Principal.may?(principal, permission) ->
            [{:clients, frame}]

          true ->
            order(frame, Forward.target(frame, delivery), principal, delivery)
        end

      %{class: :question} = row ->
        if Principal.may?(principal, row.permission),
          do: [{:cleared, frame}],
          else: asked(frame, row, delivery)

      row ->
        if Principal.may?(principal, row.permission) and permitted?(frame, row, principal, delivery),
          do: [{:cleared, frame}],
          else: [{:clients, frame}]
    end
  end

  defp question?(frame) do
    case Command.of(frame) do
      nil -> false
      number -> Commands.question?(number)
    end
  end

  # `MavRouter.Sharing.ReadCache` answers what it can.
  defp asked(frame, row, %{tables: %{readings: readings}, path: path} = delivery) do
    if path.side == :client and readings != nil and readings.reading?(frame) do
      [{:clients, frame}]
    else
      case Questions.ask(frame, row, delivery) do
        :asked ->
          []

        no when no in [:too_often, :denied] ->
          Counters.add(path.counters, :withheld, 1)
          []

        :not_askable ->
          [{:clients, frame}]
      end
    end
  end

  defp unknown(frame, principal, %{gateway: gateway, tables: %{policy: policy}, path: path} = delivery) do
    if policy != nil and path.commands and policy.open?(gateway, principal, frame.id) do
      [{:cleared, frame}]
    else
      Refusal.unknown(frame, delivery)
      [{:clients, frame}]
    end
  end

  # A ground station's heartbeat gives no order.
  defp permitted?(_frame, %{class: :presence}, _principal, _delivery), do: true
  defp permitted?(_frame, _row, _principal, %{tables: %{policy: nil}}), do: true

  defp permitted?(frame, _row, principal, %{gateway: gateway, tables: %{policy: policy}} = delivery) do
    frame
    |> Forward.target(delivery)
    |> vehicles(delivery)
    |> Enum.all?(&policy.permits?(gateway, principal, &1))
  end

  defp order(frame, _target, _principal, %{tables: %{policy: nil}}), do: [{:cleared, frame}]

  defp order(frame, target, principal, delivery) do
    %{gateway: gateway, tables: %{policy: policy}, path: path, source: source} = delivery
    sender = %{endpoint: path.key, owner: path.owner, peer: path.text, principal: principal}

    target
    |> vehicles(delivery)
    |> Enum.find_value([{:cleared, frame}], fn {network, _system} = vehicle ->
      case policy.decide(gateway, sender, vehicle, frame) do
        :forward ->
          nil

        {:answer, answers} ->
          answer(answers, path, network)
          []

        # Much of what an autopilot says to all is meant for its ground station.
        {:refuse, _answers, _instead} when target == :all and source.autopilot ->
          [{:clients, frame}]

        {:refuse, answers, instead} ->
          Counters.add(path.counters, :denied, 1)
          answer(answers, path, network)
          # A question, which needs its own permission.
          if Messages.order?(frame.id),
            do: instead |> List.wrap() |> Enum.flat_map(&decision(&1, principal, delivery)),
            else: [{:clients, frame}]
      end
    end)
  end

  defp answer(answers, path, network),
    do: Enum.each(answers, &Output.answer(path, network, IO.iodata_to_binary(&1)))

  defp own?(:all, _frame, %{source: source}), do: source.collided
  defp own?({system, _component}, %{system: system}, delivery), do: not elsewhere?(system, delivery)

  defp own?({system, _component}, _frame, delivery),
    do: gateway?(system, delivery) or station?(system, delivery)

  defp gateway?(system, %{tables: tables}),
    do: match?({^system, _component}, Tables.setting(tables, :own, nil))

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

  # Vehicles that it is for. One that has not been heard counts as well, as unknown.
  defp vehicles(target, %{gateway: gateway, path: path} = delivery) do
    case target do
      {system, _component} ->
        [
          List.first(
            for(network <- path.networks, id = known(gateway, path, network, system), do: {network, id})
          ) || unheard(path, system)
        ]

      :all ->
        known =
          for %{network: network, system_id: system} <- Store.vehicles(gateway),
              network in path.networks,
              do: {network, system}

        known ++ Enum.uniq(not_heard_yet(delivery) ++ not_known_yet(known, delivery))
    end
  end

  # Those whose sessions have not begun or never will, because there are too many of them: one for each network.
  defp not_known_yet(known, %{tables: tables, path: path, forwarding: %{vehicles: heard}}) do
    reached = known |> Enum.flat_map(&Routes.endpoints(tables, &1)) |> MapSet.new()

    for network <- path.networks,
        keys = heard |> Map.get(network, %{}) |> Map.delete(path.key) |> Map.keys(),
        not Enum.all?(keys, &(&1 in reached)),
        do: {network, 0}
  end

  # Peers of links that may be vehicles, one for each network.
  defp not_heard_yet(%{path: path, forwarding: %{listeners: listeners}}) do
    for {key, %{side: :vehicle} = to} <- listeners,
        key != path.key,
        network <- to.networks,
        network in path.networks,
        uniq: true,
        do: {network, 0}
  end

  defp known(gateway, path, network, system) do
    id = Renumber.meant(path.renumber, network, system)
    if id != nil and Store.vehicle(gateway, {network, id}), do: id
  end

  defp unheard(path, system) do
    network = hd(path.networks)
    {network, Renumber.meant(path.renumber, network, system) || system}
  end
end
