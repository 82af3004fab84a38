defmodule Aerie.Vehicle.Fields.Object do
  @moduledoc """
  What is said about a vehicle besides the groups of its state (the object of `state.sock` and `/api/status`, and what
  `GET /api/vehicles/ID` has beyond that), and about a link. For `docs/telemetry.md`.
  """

  alias Aerie.Vehicle.Fields.Round

  @typedoc "`name` with dots for what is below something; `unit` nil for what has none."
  @type field :: %{name: String.t(), unit: String.t() | nil, meaning: String.t()}

  both = [
    {"timestamp", "s", "unix time of the answer"},
    {"vehicle", nil, "public name; null in the one line of `state.sock` while there is no vehicle"},
    {"network", nil, "the space of system ids that it is in"},
    {"system_id", nil, "its MAVLink system id"},
    {"status", nil, "online; stale or lost after a silence"},
    {"age", "s", "since it was last heard"},
    {"fc_connected", nil, "true while it is online"},
    {"fc_port", nil, "device or address of the link that it was last heard on"},
    {"fc_baud", "1/s", "rate of a serial link"},
    {"autopilot", nil, "ardupilot, px4, …"},
    {"type", nil, "copter, plane, rover, …"},
    {"armed", nil, "as in the group mode"},
    {"in_air", nil, "as in the group mode"},
    {"mode", nil, "as in the group mode"},
    {"attitude", nil, "roll, pitch, yaw of the group"},
    {"position", nil, "lat, lon, alt_msl, alt_rel, heading of the group"},
    {"velocity", nil, "groundspeed, airspeed, climb of the group"},
    {"battery", nil, "voltage, current, remaining of the group"},
    {"gps", nil, "fix, satellites, hdop of the group"},
    {"ages", "s", "how old each of these five is"}
  ]

  rest = [
    {"recording", nil, "how it is recorded (recordings.md); also in `/api/status`"},
    {"groups", nil, "all groups of its state: `time`, `age`, `time_boot_ms`, `data`"},
    {"firmware", nil, "its version"},
    {"capabilities", nil, "bits of MAV_PROTOCOL_CAPABILITY"},
    {"uid", nil, "its hardware's own id"},
    {"component", nil, "component id of its autopilot"},
    {"time_boot_ms", "ms", "its clock as last heard"},
    {"last_heard", nil, "a time"},
    {"links", nil, "ids of the links that it is heard on, the latest first"},
    {"collision", nil, "`time`, `sign` and `links` while two vehicles use its id"},
    {"signing", nil, "how it is heard where there is a key (signing.md)"},
    {"streams", nil, "a list of the messages that are wanted of it:"},
    {"streams.id", nil, "message id"},
    {"streams.message", nil, "its name"},
    {"streams.state", nil, "new, asked, ok, short (comes too rarely), yielded (left to somebody else)"},
    {"streams.wanted_hz", "1/s", "what is wanted at least; null: at any rate"},
    {"streams.asked_hz", "1/s", "what it was asked for"},
    {"streams.measured_hz", "1/s", "what comes"},
    {"gcs", nil, "ground stations and its failsafe:"},
    {"gcs.known_by", nil, "ids of ground stations that were heard within a minute"},
    {"gcs.failsafe_gcs", nil, "the id that its failsafe listens to; null when unknown or any"},
    {"gcs.failsafe_range", nil, "both ends of the ids that it listens to"},
    {"gcs.heard_gcs", nil, "who kept it quiet last"},
    {"gcs.last_heard", nil, "when that was, a time"},
    {"gcs.quiet", nil, "whether it is kept quiet now"},
    {"gcs.enabled", nil, "whether it is switched on"},
    {"gcs.timeout_s", "s", "after what silence it acts"},
    {"gcs.kept_by_gateway", nil, "whether the gateway's own heartbeat keeps it quiet"},
    {"gcs.withheld", nil,
     "whether the gateway keeps its heartbeat back, not to be taken for a ground station"},
    {"gcs.params", nil, "parameters that this is known from"},
    {"gcs.stations", nil, "what else sends heartbeats on its network:"},
    {"gcs.stations.system", nil, "system id"},
    {"gcs.stations.component", nil, "component id"},
    {"gcs.stations.type", nil, "MAV_TYPE; 6 is a ground station"},
    {"gcs.stations.via", nil, "link or client that it was heard by"},
    {"gcs.stations.last_heard", nil, "a time"},
    {"gcs.stations.keeps", nil, "whether the failsafe listens to it"},
    {"clock", nil, "its clock, by TIMESYNC:"},
    {"clock.offset_s", "s", "its clock minus ours"},
    {"clock.error_s", "s", "how far off that may be"},
    {"clock.round_trip_s", "s", "of the best measurement"},
    {"clock.boot", nil, "the time at which its clock was 0"},
    {"clock.time", nil, "when it answered last"},
    {"clock.samples", nil, "how many measurements this is from"},
    {"reports", nil, "what PX4 says by EVENT:"},
    {"reports.lost", nil, "how many did not come"},
    {"reports.recent", nil,
     "the last ones, newest first: `time`, `time_boot_ms`, `text`, and the fields of the event report"},
    {"high_latency", nil, "slow links (satellites):"},
    {"high_latency.only", nil, "whether no other link reaches it"},
    {"high_latency.links", nil, "ids of those that are slow"}
  ]

  # {name, decimals, unit, meaning}
  link = [
    {"id", nil, nil, "its name"},
    {"network", nil, nil, "the space of system ids that it belongs to"},
    {"kind", nil, nil, "udp_server, tcp_client, serial, replay …"},
    {"url", nil, nil, "its connection string"},
    {"label", nil, nil, "words of the configuration"},
    {"status", nil, nil, "up; idle (nothing heard), connecting, waiting …"},
    {"text", nil, nil, "the same in words"},
    {"reason", nil, nil, "why it is not up"},
    {"retry_in_ms", 0, "ms", "until it is tried again"},
    {"since", nil, nil, "a time: since when it has this status"},
    {"last_heard", nil, nil, "a time"},
    {"local", nil, nil, "its own address, or the device"},
    {"port", nil, nil, "its own port"},
    {"peer", nil, nil, "the other end"},
    {"peers", nil, nil, "other ends of a server: `text`, `silent_ms`, `frames_in`, `bytes_in`"},
    {"signing", nil, nil, "what is refused for its signature (signing.md)"},
    {"recording", nil, nil, "how it is recorded (recordings.md)"},
    {"overload", nil, nil, "`since` and `datagrams` while they come faster than they are read"},
    {"rates.bytes_in", 1, "B/s", "received in the last second"},
    {"rates.bytes_out", 1, "B/s", "sent"},
    {"rates.frames_in", 1, "1/s", "good frames received"},
    {"rates.writes_out", 1, "1/s", "frames and bundles of them sent"},
    {"rates.crc_errors", 1, "1/s", "damaged frames received"},
    {"quality.score", 1, nil, "0 to 100, better is more; it is what links of a group are chosen by"},
    {"quality.loss", 3, "0..1", "share of frames that did not come"},
    {"quality.rtt_ms", 1, "ms", "round trip"},
    {"quality.age_ms", 0, "ms", "since the last frame"},
    {"quality.group", nil, nil, "the links that it is redundant with"},
    {"quality.carries", nil, nil, "whether it is the one that carries"},
    {"counters.bytes_in", nil, "B", "received since the gateway's start, as all counters"},
    {"counters.bytes_out", nil, "B", "sent"},
    {"counters.frames_in", nil, nil, "good frames received"},
    {"counters.writes_out", nil, nil, "writes to its transport"},
    {"counters.crc_errors", nil, nil, "frames with a wrong checksum"},
    {"counters.resync_bytes", nil, "B", "bytes that belong to no frame"},
    {"counters.unknown_ids", nil, nil, "frames of messages that no dialect has"},
    {"counters.incompatible", nil, nil, "frames with flags that nobody knows"},
    {"counters.lost", nil, nil, "frames that did not come, by their sequence numbers"},
    {"counters.reconnects", nil, nil, "connections made after the first"},
    {"counters.restarts", nil, nil, "restarts of its process"},
    {"counters.peers_refused", nil, nil, "peers beyond the limit"},
    {"counters.unclaimed", nil, nil, "frames of a system that is no known vehicle"},
    {"counters.overload", nil, nil, "frames that a vehicle could not keep up with"},
    {"counters.refused", nil, nil, "frames of vehicles beyond the limit"},
    {"counters.looped", nil, nil, "our own frames that came back"},
    {"counters.dropped_out", nil, nil, "writes with no way out"},
    {"counters.kernel_dropped", nil, nil, "datagrams that the kernel had no room for"},
    {"counters.shed", nil, nil, "datagrams that were too old when they could be read"},
    {"counters.denied", nil, nil, "orders of ends that may not give them"},
    {"counters.withheld", nil, nil, "heartbeats and measurements that were kept from vehicles"}
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

  @doc "Those that `GET /api/vehicles/ID` has besides."
  @spec long() :: [field()]
  def long, do: @rest

  @doc "The fields of a link in `GET /api/links`."
  @spec link() :: [field()]
  def link, do: @link

  @doc "A link as it is shown: numbers to the decimals that mean something."
  @spec rounded_link(map()) :: map()
  def rounded_link(link), do: Round.object(link, @link_decimals)
end
