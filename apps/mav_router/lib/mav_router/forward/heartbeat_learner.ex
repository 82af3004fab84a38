defmodule MavRouter.Forward.HeartbeatLearner do
  @moduledoc """
  The few messages that the router itself reads: heartbeats tell what their sender is, SYSTEM_TIME tells reboots (R6).

  Everything that sends heartbeats (vehicles, ground stations, radios, gimbals) is kept in `Aerie.Base.Store.systems/1`
  under `{network, system}` as

      %{last_heard: us, vehicle: boolean, components: %{component => %{role, type, autopilot, link, last_heard}}}
  """

  alias Aerie.Base.Store
  alias MavCodec.Message.BootClock
  alias MavCodec.Meaning.Heartbeat
  alias MavCodec.Meaning.HighLatency
  alias MavCodec.MessageId
  alias MavRouter.Forward.Delivery
  alias MavRouter.Endpoints
  alias MavRouter.Routes
  alias MavRouter.Forward.Holders
  alias MavRouter.Forward.GroundStations
  alias MavRouter.Forward.Source
  alias MavRouter.Tables
  alias MavCodec.Frame

  @heartbeat MessageId.of!("HEARTBEAT")
  # Takes the place of the heartbeat on a link of high latency (X6).
  @high_latency2 MessageId.of!("HIGH_LATENCY2")
  @system_time MessageId.of!("SYSTEM_TIME")
  # The component id of nearly every autopilot.
  @autopilot1 1
  # An endpoint that sends a heartbeat after being there for so long has sent one before.
  @repeated_us 500_000
  @max_components 64

  @doc """
  Reads frames of one source: the delivery with what is known of the source and of its path afterwards, and with whether one of
  the frames was the heartbeat of a vehicle's autopilot (H2, H4).
  """
  @spec read(Delivery.t()) :: Delivery.t()
  def read(%{trusted: trusted, source: before} = delivery) do
    case {before.standing, read(trusted, delivery)} do
      # By this very heartbeat it became the vehicle's endpoint.
      {:claim, %{source: %{standing: :holder}} = delivery} -> Source.refresh(delivery)
      {_standing, delivery} -> delivery
    end
  end

  defp read([], delivery), do: delivery

  defp read([%Frame{id: id, crc_extra: extra} = frame | rest], delivery)
       when id in [@heartbeat, @high_latency2] and extra != nil,
       do: read(rest, heartbeat(frame, delivery))

  defp read([%Frame{id: @system_time, crc_extra: extra, at: at} = frame | rest], delivery)
       when extra != nil and is_integer(at),
       do: read(rest, system_time(frame, delivery))

  defp read([_other | rest], delivery), do: read(rest, delivery)

  defp heartbeat(frame, delivery) do
    heartbeat = Heartbeat.read(frame)
    vehicle? = Heartbeat.vehicle?(heartbeat)

    case if(vehicle?, do: join(heartbeat, delivery), else: {delivery.source.standing, delivery.source}) do
      # What somebody says in the name of another one's vehicle teaches nothing.
      {:claim, source} -> %{delivery | source: source}
      {_standing, source} -> heartbeat(frame, heartbeat, vehicle?, %{delivery | source: source})
    end
  end

  defp join(_heartbeat, %{source: %{collided: true, standing: standing} = source}) when standing != :claim,
    do: {standing, source}

  defp join(_heartbeat, %{path: %{side: :client, auto: false}, source: source}), do: {source.standing, source}

  defp join(%{type: type, autopilot: autopilot}, %{tables: tables, path: path, source: source} = delivery) do
    joined =
      for network <- path.networks do
        system = {network, source.system}
        Holders.join(tables, system, path, {type, autopilot}, delivery.secure, delivery.now)
      end

    cond do
      :claim in joined ->
        {:claim, %{source | autopilot: true, standing: :claim, looked: nil, marks: nil}}

      :changed in joined ->
        # Other senders under this id have another standing now.
        if others?(tables, path, source.system), do: Tables.rerouted(tables)
        {:holder, %{source | standing: :holder, collided: false, looked: nil, marks: nil}}

      true ->
        {:holder, source}
    end
  end

  defp others?(tables, path, system),
    do: Enum.any?(path.networks, &(Routes.endpoints(tables, {&1, system}) -- [path.key] != []))

  defp heartbeat(frame, heartbeat, vehicle?, %{tables: tables, path: path, source: source} = delivery) do
    # Beyond the limit of systems, frames are still forwarded.
    for network <- path.networks,
        do: _ = note_system(delivery.gateway, network, path.owner, frame, heartbeat)

    path =
      if vehicle?, do: latency(vehicle(path, tables), tables, frame), else: other(path, tables, heartbeat)

    %{
      delivery
      | path: path,
        source: source(source, vehicle?, path),
        vehicle: delivery.vehicle or vehicle?
    }
  end

  # Two links that hear one system at the same moment may overwrite each other's note of a component; the next heartbeat
  # corrects that.
  defp note_system(gateway, network, link, frame, heartbeat) do
    key = {network, frame.system}
    before = Store.system(gateway, key) || %{components: %{}, vehicle: false}

    component = %{
      role: Heartbeat.role(heartbeat),
      type: heartbeat.type,
      autopilot: heartbeat.autopilot,
      link: link,
      last_heard: frame.at
    }

    if not Heartbeat.vehicle?(heartbeat) do
      station = %{system: frame.system, component: frame.component, type: heartbeat.type}
      GroundStations.hear(gateway, network, Map.merge(station, %{via: link, last_heard: frame.at}))
    end

    Store.see_system(gateway, key, %{
      last_heard: frame.at,
      vehicle: before.vehicle or Heartbeat.vehicle?(heartbeat),
      components: put_component(before.components, frame.component, component)
    })
  end

  defp put_component(components, id, component)
       when is_map_key(components, id) or map_size(components) < @max_components do
    Map.put(components, id, component)
  end

  defp put_component(components, _id, _component), do: components

  # The first heartbeat of an autopilot changes what its frames reach.
  defp source(%{autopilot: vehicle?} = source, vehicle?, _path), do: source

  defp source(source, true, %{side: :vehicle}),
    do: %{source | autopilot: true, vehicle: true, looked: nil, marks: nil}

  defp source(source, vehicle?, _path), do: %{source | autopilot: vehicle?}

  # A ground station on a link to vehicles is a client for as long as no autopilot is heard from there.
  defp vehicle(%{side: :client, heard_vehicle: false, role: :full, auto: true} = path, tables),
    do: turn(path, tables, :vehicle, true)

  defp vehicle(%{side: :vehicle, heard_vehicle: false} = path, tables), do: turn(path, tables, nil, true)
  defp vehicle(path, _tables), do: path

  defp other(%{side: :vehicle, heard_vehicle: false} = path, tables, heartbeat) do
    path = listens(path, tables)
    if Heartbeat.role(heartbeat) == "gcs", do: turn(path, tables, :client, false), else: path
  end

  defp other(%{auto: true, heard_vehicle: false} = path, tables, _heartbeat), do: listens(path, tables)
  defp other(path, _tables, _heartbeat), do: path

  # There was no room for one more listener when it came; there may be now.
  defp listens(%{listens: true} = path, _tables), do: path

  defp listens(path, tables) do
    # A made-up sender says one heartbeat.
    with %{since: since} <- Endpoints.get(tables, path.key),
         true <- System.os_time(:microsecond) - since >= @repeated_us,
         %{} = owner <- Endpoints.owner(tables, path.owner),
         true <- Endpoints.listens?(tables, owner, :said) do
      Endpoints.note(tables, path.key, listens: true)
      %{path | listens: true}
    else
      _full -> path
    end
  end

  # Summaries of a vehicle and no heartbeat for a while: a link of high latency, configured or not (X6). A heartbeat ends
  # that at once.
  defp latency(path, tables, %{id: @heartbeat, at: at}) do
    :ets.insert(tables.scores, {{:heartbeat, path.key}, at})
    if path.high_latency, do: Endpoints.note(tables, path.key, high_latency: false)
    path
  end

  defp latency(%{high_latency: true} = path, _tables, _summary), do: path

  defp latency(path, tables, %{at: at}) do
    heartbeat_at = :ets.lookup_element(tables.scores, {:heartbeat, path.key}, 2, nil)

    if heartbeat_at == nil or (at != nil and at - heartbeat_at > HighLatency.silent_us()),
      do: Endpoints.note(tables, path.key, high_latency: true)

    path
  end

  defp turn(path, tables, side, heard_vehicle?) do
    Endpoints.note(tables, path.key, side: side, heard_vehicle: heard_vehicle?)
    %{path | side: side || path.side, heard_vehicle: heard_vehicle?}
  end

  defp system_time(%Frame{payload: payload, at: at}, %{source: source} = delivery) do
    # Zeros at the end are cut off (F7), as they are in every boot time of less than half a year.
    <<_unix::64, boot::32-little, _::binary>> = <<payload::binary, 0::96>>

    case BootClock.read(source.clock || BootClock.new(), @system_time, boot, at) do
      {clock, :reboot} ->
        reboot(delivery)
        %{delivery | source: %{source | clock: clock, learned: nil}}

      {clock, _going_on} ->
        %{delivery | source: %{source | clock: clock}}
    end
  end

  # The reboot of another vehicle with that id says nothing about this one, nor does that of a part. What other
  # endpoints taught stays.
  defp reboot(%{source: %{collided: true}}), do: :ok

  defp reboot(%{path: %{side: :client}}), do: :ok
  defp reboot(%{source: %{autopilot: false, component: component}}) when component != @autopilot1, do: :ok

  defp reboot(%{gateway: gateway, tables: tables, path: %{key: {link, peer}} = path, source: source}) do
    for network <- path.networks do
      Routes.forget_system(tables, {network, source.system}, link, peer)
      metadata = %{gateway: gateway, network: network, system: source.system}
      :telemetry.execute([:aerie, :router, :reboot], %{}, metadata)
    end

    Tables.rerouted(tables)
  end
end
