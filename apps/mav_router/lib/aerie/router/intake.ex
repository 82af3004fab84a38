defmodule Aerie.Router.Intake do
  @moduledoc """
  The few messages that the router itself looks at: heartbeats, for who somebody is, and SYSTEM_TIME, for reboots (R6).
  """

  alias Aerie.Mavlink.BootClock
  alias Aerie.Mavlink.Heartbeat
  alias Aerie.Mavlink.HighLatency
  alias Aerie.Names
  alias Aerie.Router.Endpoints
  alias Aerie.Router.Plan.Way
  alias Aerie.Router.Routes
  alias Aerie.Router.Systems
  alias Aerie.Router.Tables
  alias Aerie.Router.Talker
  alias MavCodec.Frame

  @system_time 2
  # HEARTBEAT, and HIGH_LATENCY2, which stands in its place on a link of high latency (X6).
  @says_who [0, 235]
  # Who is there for so long and says a heartbeat has said one before.
  @said_again_us 500_000

  @doc """
  Looks at frames of one talker: what is known of it and of its endpoint afterwards, and whether one of the frames was the
  heartbeat of a vehicle's autopilot (H2, H4).
  """
  @spec look(Names.gateway(), Tables.t(), Way.t(), Talker.t(), [Frame.t()]) :: {Talker.t(), Way.t(), boolean}
  def look(gateway, tables, way, talker, frames), do: look(frames, gateway, tables, way, talker, false)

  defp look([], _gateway, _tables, way, talker, vehicle?), do: {talker, way, vehicle?}

  defp look([%Frame{id: id, crc_extra: extra} = frame | rest], gateway, tables, way, talker, vehicle?)
       when id in @says_who and extra != nil do
    heartbeat = Heartbeat.read(frame)
    # That there are too many systems is no reason not to forward.
    for network <- way.networks, do: _ = Systems.note(gateway, network, way.owner, frame, heartbeat)
    now_vehicle? = Heartbeat.vehicle?(heartbeat)
    way = tables |> side(way, heartbeat, now_vehicle?) |> latency(tables, frame, now_vehicle?)
    look(rest, gateway, tables, way, %{talker | autopilot: now_vehicle?}, vehicle? or now_vehicle?)
  end

  defp look(
         [%Frame{id: @system_time, crc_extra: extra} = frame | rest],
         gateway,
         tables,
         way,
         talker,
         vehicle?
       )
       when extra != nil,
       do: look(rest, gateway, tables, way, time(gateway, tables, way, talker, frame), vehicle?)

  defp look([_other | rest], gateway, tables, way, talker, vehicle?),
    do: look(rest, gateway, tables, way, talker, vehicle?)

  # On a link to vehicles a ground station without a vehicle is a client, for as long as no autopilot is heard from there.
  defp side(tables, %{side: :client, heard_vehicle: false, role: :full, auto: true} = way, _heartbeat, true),
    do: turn(tables, way, :vehicle, true)

  defp side(tables, %{side: :vehicle, heard_vehicle: false} = way, _heartbeat, true),
    do: turn(tables, way, nil, true)

  defp side(tables, %{side: :vehicle, heard_vehicle: false} = way, heartbeat, false) do
    way = listens(tables, way)
    if Heartbeat.role(heartbeat) == "gcs", do: turn(tables, way, :client, false), else: way
  end

  defp side(tables, %{auto: true, heard_vehicle: false} = way, _heartbeat, false), do: listens(tables, way)

  defp side(_tables, way, _heartbeat, _vehicle?), do: way

  # There was no room for one more that is no vehicle when it came; there may be now.
  defp listens(_tables, %{listens: true} = way), do: way

  defp listens(tables, way) do
    # Made-up senders say one heartbeat.
    with %{since: since} <- Endpoints.get(tables, way.key),
         true <- System.os_time(:microsecond) - since >= @said_again_us,
         %{} = owner <- Endpoints.owner(tables, way.owner),
         true <- Endpoints.listens?(tables, owner, :said) do
      Endpoints.note(tables, way.key, listens: true)
      %{way | listens: true}
    else
      _full -> way
    end
  end

  # Summaries of a vehicle and no heartbeat for a while: a link of high latency, whoever set it up (X6). A heartbeat ends
  # that at once.
  defp latency(way, _tables, _frame, false), do: way

  defp latency(way, tables, %{id: 0, at: at}, true) do
    :ets.insert(tables.scores, {{:beat, way.key}, at})
    if way.high_latency, do: Endpoints.note(tables, way.key, high_latency: false)
    way
  end

  defp latency(%{high_latency: true} = way, _tables, _summary, true), do: way

  defp latency(way, tables, %{at: at}, true) do
    beat = :ets.lookup_element(tables.scores, {:beat, way.key}, 2, nil)

    if beat == nil or (at != nil and at - beat > HighLatency.silent_us()),
      do: Endpoints.note(tables, way.key, high_latency: true)

    way
  end

  defp turn(tables, way, side, heard?) do
    Endpoints.note(tables, way.key, side: side, heard_vehicle: heard?)
    %{way | side: side || way.side, heard_vehicle: heard?}
  end

  defp time(gateway, tables, way, talker, %Frame{payload: payload, at: at}) when is_integer(at) do
    # Zeros at its end were cut off (F7), as they are in every boot time of less than half a year.
    <<_unix::64, boot::32-little, _::binary>> = <<payload::binary, 0::96>>

    case BootClock.read(talker.clock || BootClock.new(), @system_time, boot, at) do
      {clock, :reboot} ->
        reboot(gateway, tables, way, talker)
        %{talker | clock: clock, learned: nil}

      {clock, _going_on} ->
        %{talker | clock: clock}
    end
  end

  defp time(_gateway, _tables, _way, talker, _frame), do: talker

  # Another vehicle with that id may do what it likes.
  defp reboot(_gateway, _tables, _way, %{other: true}), do: :ok

  defp reboot(gateway, tables, way, talker) do
    for network <- way.networks do
      Routes.clear(tables, {network, talker.system})
      metadata = %{gateway: gateway, network: network, system: talker.system}
      :telemetry.execute([:aerie, :router, :reboot], %{}, metadata)
    end

    Tables.rerouted(tables)
  end
end
