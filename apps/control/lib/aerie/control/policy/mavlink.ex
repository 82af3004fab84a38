defmodule Aerie.Control.Policy.Mavlink do
  @moduledoc """
  What a raw MAVLink message asks of a vehicle, in the words of the policy (`Aerie.Control.Policy.Intent`): the same
  rules judge a ground station's DO_REPOSITION and a `goto`.

  Commands of MAV_CMD are read by `Aerie.Control.Policy.Mavlink.Commands`. What is not a command of the table has a type
  of its own:

  | type | messages | permission |
  |---|---|---|
  | `mission_upload`, `fence_upload`, `rally_upload` | MISSION_COUNT, MISSION_ITEM(_INT), MISSION_WRITE_PARTIAL_LIST, MISSION_CLEAR_ALL, FENCE_POINT, RALLY_POINT | `mission` |
  | `set_parameter` | PARAM_SET, PARAM_EXT_SET, PARAM_MAP_RC | `maintain`; a camera's PARAM_EXT_SET `payload` |
  | `write_file` | FILE_TRANSFER_PROTOCOL with an operation that writes | `maintain` |
  | `sensor_input` | what estimators and failsafes are given (`limited` of `Meaning.Messages`) | `sensors`, `inputs` |
  | `erase_logs` | LOG_ERASE | `maintain` |
  | `aux_function` | DO_AUX_FUNCTION, as far as it is not another command by another name (`Aerie.Control.Policy.Mavlink.AuxFunctions`) | by function |
  | `mav_cmd_N` | a command that has no type of its own | by its row (`MavCodec.Meaning.Commands`) |
  | `raw` | every other message that changes a vehicle, and those that cannot be read | `maintain` |

  An item of a mission needs `mission`, and what its command needs if that is more than an operator has. Parameters and
  files that protect a vehicle, and a fence that is removed, need `protection` besides
  (`Aerie.Control.Policy.Intent.Protection`).

  Items of a mission come one by one: `Aerie.Control.Policy.Mavlink.Upload` remembers where the last one was, so
  that the way from it is judged, and `Aerie.Control.Policy.Mavlink.Writing` all of them.
  """

  alias MavCodec.Meaning
  alias Aerie.Vehicle.Command.{Type, Types}
  alias Aerie.Vehicle.Firmware
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Mavlink.{Commands, Place, Request, Setpoints, Sticks, SystemId, Wording}
  alias MavCodec.Enums.{MavCmd, MavFtpOpcode, MavMissionType, MavParamType, MavRemoteLogDataBlockCommands}
  alias MavCodec.Dialects.All
  alias MavCodec.Message.ParamValue
  alias MavCodec.Messages, as: M

  @typedoc "What is known of the vehicle, as its snapshot has it: firmware, kind, its autopilot's component."
  @type vehicle :: %{
          :autopilot => Aerie.Vehicle.Firmware.name(),
          :vehicle_type => String.t(),
          optional(:component) => 0..255 | nil | :unknown
        }

  @fence MavMissionType.value(:MAV_MISSION_TYPE_FENCE)
  @rally MavMissionType.value(:MAV_MISSION_TYPE_RALLY)
  @all_types MavMissionType.value(:MAV_MISSION_TYPE_ALL)
  @waypoint MavCmd.value(:MAV_CMD_NAV_WAYPOINT)
  @rally_point MavCmd.value(:MAV_CMD_NAV_RALLY_POINT)
  @fence_items for %{id: id, name: "NAV_FENCE_" <> _kind} <- Meaning.Commands.all(), do: id
  # Where the vehicle may be. Exclusions may lie anywhere.
  @fence_inside [
    MavCmd.value(:MAV_CMD_NAV_FENCE_RETURN_POINT),
    MavCmd.value(:MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION),
    MavCmd.value(:MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION)
  ]
  # Operations of FTP that write; of them, the one whose data is not a path. The other ones that are defined read, end a
  # read, or answer.
  @ftp_writes Enum.map(
                ~w(CREATEFILE WRITEFILE REMOVEFILE CREATEDIRECTORY REMOVEDIRECTORY OPENFILEWO TRUNCATEFILE RENAME),
                &MavFtpOpcode.value(:"MAV_FTP_OPCODE_#{&1}")
              )
  @ftp_write MavFtpOpcode.value(:MAV_FTP_OPCODE_WRITEFILE)

  @real32 MavParamType.value(:MAV_PARAM_TYPE_REAL32)

  @log_orders [
    MavRemoteLogDataBlockCommands.value(:MAV_REMOTE_LOG_DATA_BLOCK_STOP),
    MavRemoteLogDataBlockCommands.value(:MAV_REMOTE_LOG_DATA_BLOCK_START)
  ]

  @payload [
    M.GimbalControl,
    M.GimbalDeviceSetAttitude,
    M.GimbalManagerSetAttitude,
    M.GimbalManagerSetPitchyaw,
    M.GimbalManagerSetManualControl,
    M.MountControl,
    M.MountConfigure,
    M.DigicamControl,
    M.DigicamConfigure,
    M.GoproSetRequest,
    M.Storm32GimbalManagerControl,
    M.Storm32GimbalManagerControlPitchyaw,
    M.Storm32GimbalManagerCorrectRoll,
    M.LedControl,
    M.LedStripConfig,
    M.PlayTune,
    M.PlayTuneV2
  ]
  @sticks [M.RcChannelsOverrideV2, M.RadioRcChannels, M.CubepilotRawRc]
  @attitude [M.SetAttitudeTarget, M.SetActuatorControlTarget, M.ManualSetpoint]

  @doc "What follows of a message that is passed on to a vehicle."
  @spec sent(Aerie.Base.Names.gateway(), map() | nil, struct()) :: :ok
  defdelegate sent(gateway, snapshot, message), to: SystemId

  @doc "The facts of a message; `:free` for one that only reads."
  @spec facts(struct(), vehicle()) :: Intent.t() | :free
  def facts(message, vehicle) do
    with %Intent{} = facts <- read(message, vehicle),
         do: named(%{facts | stored?: facts.stored? or stored?(facts, vehicle)}, message)
  end

  # Commands of the table have a name that everybody knows.
  defp named(%{label: nil} = facts, message) do
    if Types.fetch(facts.type) == :error, do: %{facts | label: Wording.of(message)}, else: facts
  end

  defp named(facts, _message), do: facts

  # The number that the firmware takes; an unknown one may take that of the float or that of the bytes.
  defp asked(%{param_type: @real32, param_value: value}, _autopilot), do: if(is_number(value), do: value)

  defp asked(%{param_type: type, param_value: wire}, autopilot) do
    with true <- Firmware.known?(autopilot),
         {:ok, value} <- ParamValue.asked(wire, type, Firmware.traits(autopilot).param_encoding) do
      value
    else
      _unknown -> nil
    end
  end

  defp stored?(%{type: "mission_start"} = facts, vehicle),
    do: not Firmware.reading(vehicle.autopilot).mission_start_arms? and kept?(facts, vehicle)

  defp stored?(facts, vehicle), do: kept?(facts, vehicle)

  defp kept?(facts, vehicle) do
    case Types.fetch(facts.type) do
      {:ok, type} ->
        first? = Firmware.traits(vehicle.autopilot).setpoints_before_arming?
        not Type.taken_disarmed?(type, first?, vehicle.vehicle_type)

      :error ->
        facts.permission == :fly and "takeoff" in facts.implies
    end
  end

  defp read(%M.CommandLong{} = m, vehicle), do: Commands.facts(m, vehicle)
  defp read(%M.CommandInt{} = m, vehicle), do: Commands.facts(m, vehicle)

  defp read(%M.CommandCancel{command: command}, _vehicle),
    do: own("mav_cmd_#{command}", :fly, ends_flight?: true)

  defp read(%M.SetMode{} = m, vehicle), do: Commands.set_mode(m.base_mode, m.custom_mode, vehicle)

  defp read(%M.ParamSet{param_id: name} = m, vehicle),
    do: Intent.set_parameters([{name, asked(m, vehicle.autopilot)}])

  defp read(%M.ParamExtSet{param_id: name, target_component: component}, vehicle),
    do: Intent.set_extended([name], component, Map.get(vehicle, :component))

  # A number other than -1 counts in place of the name.
  defp read(%M.ParamMapRc{param_index: -1, param_id: name}, _vehicle), do: Intent.set_parameters([name])
  defp read(%M.ParamMapRc{}, _vehicle), do: Intent.set_parameters([nil])

  defp read(%M.MissionCount{mission_type: type, count: count}, _vehicle),
    do: upload(type, removed(type, count))

  defp read(%M.MissionWritePartialList{mission_type: type}, _vehicle), do: upload(type)

  # It removes each of them.
  defp read(%M.MissionClearAll{mission_type: @all_types}, _vehicle),
    do: own("mission_upload", :mission, [besides: ["fence_upload", "rally_upload"]] ++ removed(@fence, 0))

  defp read(%M.MissionClearAll{mission_type: type}, _vehicle), do: upload(type, removed(type, 0))

  defp read(%M.MissionSetCurrent{seq: seq}, _vehicle),
    do: Intent.named("mission_set_current", enters: [{:item, seq}])

  # ArduPilot's way to say "go there now" and "be that high now": it stores no such item. Other firmwares do, and an
  # unknown one may do either.
  defp read(%module{current: current, mission_type: 0} = m, vehicle)
       when module in [M.MissionItem, M.MissionItemInt] and current in [2, 3] do
    case Firmware.reading(vehicle.autopilot).guided_items do
      :obeyed when m.command == @waypoint -> %{now(m) | number: item(m, vehicle).number}
      :obeyed -> both(now(m), item(m, vehicle))
      :stored -> item(m, vehicle)
      :either -> %{both(item(m, vehicle), now(m)) | stored?: true}
    end
  end

  defp read(%module{mission_type: @fence} = m, _vehicle) when module in [M.MissionItem, M.MissionItemInt] do
    if m.command in @fence_inside,
      do: upload(@fence, path: {:at, [%{Place.of(m) | height: :same}]}, what: "fence item #{m.seq}"),
      else: upload(@fence, foreign(m, @fence_items, "a fence"))
  end

  defp read(%module{mission_type: @rally} = m, _vehicle) when module in [M.MissionItem, M.MissionItemInt],
    do:
      upload(
        @rally,
        [path: {:at, [Place.of(m)]}, what: "rally point #{m.seq}"] ++
          foreign(m, [@rally_point], "rally points")
      )

  defp read(%module{mission_type: type}, _vehicle)
       when module in [M.MissionItem, M.MissionItemInt] and type != 0,
       do: upload(type)

  defp read(%module{} = m, vehicle) when module in [M.MissionItem, M.MissionItemInt], do: item(m, vehicle)

  defp read(%M.FencePoint{lat: lat, lng: lon, idx: n}, _vehicle) do
    place = %{lat: lat, lon: lon, height: :same}
    # It changes the fence in place, whatever was there.
    upload(@fence, path: {:at, [place]}, what: "fence point #{n}", also: [:protection])
  end

  defp read(%M.RallyPoint{lat: lat, lng: lon, alt: metres, idx: n}, _vehicle),
    do: upload(@rally, path: {:at, [Place.int(lat, lon, {:home, metres})]}, what: "rally point #{n}")

  defp read(%M.RcChannelsOverride{} = m, _vehicle),
    do: Intent.named("rc_override", switches: Sticks.switches(m))

  defp read(%module{}, _vehicle) when module in @sticks, do: Intent.named("rc_override", switches: :unknown)

  defp read(%M.ManualControl{} = m, _vehicle),
    do: Intent.named("manual_control", switches: Sticks.switches(m))

  # Where an attitude leads, nobody can tell.
  defp read(%module{}, _vehicle) when module in @attitude,
    do: Intent.named("setpoint_attitude", path: :anywhere)

  defp read(%module{} = m, vehicle)
       when module in [M.SetPositionTargetGlobalInt, M.SetPositionTargetLocalNed],
       do: Setpoints.facts(m, vehicle)

  defp read(%M.SetHomePosition{} = m, _vehicle) do
    place = Place.int(m.latitude, m.longitude, {:msl, m.altitude / 1000})
    Intent.named("set_home", path: {:at, [place]}, what: "the new home")
  end

  defp read(%M.SetGpsGlobalOrigin{}, _vehicle), do: Intent.named("set_origin")

  # PX4 takes those of somebody else for its pilot's sticks.
  defp read(%M.RcChannels{}, _vehicle), do: Intent.named("rc_override", switches: :unknown)

  # A vehicle that follows goes there.
  defp read(%M.FollowTarget{lat: lat, lon: lon, alt: metres}, _vehicle) do
    own("follow_target", :fly,
      moves?: true,
      path:
        if(is_number(metres),
          do: {:to, [Place.int(lat, lon, {:msl, metres})]},
          else: {:unknown, "its height is not a number"}
        ),
      what: "the place of who is followed"
    )
  end

  defp read(%M.FileTransferProtocol{payload: <<_sequence::16, _session, operation, rest::binary>>}, _vehicle) do
    case {operation, rest} do
      {@ftp_write, _bytes} -> Intent.write_file("")
      {write, <<_header::binary-size(8), path::binary>>} when write in @ftp_writes -> Intent.write_file(path)
      _another -> if(MavFtpOpcode.name(operation), do: :free, else: Intent.unknown_operation())
    end
  end

  # It starts and stops the log; its receipts for the blocks of a log change nothing, and are many.
  defp read(%M.RemoteLogBlockStatus{seqno: seqno}, _vehicle) when seqno not in @log_orders, do: :free

  defp read(%M.LogErase{}, _vehicle), do: own("erase_logs", :maintain)
  defp read(%M.RequestDataStream{}, _vehicle), do: Intent.named("set_message_interval")
  defp read(%module{}, _vehicle) when module in @payload, do: own("payload", :payload)

  defp read(%module{}, _vehicle) do
    case Meaning.Messages.row(module.id()) do
      %{limited: true} -> Intent.sensor_input(All.name(module.id()))
      _another -> unreadable()
    end
  end

  @doc "The facts of what cannot be read, or is not known: only a source that may do everything may send it."
  @spec unreadable() :: Intent.t()
  def unreadable, do: own("raw", :maintain)

  @doc "The facts of a message without a row, by its id: it is refused, unless the policy opens it."
  @spec unknown(message :: non_neg_integer()) :: Intent.t()
  def unknown(message), do: own("raw", :maintain, unknown: {:message, message})

  # The permission of its command beyond `mission`. An operator may put the rest into a mission.
  @strong [:terminate, :force_disarm, :protection, :maintain]

  defp item(m, vehicle) do
    case Meaning.Commands.get(m.command) do
      nil ->
        upload(0, unknown: {:command, m.command}, also: [:maintain])

      row ->
        request = Request.of(m, vehicle)
        command = Commands.read(request, row, vehicle)

        upload(0,
          also: Enum.filter(Enum.uniq(needed(row, command)), &(&1 in @strong)) ++ moved(row),
          number: command.number,
          mode: command.mode,
          modes: command.modes,
          standard_mode: command.standard_mode,
          path: if(home?(m, vehicle), do: :none, else: stop(row.as_item, m, row, request, vehicle)),
          sweep: if(row.as_item == :flown, do: Request.sweep(request)),
          what: "mission item #{m.seq}"
        )
    end
  end

  defp now(%{z: z} = m) when not is_number(z),
    do: %{now(%{m | z: 0.0}) | path: Request.missing(7, "the height")}

  defp now(%{current: 2} = m), do: Intent.named("goto", path: {:to, [Place.of(m)]}, sweep: {:stay, nil})

  defp now(m) do
    path = {:to, [%{Place.of(m) | lat: nil, lon: nil}]}
    Intent.named("set_altitude", path: path, what: "the height to fly at")
  end

  # What needs and leads to all that both do.
  defp both(facts, other) do
    %{
      facts
      | also: Enum.uniq(facts.also ++ [other.permission | other.also]),
        besides: [other.type | facts.besides],
        implies: Enum.uniq(facts.implies ++ other.implies),
        unknown: facts.unknown || other.unknown,
        number: facts.number || other.number,
        mode: facts.mode || other.mode,
        modes: Enum.uniq(facts.modes ++ other.modes),
        standard_mode: facts.standard_mode || other.standard_mode,
        path: if(other.path in [:none, facts.path], do: facts.path, else: {:all, [facts.path, other.path]}),
        moves?: facts.moves? or other.moves?,
        ends_flight?: facts.ends_flight? and other.ends_flight?
    }
  end

  # A command that does not belong in a plan of this type.
  defp foreign(%{command: command}, commands, what) do
    if command in commands, do: [], else: [number: "#{Commands.name(command)} is not an item of #{what}"]
  end

  # A plan ends no flight at once, but it decides about a protection.
  defp needed(%{name: "DO_PARACHUTE"}, command), do: [:protection | command.also]
  defp needed(_row, command), do: [command.permission | command.also]

  # A mission moves home, or the origin, in flight.
  defp moved(%{name: name}) when name in ["DO_SET_HOME", "DO_SET_GLOBAL_ORIGIN"], do: [:protection]
  defp moved(_row), do: []

  # ArduPilot takes no notice of what is sent for its home.
  defp home?(m, vehicle), do: m.seq == 0 and Firmware.of(vehicle.autopilot).home_is_item_0?()

  defp stop(:none, _m, _row, _request, _vehicle), do: :none
  defp stop(:anywhere, _m, _row, _request, _vehicle), do: :anywhere
  defp stop(:climb, _m, _row, request, _vehicle), do: Request.climb(request)

  # Its height is the first parameter, and its frame the second.
  defp stop(:height, m, %{name: "DO_CHANGE_ALTITUDE"}, request, _vehicle) do
    frame = Request.int(request, 2) || -1

    if is_number(m.param1),
      do: {:at, [%{lat: nil, lon: nil, height: Place.height(frame, m.param1)}]},
      else: Request.missing(1, "the height")
  end

  defp stop(:height, %{z: z}, _row, _request, _vehicle) when not is_number(z),
    do: Request.missing(7, "the height")

  defp stop(:height, m, _row, _request, vehicle), do: {:at, [%{Place.item(m, vehicle) | lat: nil, lon: nil}]}

  # A mark, or a home: no way leads there.
  defp stop(:stored, _m, %{name: "DO_SET_HOME"}, request, _vehicle) do
    case Enum.reject(Commands.homes(request), &(&1.lat == nil)) do
      [] -> :none
      homes -> {:along, homes}
    end
  end

  defp stop(:stored, m, _row, _request, _vehicle) do
    # A mark without a place, mostly.
    case Place.here(Place.of(m)) do
      %{lat: nil} -> :none
      place -> {:along, [%{place | height: :same}]}
    end
  end

  defp stop(:flown, _m, _row, %{path: {:unknown, _why} = path}, _vehicle), do: path
  defp stop(:flown, m, _row, _request, vehicle), do: {:at, [Place.item(m, vehicle)]}

  defp removed(type, 0) when type in [@fence, @all_types], do: [also: [:protection]]
  defp removed(_type, _count), do: []

  defp upload(mission_type, fields \\ [])
  defp upload(@fence, fields), do: own("fence_upload", :mission, fields)
  defp upload(@rally, fields), do: own("rally_upload", :mission, fields)
  defp upload(0, fields), do: own("mission_upload", :mission, fields)

  # Firmwares take it for one of the others, or for all of them.
  defp upload(type, fields) do
    number = "the mission type #{type} is not one of mission (0), fence (1) and rally points (2)"
    own("mission_upload", :mission, [besides: ["fence_upload", "rally_upload"], number: number] ++ fields)
  end

  defp own(type, permission, fields \\ []),
    do: struct!(%Intent{type: type, permission: permission}, fields)
end
