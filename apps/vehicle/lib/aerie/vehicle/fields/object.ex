defmodule Aerie.Vehicle.Fields.Object do
  @moduledoc """
  The fields of a vehicle besides the groups of its state (the object of `state.sock` and `/api/status`, and what
  `GET /api/vehicles/ID` adds), and those of a link. For `docs/telemetry.md`.
  """

  alias Aerie.Vehicle.Fields.Round

  @typedoc "`name` has dots for nested fields; `unit` is nil for a field without one."
  @type field :: %{name: String.t(), unit: String.t() | nil, meaning: String.t()}

  both = [
    {"timestamp", "s", "unix time of the response"},
    {"vehicle", nil, "public name; null in the only line of `state.sock` while there is no vehicle"},
    {"network", nil, "the network that its system id belongs to"},
    {"system_id", nil, "MAVLink system id"},
    {"status", nil, "online, stale or lost"},
    {"via", nil, "the gateway by which it is reached; null: a link of this one (fleet.md)"},
    {"age", "s", "since the vehicle was last heard"},
    {"fc_connected", nil, "true while the vehicle is online"},
    {"fc_port", nil, "device or address of the link that last heard it"},
    {"fc_baud", "1/s", "baud rate of a serial link"},
    {"autopilot", nil, "ardupilot, px4, …"},
    {"type", nil, "copter, plane, rover, …"},
    {"armed", nil, "as in the group `mode`"},
    {"in_air", nil, "as in the group `mode`"},
    {"mode", nil, "as in the group `mode`"},
    {"attitude", nil, "roll, pitch, yaw of the group"},
    {"position", nil, "lat, lon, alt_msl, alt_rel, heading of the group"},
    {"velocity", nil, "groundspeed, airspeed, climb of the group"},
    {"battery", nil, "voltage, current, remaining of the group"},
    {"gps", nil, "fix, satellites, hdop of the group"},
    {"ages", "s", "age of each of these five"}
  ]

  rest = [
    {"recording", nil, "how it is recorded (recordings.md); also in `/api/status`"},
    {"tags", nil, "words that people gave it (shadow.md); also in `/api/status`"},
    {"gateways", nil, "the other gateways that report it; also in `/api/status`"},
    {"groups", nil, "all state groups: `time`, `age`, `via`, `time_boot_ms`, `data`"},
    {"firmware", nil, "firmware version"},
    {"capabilities", nil, "MAV_PROTOCOL_CAPABILITY flags"},
    {"uid", nil, "unique id of the hardware"},
    {"component", nil, "component id of the autopilot"},
    {"time_boot_ms", "ms", "the vehicle's clock when last heard"},
    {"last_heard", nil, "time of the last frame"},
    {"links", nil, "ids of the links that hear it, the latest first"},
    {"collision", nil, "`time`, `sign` and `links` while two vehicles use the id"},
    {"signing", nil, "state of signing, if there is a key (signing.md)"},
    {"streams", nil, "a list of the messages that are wanted:"},
    {"streams.id", nil, "message id"},
    {"streams.message", nil, "message name"},
    {"streams.state", nil,
     "new, asked, query, ok, short (too slow), missing, yielded (left to another program)"},
    {"streams.wanted_hz", "1/s", "wanted rate; null: any rate"},
    {"streams.asked_hz", "1/s", "requested rate"},
    {"streams.measured_hz", "1/s", "measured rate"},
    {"gcs", nil, "ground stations, and the vehicle's failsafe for a lost one:"},
    {"gcs.known_by", nil, "ids of the ground stations heard within a minute"},
    {"gcs.failsafe_gcs", nil, "the id that the failsafe listens to; null if unknown or any"},
    {"gcs.failsafe_range", nil, "lowest and highest id that it listens to"},
    {"gcs.heard_gcs", nil, "id of the station whose heartbeat last kept it quiet"},
    {"gcs.last_heard", nil, "time of that heartbeat"},
    {"gcs.quiet", nil, "whether it is kept quiet now"},
    {"gcs.enabled", nil, "whether it is enabled"},
    {"gcs.timeout_s", "s", "the silence after which it acts"},
    {"gcs.kept_by_gateway", nil, "whether the gateway's own heartbeat keeps it quiet"},
    {"gcs.withheld", nil,
     "whether the gateway withholds its heartbeat so as not to be taken for a ground station"},
    {"gcs.params", nil, "the parameters that this is known from"},
    {"gcs.stations", nil, "what else sends heartbeats on the network:"},
    {"gcs.stations.system", nil, "system id"},
    {"gcs.stations.component", nil, "component id"},
    {"gcs.stations.type", nil, "MAV_TYPE; 6 is a ground station"},
    {"gcs.stations.via", nil, "link or client that it is heard by"},
    {"gcs.stations.last_heard", nil, "time of its last heartbeat"},
    {"gcs.stations.keeps", nil, "whether the failsafe listens to it"},
    {"clock", nil, "the vehicle's clock, by TIMESYNC:"},
    {"clock.offset_s", "s", "the vehicle's clock minus the gateway's"},
    {"clock.error_s", "s", "largest error of the offset"},
    {"clock.round_trip_s", "s", "round trip of the best measurement"},
    {"clock.boot", nil, "the time at which the clock was 0"},
    {"clock.time", nil, "time of the last answer"},
    {"clock.samples", nil, "number of measurements"},
    {"reports", nil, "PX4's reports (EVENT):"},
    {"reports.lost", nil, "how many were lost"},
    {"reports.recent", nil,
     "the last ones, newest first: `time`, `time_boot_ms`, `text`, and the fields of the event `report`"},
    {"high_latency", nil, "high-latency links (satellites):"},
    {"high_latency.only", nil, "whether only such links reach the vehicle"},
    {"high_latency.links", nil, "ids of these links"}
  ]

  # {name, decimals, unit, meaning}
  link = [
    {"id", nil, nil, "name"},
    {"network", nil, nil, "the network that its system ids belong to"},
    {"kind", nil, nil, "udp_server, tcp_client, serial, replay …"},
    {"url", nil, nil, "connection string"},
    {"label", nil, nil, "label from the configuration"},
    {"status", nil, nil, "up; idle (nothing heard), connecting, waiting …"},
    {"text", nil, nil, "the status in words"},
    {"reason", nil, nil, "why the link is not up"},
    {"retry_in_ms", 0, "ms", "until the next try"},
    {"since", nil, nil, "time since which it has this status"},
    {"last_heard", nil, nil, "time of the last frame"},
    {"local", nil, nil, "own address, or the device"},
    {"port", nil, nil, "own port"},
    {"peer", nil, nil, "address of the peer"},
    {"peers", nil, nil, "peers of a server: `text`, `silent_ms`, `frames_in`, `bytes_in`"},
    {"signing", nil, nil, "frames rejected for their signature (signing.md)"},
    {"recording", nil, nil, "how it is recorded (recordings.md)"},
    {"overload", nil, nil, "`since` and `datagrams` while datagrams come faster than they are read"},
    {"behind", nil, nil, "`since` and `frames` while a vehicle's session does not keep up with its frames"},
    {"rates.bytes_in", 1, "B/s", "received in the last second"},
    {"rates.bytes_out", 1, "B/s", "sent"},
    {"rates.frames_in", 1, "1/s", "good frames received"},
    {"rates.writes_out", 1, "1/s", "writes: frames and batches of frames"},
    {"rates.crc_errors", 1, "1/s", "frames with a wrong checksum"},
    {"quality.score", 1, nil, "0 to 100, higher is better; the best link of a group carries"},
    {"quality.loss", 3, "0..1", "ratio of lost frames"},
    {"quality.rtt_ms", 1, "ms", "round trip"},
    {"quality.age_ms", 0, "ms", "since the last frame"},
    {"quality.group", nil, nil, "the links that are redundant with it"},
    {"quality.carries", nil, nil, "whether this link carries for the group"},
    {"counters.bytes_in", nil, "B", "received since the gateway was started, as for all counters"},
    {"counters.bytes_out", nil, "B", "sent"},
    {"counters.frames_in", nil, nil, "good frames received"},
    {"counters.writes_out", nil, nil, "writes to the transport"},
    {"counters.crc_errors", nil, nil, "frames with a wrong checksum"},
    {"counters.resync_bytes", nil, "B", "bytes outside of frames"},
    {"counters.unknown_ids", nil, nil, "frames with an unknown message id"},
    {"counters.incompatible", nil, nil, "frames with unknown incompatibility flags"},
    {"counters.lost", nil, nil, "lost frames, by their sequence numbers"},
    {"counters.reconnects", nil, nil, "connections made after the first"},
    {"counters.restarts", nil, nil, "restarts of the link's process"},
    {"counters.peers_refused", nil, nil, "peers beyond the limit"},
    {"counters.routes_refused", nil, nil, "components without a route, because their peer has too many"},
    {"counters.unclaimed", nil, nil, "frames of systems without a vehicle"},
    {"counters.overload", nil, nil, "frames that a vehicle's session could not keep up with"},
    {"counters.refused", nil, nil, "frames of vehicles beyond limits.max_vehicles"},
    {"counters.looped", nil, nil, "our own frames that came back"},
    {"counters.dropped_out", nil, nil, "writes that could not be sent"},
    {"counters.kernel_dropped", nil, nil, "datagrams that the kernel's buffer had no room for"},
    {"counters.shed", nil, nil, "datagrams dropped because too many waited"},
    {"counters.shed_new", nil, nil, "the same, of senders that were not heard before the overload"},
    {"counters.denied", nil, nil, "commands of endpoints that may not send them"},
    {"counters.withheld", nil, nil, "heartbeats and measurements withheld from vehicles"}
  ]

  fields = fn rows -> for {name, unit, meaning} <- rows, do: %{name: name, unit: unit, meaning: meaning} end
  @both fields.(both)
  @rest fields.(rest)
  @link fields.(for {name, _decimals, unit, meaning} <- link, do: {name, unit, meaning})
  @link_decimals (for {name, decimals, _unit, _meaning} <- link, decimals != nil, into: %{} do
                    {name |> String.split(".") |> List.last() |> String.to_atom(), decimals}
                  end)

  @doc "The fields of `state.sock` and `/api/status`."
  @spec short() :: [field()]
  def short, do: @both

  @doc "The fields that `GET /api/vehicles/ID` adds."
  @spec long() :: [field()]
  def long, do: @rest

  @doc "The fields of a link in `GET /api/links`."
  @spec link() :: [field()]
  def link, do: @link

  @doc "A link with rounded numbers."
  @spec rounded_link(map()) :: map()
  def rounded_link(link), do: Round.object(link, @link_decimals)
end
