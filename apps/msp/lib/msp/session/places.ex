defmodule Msp.Session.Places do
  @moduledoc """
  Where iNav is to fly, and where its home is: DO_REPOSITION and DO_SET_HOME, as waypoints 255 and 0.

  iNav takes them only while it is armed and its pilot has switched GCS NAV on; to fly somewhere it holds its position as well (NAV POSHOLD). It acknowledges them
  otherwise, too, and does nothing. So both are looked at first, and afterwards the place is read back: what it wants to reach (waypoint 254), or its home.
  """
  @behaviour Msp.Session.Tasks

  alias MavCodec.Enums.{MavCmd, MavFrame}
  alias MavCodec.Messages, as: M
  alias Msp.{Modes, Session, Telemetry}
  alias Msp.Session.{Output, Tasks}

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
  @tries 2

  @doc "Whether this command, as COMMAND_INT or COMMAND_LONG, is one of these."
  @spec mine?(struct) :: boolean
  def mine?(%{command: command}), do: command in [@reposition, @set_home]

  @doc "The command of a client."
  @spec command(Session.t(), struct, {byte, byte}) :: Session.t()
  def command(%{identity: %{firmware: firmware}} = session, %{command: command}, from) when firmware != :inav,
    do: Output.acknowledge(session, command, from, :UNSUPPORTED)

  def command(session, %{command: command} = message, from) do
    with :ok <- ready(session, command), {:ok, waypoint} <- waypoint(session, message) do
      if Tasks.room?(session),
        do:
          Tasks.add(session, %{
            kind: __MODULE__,
            command: command,
            from: from,
            wanted: waypoint,
            tries: 0,
            ask: {"SET_WP", waypoint}
          }),
        else: Output.acknowledge(session, command, from, :TEMPORARILY_REJECTED)
    else
      {:error, why} -> refuse(session, command, from, :DENIED, why)
    end
  end

  defp ready(session, command) do
    boxes = session.readings[:boxes] || MapSet.new()

    cond do
      not Modes.armed?(boxes) ->
        {:error, "it is not armed"}

      @gcs_nav not in boxes ->
        {:error, "its pilot has not switched GCS NAV on"}

      command == @reposition and @position_hold not in boxes ->
        {:error, "it does not hold its position: switch NAV POSHOLD on"}

      true ->
        :ok
    end
  end

  defp waypoint(_session, %M.CommandInt{command: @reposition, frame: frame, x: lat, y: lon, z: z} = message)
       when is_float(z) and abs(z) < 1.0e6 and (lat != 0 or lon != 0) do
    cond do
      frame in @msl -> {:ok, at(255, lat, lon, z, heading(message.param4), 1)}
      frame in @home -> {:ok, at(255, lat, lon, z, heading(message.param4), 0)}
      true -> {:error, "heights are above home or above sea level"}
    end
  end

  defp waypoint(%{readings: %{lat: lat, lon: lon}}, %{command: @set_home, param1: 1.0})
       when lat != nil and lon != nil,
       do: {:ok, at(0, round(lat * 1.0e7), round(lon * 1.0e7), 0.0, 0, 0)}

  defp waypoint(_session, %M.CommandInt{command: @set_home, x: lat, y: lon}) when lat != 0 or lon != 0,
    do: {:ok, at(0, lat, lon, 0.0, 0, 0)}

  defp waypoint(_session, %M.CommandLong{command: @set_home, param1: p, param5: lat, param6: lon})
       when p != 1.0 and is_float(lat) and is_float(lon) and abs(lat) <= 90 and abs(lon) <= 180 and
              (lat != 0 or lon != 0),
       do: {:ok, at(0, round(lat * 1.0e7), round(lon * 1.0e7), 0.0, 0, 0)}

  defp waypoint(_session, _message), do: {:error, "it needs a place"}

  # Height 0 would keep the present one, so none is lower than a centimetre.
  defp at(number, lat, lon, z, heading, p3) do
    cm = round(z * 100)
    cm = if number == 255 and cm == 0, do: 1, else: cm

    %{
      number: number,
      action: @waypoint,
      lat: lat,
      lon: lon,
      altitude: cm,
      p1: heading,
      p2: 0,
      p3: p3,
      flag: 0
    }
  end

  # 0 keeps it.
  defp heading(degrees) when is_float(degrees) and degrees >= 0 and degrees <= 360,
    do: if(round(degrees) in [0, 360], do: 359, else: round(degrees))

  defp heading(_unset), do: 0

  @impl Tasks
  # The same place again is the same.
  def answer(session, %{tries: tries} = task, :timeout, _now) when tries < @tries,
    do: Tasks.ask_next(session, task, %{tries: tries + 1})

  def answer(session, %{ask: {"SET_WP", _}, wanted: %{number: number}} = task, {:ok, _acknowledged}, _now) do
    read = if number == 255, do: 254, else: 0
    Tasks.ask_next(session, task, %{tries: 0, ask: {"WP", %{number: read}}})
  end

  def answer(session, %{wanted: wanted} = task, {:ok, %{lat: lat, lon: lon}}, _now) do
    session = Tasks.done(session, task)

    if abs(lat - wanted.lat) <= @near and abs(lon - wanted.lon) <= @near,
      do: session |> moved(wanted) |> Output.acknowledge(task.command, task.from, :ACCEPTED),
      else:
        refuse(session, task.command, task.from, :FAILED, "iNav acknowledged the place, and has another one")
  end

  def answer(session, task, _none, _now),
    do: session |> Tasks.done(task) |> refuse(task.command, task.from, :FAILED, "the vehicle did not answer")

  defp moved(session, %{number: 0} = home) do
    readings = Map.put(session.readings, :home, {home.lat / 1.0e7, home.lon / 1.0e7})
    Output.emit(%{session | readings: readings}, Telemetry.home(readings))
  end

  defp moved(session, _desired), do: session

  defp refuse(session, command, from, result, why),
    do: session |> Output.text(@warning, "Not done: #{why}") |> Output.acknowledge(command, from, result)
end
