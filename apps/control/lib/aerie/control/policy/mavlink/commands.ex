defmodule Aerie.Control.Policy.Mavlink.Commands do
  @moduledoc """
  What a command of MAV_CMD asks for, whichever message carries it: by its row of `MavCodec.Meaning.Commands`, and for some by their
  parameters.
  """

  alias MavCodec.Meaning
  alias MavCodec.Meaning.Commands.Row
  alias Aerie.Vehicle.Command.Types
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Mavlink.{AuxFunctions, Place, Request}
  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.Firmware.Modes
  alias MavCodec.Enums.{MavGoto, MavStandardMode, RebootShutdownConditions}

  import Bitwise

  # Parameters that make it disarm in flight, or arm without its checks.
  @force [21_196, 2989]
  # Forces a reboot while it is armed.
  @force_reboot Enum.map(RebootShutdownConditions.all(), &elem(&1, 1)) -- [0]

  @doc "A command by its name, or by its number if it has no row."
  @spec name(non_neg_integer()) :: String.t()
  def name(command) do
    case Meaning.Commands.get(command) do
      nil -> "the command #{command}"
      row -> row.name
    end
  end

  @doc "The facts of COMMAND_LONG and COMMAND_INT."
  @spec facts(struct(), Aerie.Control.Policy.Mavlink.vehicle()) :: Intent.t()
  def facts(%{command: command} = message, vehicle) do
    case Meaning.Commands.get(command) do
      nil -> unknown(command)
      row -> message |> Request.of(vehicle) |> read(row, vehicle)
    end
  end

  @doc "The facts of a command that has no row."
  @spec unknown(non_neg_integer()) :: Intent.t()
  def unknown(command) do
    %Intent{type: "mav_cmd_#{command}", permission: :maintain, moves?: true, unknown: {:command, command}}
  end

  @doc "The facts of a request for a command that has a row."
  @spec read(Request.t(), Row.t(), Aerie.Control.Policy.Mavlink.vehicle()) :: Intent.t()
  def read(request, row, vehicle) do
    facts = asked(row.name, request, row, vehicle)

    # An ambiguous command is never exempt from rules.
    case Meaning.Commands.check(row, request.params) do
      :ok -> facts
      {:error, reason} -> %{facts | number: facts.number || reason, ends_flight?: false}
    end
  end

  defp asked("COMPONENT_ARM_DISARM", request, _row, _vehicle) do
    case {Request.int(request, 1), Request.int(request, 2)} do
      {0, force} when force in @force -> Intent.named("force_disarm")
      {0, 0} -> Intent.named("disarm")
      {1, force} when force in @force -> Intent.named("arm", permission: :maintain, also: [:protection])
      {1, 0} -> Intent.named("arm")
      _unreadable -> Intent.named("force_disarm")
    end
  end

  defp asked("SOLO_BTN_FLY_HOLD", _request, _row, _vehicle),
    do: Intent.named("takeoff", implies: ["arm"], path: :anywhere)

  defp asked(name, request, _row, vehicle) when name in ["NAV_TAKEOFF", "NAV_VTOL_TAKEOFF"] do
    path = takeoff(request.path, vehicle)

    what =
      if match?({:to, [%{lat: nil} | _]}, path), do: "the height to climb to", else: "the place to climb to"

    Intent.named("takeoff", path: path, sweep: :takeoff, what: what)
  end

  # What is not given PX4 keeps: the radius and the middle of the last circle.
  defp asked("DO_ORBIT", request, _row, _vehicle) do
    path =
      case {request.params[1], request.path} do
        {radius, _path} when not is_number(radius) -> Request.missing(1, "the radius")
        {_radius, {:unknown, _why} = path} -> path
        {_radius, {:to, [%{lat: nil} | _]}} -> Request.missing(5, "the latitude of its middle")
        {radius, _path} -> {:around, Request.place(request), radius}
      end

    Intent.named("orbit", path: path, what: "the circle")
  end

  defp asked("DO_SET_MODE", request, _row, vehicle) do
    [base, main, sub] = for index <- 1..3, do: Request.int(request, index) || 0
    bytes? = Firmware.reading(vehicle.autopilot).mode_in_bytes?
    large? = bytes? and (main > 255 or sub > 255)
    custom = if bytes?, do: bsl(main, 16) + bsl(sub, 24), else: main
    facts = set_mode(base, custom, vehicle)
    if large?, do: %{facts | number: "the mode #{main} #{sub} is not two bytes"}, else: facts
  end

  defp asked("DO_SET_STANDARD_MODE", request, _row, _vehicle) do
    name = MavStandardMode.name(Request.int(request, 1) || 0) || :unknown
    name = name |> Atom.to_string() |> String.replace_prefix("MAV_STANDARD_MODE_", "") |> String.downcase()
    Intent.named("set_mode", standard_mode: name)
  end

  defp asked("DO_CHANGE_ALTITUDE", request, _row, vehicle) do
    metres = request.params[1]
    heights = [Place.height(Request.int(request, 2) || -1, metres)]
    msl? = Firmware.reading(vehicle.autopilot).ignores_frame?
    heights = if msl?, do: Enum.uniq(heights ++ [{:msl, metres}]), else: heights

    if is_number(metres),
      do: set_altitude({:to, for(height <- heights, do: %{lat: nil, lon: nil, height: height})}),
      else: set_altitude(Request.missing(1, "the height"))
  end

  defp asked("GUIDED_CHANGE_ALTITUDE", request, _row, _vehicle) do
    if is_number(request.params[7]),
      do: set_altitude({:to, [%{Request.place(request) | lat: nil, lon: nil}]}),
      else: set_altitude(Request.missing(7, "the height"))
  end

  defp asked("DO_SET_HOME", request, _row, _vehicle) do
    path = if elsewhere?(request), do: request.path, else: {:at, homes(request)}
    Intent.named("set_home", path: path, what: "the new home")
  end

  defp asked("DO_PAUSE_CONTINUE", request, _row, _vehicle),
    do: Intent.named(if(Request.int(request, 1) == 0, do: "mission_pause", else: "resume"))

  defp asked("OVERRIDE_GOTO", request, _row, _vehicle) do
    orders = [Request.int(request, 1), Request.int(request, 2)]

    cond do
      goto("HOLD_AT_SPECIFIED_POSITION") in orders ->
        Intent.named("goto", path: request.path, sweep: {:stay, nil})

      goto("DO_CONTINUE") in orders ->
        Intent.named("resume")

      true ->
        Intent.named("hold")
    end
  end

  # Rovers drive by it: a speed in a direction.
  defp asked("NAV_SET_YAW_SPEED", request, _row, _vehicle) do
    path =
      case {request.params[1], request.params[2]} do
        {degrees, _speed} when not is_number(degrees) ->
          Request.missing(1, "the angle")

        {_degrees, speed} when not is_number(speed) ->
          Request.missing(2, "the speed")

        {degrees, speed} ->
          angle = degrees * :math.pi() / 180
          frame = if Request.int(request, 3) == 0, do: :north, else: :body
          {:drift, Intent.drift(frame, {speed * :math.cos(angle), speed * :math.sin(angle), 0})}
      end

    Intent.named("setpoint_velocity", path: path, what: Intent.drift_what())
  end

  defp asked("DO_PARACHUTE", request, _row, _vehicle),
    do: Intent.named("parachute", ends_flight?: Request.int(request, 1) == 2)

  # Taking it away, or its floor, takes a protection away.
  defp asked("DO_FENCE_ENABLE", request, _row, _vehicle),
    do: Intent.named("set_geofence", also: if(Request.int(request, 1) == 1, do: [], else: [:protection]))

  # Safe: the outputs are off, and the motors stop.
  defp asked("DO_SET_SAFETY_SWITCH_STATE", request, row, _vehicle),
    do: %{plain(row) | also: if(Request.int(request, 1) == 1, do: [], else: [:force_disarm])}

  # Without its engine it falls, or glides.
  defp asked("DO_ENGINE_CONTROL", request, row, _vehicle),
    do: %{plain(row) | also: if(Request.int(request, 1) == 1, do: [], else: [:force_disarm])}

  defp asked("DO_AUX_FUNCTION", request, _row, _vehicle),
    do: AuxFunctions.facts(Request.int(request, 1), Request.int(request, 2))

  # -1 leaves it where it is; the second parameter begins it again.
  defp asked("DO_SET_MISSION_CURRENT", request, row, _vehicle) do
    seq = Request.int(request, 1) || 0
    again = if Request.int(request, 2) == 0, do: [], else: [{:item, 0}]
    %{plain(row) | enters: [if(seq < 0, do: :current, else: {:item, seq}) | again]}
  end

  defp asked("DO_JUMP", request, row, _vehicle),
    do: %{plain(row) | enters: [{:item, Request.int(request, 1) || 0}]}

  defp asked("DO_JUMP_TAG", request, row, _vehicle),
    do: %{plain(row) | enters: [{:tag, Request.int(request, 1) || 0}]}

  defp asked("DO_LAND_START", _request, row, _vehicle), do: %{plain(row) | enters: [:landing]}

  defp asked("MISSION_START", request, _row, _vehicle) do
    first = Request.int(request, 1) || 0
    Intent.named("mission_start", enters: [:current | if(first > 0, do: [{:item, first}], else: [])])
  end

  # Known only by its number.
  defp asked("DO_SET_PARAMETER", _request, _row, _vehicle), do: Intent.set_parameters([nil])

  # Besides 0 and 1, which read and write, all of them reset something.
  defp asked("PREFLIGHT_STORAGE", request, _row, _vehicle) do
    if Request.int(request, 1) in [0, 1] and Request.int(request, 2) in [0, 1],
      do: Intent.named("save_params"),
      else: Intent.named("reset_params", also: [:protection])
  end

  defp asked("PREFLIGHT_REBOOT_SHUTDOWN", request, _row, _vehicle),
    do:
      Intent.named("reboot",
        also: if(Request.int(request, 6) in @force_reboot, do: [:force_disarm], else: [])
      )

  # A station that is refused may ask the one in charge to offer it (X15).
  defp asked("REQUEST_OPERATOR_CONTROL", request, _row, _vehicle) do
    if Request.int(request, 1) == 0 do
      Intent.named("release_control", control: :release)
    else
      Intent.named("take_control", control: {:take, nil, if(Request.int(request, 2) == 1, do: :anyone)})
    end
  end

  defp asked(_other, request, row, _vehicle) do
    sweep = if row.as_command == :flown, do: Request.sweep(request)
    %{plain(row) | path: path(row.as_command, request), sweep: sweep}
  end

  @doc "The facts of SET_MODE and DO_SET_MODE."
  @spec set_mode(integer(), non_neg_integer(), Aerie.Control.Policy.Mavlink.vehicle()) :: Intent.t()
  def set_mode(base, custom, vehicle) do
    case Modes.asked(vehicle.autopilot, vehicle.vehicle_type, base, custom) do
      [mode | others] ->
        flag = Firmware.reading(vehicle.autopilot).safety_flag
        "set_mode" |> Intent.named([mode: mode, modes: others] ++ armed(base, flag)) |> safety(base, flag)

      {:error, reason} ->
        Intent.named("set_mode", mode: "MODE(#{custom})", number: reason)
    end
  end

  @safety_armed 0x80

  # Alone, the flag is ArduPilot's safety switch: with 0 it takes it away, and else it stops the motors.
  defp safety(facts, @safety_armed, :switch),
    do: %{facts | also: [:protection, :force_disarm], ends_flight?: false}

  defp safety(facts, _base, _flag), do: facts

  defp armed(base, :arms) when band(base, @safety_armed) != 0, do: [implies: ["arm"]]
  defp armed(_base, _flag), do: []

  defp set_altitude(path), do: Intent.named("set_altitude", path: path, what: "the height to fly at")

  # A new home at a place that is not known.
  defp elsewhere?(request), do: match?({:unknown, _why}, request.path) and Request.int(request, 1) != 1

  defp takeoff({:to, places}, vehicle) do
    here = Enum.map(places, &Place.here/1)

    case Firmware.reading(vehicle.autopilot).zero_place do
      :there -> {:to, places}
      :here -> {:to, here}
      :either when here == places -> {:to, places}
      :either -> {:all, [{:to, here}, {:to, places}]}
    end
  end

  defp takeoff(local, _vehicle), do: local

  @doc "The places of a new home. Without a frame, its height is above mean sea level; with one, firmwares differ about it."
  @spec homes(Request.t()) :: [Intent.place(), ...]
  def homes(request) do
    place = Request.place(request)

    case {Request.int(request, 1), place.height} do
      {1, _height} -> [%{lat: nil, lon: nil, height: :same}]
      {_elsewhere, {:home, metres}} when request.frame? -> [place, %{place | height: {:msl, metres}}]
      {_elsewhere, {:home, metres}} -> [%{place | height: {:msl, metres}}]
      _known -> [place]
    end
  end

  defp path(:flown, request), do: request.path

  defp path(:height, %{path: {:unknown, _why} = path}), do: path
  defp path(:height, request), do: {:to, [%{Request.place(request) | lat: nil, lon: nil}]}
  defp path(:climb, request), do: Request.climb(request)
  defp path(:anywhere, _request), do: :anywhere
  defp path(_none, _request), do: :none

  # By its type in the table of commands, or by its row alone.
  defp plain(row) do
    case Types.name_of_mav_cmd(row.id) do
      name when name != nil ->
        Intent.named(name)

      nil ->
        %Intent{
          type: "mav_cmd_#{row.id}",
          permission: row.permission,
          moves?: row.permission in [:arm, :fly, :mission, :manual, :terminate, :force_disarm],
          implies:
            if(row.permission == :fly and row.as_command in [:flown, :anywhere], do: ["takeoff"], else: [])
        }
    end
  end

  defp goto(name), do: MavGoto.value(:"MAV_GOTO_#{name}")
end
