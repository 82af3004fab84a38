defmodule Msp.Session.Commands.Places do
  @moduledoc """
  Where iNav is to fly, and where its home is: DO_REPOSITION and DO_SET_HOME, as waypoints 255 and 0.

  iNav takes them only while it is armed and its pilot has switched GCS NAV on; to fly somewhere it also holds its position (NAV POSHOLD). Otherwise it acknowledges
  them as well, and does nothing. So both are looked at first, and afterwards place and height are read back: what it
  wants to reach (waypoint 254), or its home.

  The heights of both are above iNav's origin, whatever their third parameter says, while those that are read are above
  sea level. Where the origin is follows from
  where the vehicle is, once above sea level (waypoint 255) and once above the origin (ALTITUDE); how high home is,
  from waypoint 0.
  """
  @behaviour Msp.Session.Tasks

  alias MavCodec.Enums.{MavCmd, MavFrame}
  alias MavCodec.Messages, as: M
  alias Msp.Readings.Navigation
  alias Msp.{Firmware, Session}
  alias Msp.Session.{Output, Tasks}
  alias Msp.Session.Tasks.Armed

  @reposition MavCmd.value(:MAV_CMD_DO_REPOSITION)
  @set_home MavCmd.value(:MAV_CMD_DO_SET_HOME)
  @msl for name <- [:MAV_FRAME_GLOBAL, :MAV_FRAME_GLOBAL_INT], do: MavFrame.value(name)
  @home for name <- [:MAV_FRAME_GLOBAL_RELATIVE_ALT, :MAV_FRAME_GLOBAL_RELATIVE_ALT_INT],
            do: MavFrame.value(name)
  @gcs_nav 31
  @position_hold 11
  @waypoint 1
  @warning 4
  # iNav has centimetres from its origin: this is half a metre.
  @near 50
  # Two metres, in cm: it climbs between two readings.
  @as_high 200
  @tries 2

  @doc "Whether this command, as COMMAND_INT or COMMAND_LONG, is one of these."
  @spec mine?(struct) :: boolean
  def mine?(%{command: command}), do: command in [@reposition, @set_home]

  @doc "The command of a client."
  @spec command(Session.t(), struct, {byte, byte}) :: Session.t()
  def command(session, %{command: command} = message, from) do
    if Firmware.of(session.identity.firmware).missions?,
      do: place(session, message, from),
      else: Output.acknowledge(session, command, from, :UNSUPPORTED)
  end

  defp place(session, %{command: command} = message, from) do
    with :ok <- ready(session, command), {:ok, wanted} <- wanted(session, message) do
      if Tasks.room?(session),
        do:
          Tasks.add(session, %{
            kind: __MODULE__,
            command: command,
            from: from,
            wanted: wanted,
            tries: 0,
            armed: true,
            found: %{},
            ask: {"WP", %{number: 0}}
          }),
        else: Output.acknowledge(session, command, from, :TEMPORARILY_REJECTED)
    else
      {:error, why} -> refuse(session, command, from, :DENIED, why)
    end
  end

  defp ready(session, command) do
    boxes = session.readings[:boxes]

    case Armed.state(session) do
      :disarmed -> {:error, "it is not armed"}
      :unknown -> {:error, "whether it is armed is not known: try again"}
      :armed when boxes != nil -> switched(command, @gcs_nav in boxes, @position_hold in boxes)
    end
  end

  defp switched(_command, false, _held?), do: {:error, "its pilot has not switched GCS NAV on"}

  defp switched(@reposition, true, false),
    do: {:error, "it does not hold its position: switch NAV POSHOLD on"}

  defp switched(_command, true, _held?), do: :ok

  # The place, and above what its height is: `{:sea | :home, m}`, or `:kept`.
  defp wanted(_session, %M.CommandInt{command: @reposition, frame: frame, x: lat, y: lon, z: z} = message)
       when is_float(z) and abs(z) < 1.0e6 and (lat != 0 or lon != 0) do
    cond do
      frame in @msl -> {:ok, at(255, lat, lon, {:sea, z}, heading(message.param4))}
      frame in @home -> {:ok, at(255, lat, lon, {:home, z}, heading(message.param4))}
      true -> {:error, "heights are above home or above sea level"}
    end
  end

  defp wanted(%{readings: %{lat: lat, lon: lon}}, %{command: @set_home, param1: 1.0})
       when lat != nil and lon != nil,
       do: {:ok, at(0, round(lat * 1.0e7), round(lon * 1.0e7), :kept, 0)}

  defp wanted(_session, %M.CommandInt{command: @set_home, x: lat, y: lon}) when lat != 0 or lon != 0,
    do: {:ok, at(0, lat, lon, :kept, 0)}

  defp wanted(_session, %M.CommandLong{command: @set_home, param1: p, param5: lat, param6: lon})
       when p != 1.0 and is_float(lat) and is_float(lon) and abs(lat) <= 90 and abs(lon) <= 180 and
              (lat != 0 or lon != 0),
       do: {:ok, at(0, round(lat * 1.0e7), round(lon * 1.0e7), :kept, 0)}

  defp wanted(_session, _message), do: {:error, "it needs a place"}

  defp at(number, lat, lon, height, heading),
    do: %{number: number, lat: lat, lon: lon, height: height, heading: heading}

  # 0 keeps it.
  defp heading(degrees) when is_float(degrees) and degrees >= 0 and degrees <= 360,
    do: if(round(degrees) in [0, 360], do: 359, else: round(degrees))

  defp heading(_unset), do: 0

  @impl Tasks
  # The same place again is the same.
  def answer(session, %{tries: tries} = task, :timeout, _now) when tries < @tries,
    do: Tasks.ask_next(session, task, %{tries: tries + 1})

  def answer(session, %{ask: {"WP", _}, placed: placed, wanted: wanted} = task, {:ok, %{lat: _} = read}, _now) do
    session = Tasks.done(session, task)

    cond do
      abs(read.lat - wanted.lat) > @near or abs(read.lon - wanted.lon) > @near ->
        refuse(session, task.command, task.from, :FAILED, "iNav acknowledged the place, and has another one")

      abs(read.altitude - placed) > @as_high ->
        heights = "#{metres(read.altitude)} m above sea level instead of #{metres(placed)} m"
        why = "iNav acknowledged the place, and has the height #{heights}"
        refuse(session, task.command, task.from, :FAILED, why)

      true ->
        session |> moved(wanted, read) |> Output.acknowledge(task.command, task.from, :ACCEPTED)
    end
  end

  # One that has no home says so with another action.
  def answer(session, %{ask: {"WP", %{number: 0}}} = task, {:ok, home}, _now),
    do: next(session, task, %{home: if(home[:lat] != 0, do: home[:altitude])}, {"WP", %{number: 255}})

  def answer(session, %{ask: {"WP", %{number: 255}}} = task, {:ok, here}, _now),
    do: next(session, task, %{here: here[:altitude]}, {"ALTITUDE", %{}})

  def answer(
        session,
        %{ask: {"ALTITUDE", _}, found: found, wanted: wanted} = task,
        {:ok, %{altitude: up}},
        _now
      ) do
    case above_origin(wanted, found, found.here && found.here - up) do
      {:ok, cm, origin} ->
        task = Map.put(task, :placed, origin + cm)
        Tasks.ask_next(session, task, %{tries: 0, ask: {"SET_WP", waypoint(wanted, cm)}})

      {:error, why} ->
        session |> Tasks.done(task) |> refuse(task.command, task.from, :DENIED, why)
    end
  end

  def answer(session, %{ask: {"SET_WP", _}, wanted: %{number: number}} = task, {:ok, _acknowledged}, _now) do
    read = if number == 255, do: 254, else: 0
    Tasks.ask_next(session, task, %{tries: 0, ask: {"WP", %{number: read}}})
  end

  def answer(session, task, _none, _now),
    do: session |> Tasks.done(task) |> refuse(task.command, task.from, :FAILED, "the vehicle did not answer")

  defp next(session, task, found, ask),
    do: Tasks.ask_next(session, task, %{tries: 0, found: Map.merge(task.found, found), ask: ask})

  # In cm.
  defp above_origin(_wanted, _found, nil), do: {:error, "it does not say how high it is above sea level"}
  defp above_origin(%{height: {:sea, z}}, _found, origin), do: {:ok, round(z * 100) - origin, origin}

  defp above_origin(%{height: {:home, _z}}, %{home: nil}, _origin),
    do: {:error, "it does not say how high its home is: give a height above sea level"}

  defp above_origin(%{height: {:home, z}}, %{home: home}, origin),
    do: {:ok, round(z * 100) + home - origin, origin}

  defp above_origin(%{height: :kept}, %{home: home}, origin), do: {:ok, (home || origin) - origin, origin}

  # A height of 0 would keep the present one.
  defp waypoint(%{number: number} = wanted, cm) do
    %{
      number: number,
      action: @waypoint,
      lat: wanted.lat,
      lon: wanted.lon,
      altitude: if(number == 255 and cm == 0, do: 1, else: cm),
      p1: wanted.heading,
      p2: 0,
      p3: 0,
      flag: 0
    }
  end

  defp metres(cm), do: :erlang.float_to_binary(cm / 100, decimals: 1)

  defp moved(session, %{number: 0} = home, read) do
    readings = Map.put(session.readings, :home, {home.lat / 1.0e7, home.lon / 1.0e7, read.altitude / 100})
    Output.emit(%{session | readings: readings}, Navigation.home(readings))
  end

  defp moved(session, _desired, _read), do: session

  defp refuse(session, command, from, result, why),
    do: session |> Output.text(@warning, "Not done: #{why}") |> Output.acknowledge(command, from, result)
end
