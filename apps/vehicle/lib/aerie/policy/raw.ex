defmodule Aerie.Policy.Raw do
  @moduledoc """
  What a raw MAVLink message asks of a vehicle, in the words of the policy (`Aerie.Policy.Facts`): the same rules judge a
  ground station's DO_REPOSITION and a `goto`.

  Commands of MAV_CMD are read by `Aerie.Policy.Raw.Commands`. What is not a command of the table has a type of its own:

  | type | messages | permission |
  |---|---|---|
  | `mission_upload`, `fence_upload`, `rally_upload` | MISSION_COUNT, MISSION_ITEM(_INT), MISSION_WRITE_PARTIAL_LIST, MISSION_CLEAR_ALL, FENCE_POINT, RALLY_POINT | `mission` |
  | `set_parameter` | PARAM_SET, PARAM_EXT_SET, PARAM_MAP_RC | `maintain` |
  | `write_file` | FILE_TRANSFER_PROTOCOL with an operation that writes; LOG_ERASE | `maintain` |
  | `mav_cmd_N` | a command that nothing here knows | `fly`; `maintain` beyond the commands of MAVLink's own |
  | `raw` | every other message that changes a vehicle, and those that cannot be read | `maintain` |

  Items of a mission come one by one: `Aerie.Policy.Raw.Upload` remembers where the last one was, so that the way from it is
  judged, too.
  """

  import Bitwise

  alias Aerie.Policy.Facts
  alias Aerie.Policy.Raw.{Commands, Place}
  alias Aerie.Protocol.Modes
  alias MavCodec.Enums.{MavCmd, MavMissionType, MavRemoteLogDataBlockCommands}
  alias MavCodec.Messages, as: M

  @typedoc "What is known of the vehicle: its firmware and its kind, as its snapshot has them."
  @type vehicle :: %{autopilot: :ardupilot | :px4 | :generic, vehicle_type: String.t()}

  @fence MavMissionType.value(:MAV_MISSION_TYPE_FENCE)
  @rally MavMissionType.value(:MAV_MISSION_TYPE_RALLY)
  # Where the vehicle may be. Exclusions may lie anywhere.
  @fence_inside [
    MavCmd.value(:MAV_CMD_NAV_FENCE_RETURN_POINT),
    MavCmd.value(:MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION),
    MavCmd.value(:MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION)
  ]
  # Operations of FTP that create, write, remove or rename.
  @ftp_writes 6..13 |> Enum.to_list()

  @log_orders [
    MavRemoteLogDataBlockCommands.value(:MAV_REMOTE_LOG_DATA_BLOCK_STOP),
    MavRemoteLogDataBlockCommands.value(:MAV_REMOTE_LOG_DATA_BLOCK_START)
  ]

  # Bits of POSITION_TARGET_TYPEMASK: what is set is not meant.
  @no_position 0b111
  @no_velocity 0b111000

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
  @sticks [M.RcChannelsOverride, M.RcChannelsOverrideV2, M.RadioRcChannels, M.CubepilotRawRc]
  @attitude [M.SetAttitudeTarget, M.SetActuatorControlTarget, M.ManualSetpoint]

  @doc "The facts of a message; `:free` for one that only reads."
  @spec facts(struct(), vehicle()) :: Facts.t() | :free
  def facts(%M.CommandLong{} = m, vehicle), do: Commands.facts(m, vehicle)
  def facts(%M.CommandInt{} = m, vehicle), do: Commands.facts(m, vehicle)

  def facts(%M.CommandCancel{command: command}, _vehicle),
    do: own("mav_cmd_#{command}", :fly, ends_flight?: true)

  def facts(%M.SetMode{} = m, vehicle) do
    Facts.named("set_mode",
      mode: Modes.name(vehicle.autopilot, vehicle.vehicle_type, m.base_mode, m.custom_mode)
    )
  end

  def facts(%module{}, _vehicle) when module in [M.ParamSet, M.ParamExtSet, M.ParamMapRc],
    do: own("set_parameter", :maintain)

  def facts(%M.MissionCount{mission_type: type}, _vehicle), do: upload(type)
  def facts(%M.MissionWritePartialList{mission_type: type}, _vehicle), do: upload(type)
  def facts(%M.MissionClearAll{mission_type: type}, _vehicle), do: upload(type)
  def facts(%M.MissionSetCurrent{}, _vehicle), do: Facts.named("mission_set_current")

  # ArduPilot's way to say "go there now" and "be that high now".
  def facts(%module{current: 2} = m, _vehicle) when module in [M.MissionItem, M.MissionItemInt],
    do: Facts.named("goto", path: {:to, [Place.of(m)]})

  def facts(%module{current: 3} = m, _vehicle) when module in [M.MissionItem, M.MissionItemInt],
    do:
      Facts.named("set_altitude",
        path: {:to, [%{Place.of(m) | lat: nil, lon: nil}]},
        what: "the height to fly at"
      )

  def facts(%module{mission_type: @fence} = m, _vehicle) when module in [M.MissionItem, M.MissionItemInt] do
    if m.command in @fence_inside,
      do: upload(@fence, path: {:at, [%{Place.of(m) | height: :same}]}, what: "fence item #{m.seq}"),
      else: upload(@fence)
  end

  def facts(%module{mission_type: @rally} = m, _vehicle) when module in [M.MissionItem, M.MissionItemInt],
    do: upload(@rally, path: {:at, [Place.of(m)]}, what: "rally point #{m.seq}")

  def facts(%module{} = m, vehicle) when module in [M.MissionItem, M.MissionItemInt] do
    # Item 0 of ArduPilot is home, and ArduPilot takes no notice of what is sent for it.
    if Commands.place?(m.command) and not (vehicle.autopilot == :ardupilot and m.seq == 0),
      do: upload(0, path: {:at, [Place.item(m)]}, what: "mission item #{m.seq}"),
      else: upload(0)
  end

  def facts(%M.FencePoint{lat: lat, lng: lon, idx: n}, _vehicle),
    do: upload(@fence, path: {:at, [%{lat: lat, lon: lon, height: :same}]}, what: "fence point #{n}")

  def facts(%M.RallyPoint{lat: lat, lng: lon, alt: metres, idx: n}, _vehicle),
    do: upload(@rally, path: {:at, [Place.int(lat, lon, {:home, metres})]}, what: "rally point #{n}")

  def facts(%module{}, _vehicle) when module in @sticks, do: Facts.named("rc_override")

  def facts(%M.ManualControl{}, _vehicle), do: Facts.named("manual_control")
  def facts(%module{}, _vehicle) when module in @attitude, do: Facts.named("setpoint_attitude")

  def facts(%M.SetPositionTargetGlobalInt{type_mask: mask} = m, _vehicle)
      when band(mask, @no_position) != @no_position do
    Facts.named("setpoint_position",
      path: {:to, [Place.int(m.lat_int, m.lon_int, Place.height(m.coordinate_frame, m.alt))]}
    )
  end

  def facts(%M.SetPositionTargetLocalNed{type_mask: mask} = m, _vehicle)
      when band(mask, @no_position) != @no_position do
    Facts.named("setpoint_local", path: Place.local(m.coordinate_frame, {m.x, m.y, m.z}))
  end

  def facts(%module{type_mask: mask} = m, _vehicle)
      when module in [M.SetPositionTargetGlobalInt, M.SetPositionTargetLocalNed] and
             band(mask, @no_velocity) != @no_velocity do
    Facts.named("setpoint_velocity",
      path:
        {:drift, Place.axes(m.coordinate_frame), {Place.number(m.vx), Place.number(m.vy), Place.number(m.vz)}},
      what: "where that velocity leads within 3 s"
    )
  end

  def facts(%module{}, _vehicle) when module in [M.SetPositionTargetGlobalInt, M.SetPositionTargetLocalNed],
    do: Facts.named("setpoint_attitude")

  def facts(%M.SetHomePosition{} = m, _vehicle) do
    place = Place.int(m.latitude, m.longitude, {:msl, m.altitude / 1000})
    Facts.named("set_home", path: {:at, [place]}, what: "the new home")
  end

  def facts(%M.SetGpsGlobalOrigin{}, _vehicle), do: Facts.named("set_origin")

  def facts(%M.FileTransferProtocol{payload: <<_sequence::16, _session, operation, _::binary>>}, _vehicle),
    do: if(operation in @ftp_writes, do: own("write_file", :maintain), else: :free)

  # It starts and stops the log; its receipts for the blocks of a log change nothing, and are many.
  def facts(%M.RemoteLogBlockStatus{seqno: seqno}, _vehicle) when seqno not in @log_orders, do: :free

  def facts(%M.LogErase{}, _vehicle), do: own("write_file", :maintain)
  def facts(%M.RequestDataStream{}, _vehicle), do: Facts.named("set_message_interval")
  def facts(%module{}, _vehicle) when module in @payload, do: own("payload", :payload)
  def facts(_other, _vehicle), do: unreadable()

  @doc "The facts of what cannot be read, or is not known: only who may do everything may send it."
  @spec unreadable() :: Facts.t()
  def unreadable, do: own("raw", :maintain)

  defp upload(mission_type, fields \\ [])
  defp upload(@fence, fields), do: own("fence_upload", :mission, fields)
  defp upload(@rally, fields), do: own("rally_upload", :mission, fields)
  defp upload(_mission, fields), do: own("mission_upload", :mission, fields)

  defp own(type, permission, fields \\ []),
    do: struct!(%Facts{type: type, permission: permission}, fields)
end
