defmodule Aerie.Config.Keys do
  @moduledoc """
  The schema: every key of the configuration, with type, limits, default and meaning. The checks, the environment
  variables, `config/gateway.example.yaml` and `Aerie.Config.default/1` all come from here and from nowhere else.
  """

  import Aerie.Config.Field, only: [field: 3, field: 4, section: 3]

  alias Aerie.Config.{Field, Types}
  alias Aerie.Link.Serial.Detector

  @groups [
    position: {:time, 1.0, %{}, 30.0},
    attitude: {:time, 1.0, %{}, 30.0},
    velocity: {:time, 1.0, %{}, 30.0},
    battery: {:threshold, 1.0, %{"remaining" => 0.01}, 30.0},
    gps: {:change, 0.5, %{}, 30.0},
    mode: {:change, 10.0, %{}, 30.0},
    health: {:change, 1.0, %{}, 30.0},
    home: {:change, 1.0, %{}, 60.0},
    mission: {:change, 1.0, %{}, 60.0},
    rc: {:time, 0.2, %{}, 60.0},
    link: {:aggregate, 0.2, %{}, 60.0}
  ]

  @save_on ~w(failsafe gcs_failsafe geofence battery.low battery.critical link.lost reboot collision mission.completed
              armed disarmed takeoff landed signing.rejected)a

  @doc "The names of the state groups."
  @spec groups() :: [atom()]
  def groups, do: Keyword.keys(@groups)

  @doc "All keys."
  @spec fields() :: [Field.t()]
  def fields do
    [
      field(
        :vehicle_id,
        Types.token(),
        """
        Companion: the public name of the one vehicle aboard which this gateway runs; it is the vehicle with system id
        mavlink.system_id on the default network. Hub: leave it out and name vehicles under vehicles.
        """,
        example: "VID-001"
      ),
      field(:environment, Types.token(), "Second word of every NATS subject: fleet.{environment}.{vehicle}.…",
        default: "dev"
      ),
      field(:network, Types.token(), "The network of links and vehicles that name none.", default: "main"),
      mavlink(),
      field(
        :links,
        {:list, {:section, link_fields()}},
        """
        The physical ways to vehicles. url is a connection string as pymavlink has them:
          udpin:HOST:PORT   listen for UDP          udpout:HOST:PORT  send UDP to
          tcpin:HOST:PORT   listen for TCP          tcp:HOST:PORT     connect by TCP
          DEVICE,BAUD       serial port             replay:FILE.tlog  a recording
          serial:DEVICE     serial port whose baud rate is found by listening
          serial:auto       the first serial port that a vehicle is heard on (see serial)
        id (else the string), network, label, high_latency and enabled may be left out. secure: true marks a cable that
        nobody else can hear: a vehicle may be given its signing key there, and is believed without one.
        """,
        default: [],
        example:
          ~S([{id: radio-1, url: "/dev/ttyUSB0,57600", network: main, label: "433 MHz mast", enabled: true}])
      ),
      field(
        :clients,
        {:list, {:section, client_fields()}},
        """
        Where ground stations and other programs come in: udpin, udpout, udpbcast:ADDRESS:PORT, tcpin, tcp, or a DEVICE.
        Left out: TCP on 127.0.0.1, port 5790 or the next free one. [] for none. A ground station that calls a link (UDP
        14550) is taken for a client by itself, for as long as no autopilot is heard from there.
        """,
        default: nil,
        example:
          ~S([{id: field-laptop, url: "udpout:192.168.1.20:14550", rate_limits: {ATTITUDE: 4}, filter_out: {block_messages: [RAW_IMU]}}])
      ),
      router(),
      field(
        :vehicles,
        {:list, {:section, vehicle_fields()}},
        """
        Public names of vehicles. One that is not listed is named after its network and system id.
        """,
        default: [],
        example: "[{id: VID-007, network: main, system_id: 7}]"
      ),
      signing(),
      recorder(),
      nats(),
      outbox(),
      sampling(),
      section(:events, "When a value is an event.", [
        field(:battery_low, {:number, 0, 1}, "Remaining charge (0 to 1) below which battery.low is given.",
          default: 0.25
        ),
        field(:battery_critical, {:number, 0, 1}, "… and battery.critical.", default: 0.1)
      ]),
      policy(),
      section(:http, "The console, REST, metrics and health on one port.", [
        field(:enabled, :boolean, "Serve HTTP at all.", default: true),
        field(:address, Types.ip(), "Address to listen on. Beyond loopback only with a password or key set.",
          default: "127.0.0.1"
        ),
        field(
          :port,
          {:integer, 0, 65_535},
          """
          Port. Taken: an error if given here, the next free one if not. 0: any free one.
          """,
          default: 4000
        )
      ]),
      api(),
      websocket(),
      sockets(),
      serial(),
      timeouts(),
      limits()
    ]
  end

  defp mavlink do
    section(:mavlink, "The MAVLink side.", [
      field(
        :local_addr,
        Types.listen_address(),
        """
        UDP address on which vehicles and routers call in; off for none. Left out: ":14550", unless links are given.
        """,
        example: ~S(":14550")
      ),
      field(
        :system_id,
        {:integer, 1, 4_294_967_295},
        """
        System id of this gateway. Companion (vehicle_id given): the vehicle's own, 1 if left out.
        Hub: one from the top, 245 if left out. 255 is the ground station's: refused without i_am_the_gcs.
        """,
        example: "245"
      ),
      field(
        :component_id,
        {:integer, 1, 255},
        """
        Component id of this gateway. 191 is the on-board computer; 1 is the autopilot's and collides with it.
        """,
        default: 191
      ),
      field(
        :i_am_the_gcs,
        :boolean,
        """
        This gateway stands for the operator's ground station: its heartbeat may keep a vehicle's ground-station failsafe
        quiet. Only where losing this gateway means that the operator is lost too. Allows system_id 255 and heartbeat_type
        gcs.
        """,
        default: false
      ),
      field(
        :heartbeat,
        :boolean,
        """
        Send a heartbeat once a second to each vehicle, as long as all loops of the gateway answer.
        """,
        default: true
      ),
      field(
        :heartbeat_type,
        {:enum, [:onboard_controller, :gcs]},
        """
        What the heartbeat says we are. PX4 takes any heartbeat of a gcs for its operator's. Left out: onboard_controller,
        or gcs with i_am_the_gcs.
        """,
        example: "onboard_controller"
      ),
      field(
        :heartbeat_deadman_s,
        {:number, 0.5, 60},
        """
        No heartbeat goes out while a loop that it stands for has not answered for this long.
        """,
        default: 3.0
      ),
      field(
        :request_streams,
        :boolean,
        """
        Ask vehicles for state messages that do not come by themselves, and for what clients want.
        """,
        default: true
      ),
      field(
        :streams,
        {:map, {:number, 0, 400}},
        """
        Messages that every vehicle is to send at least this often (per second), by their names.
        """,
        default: %{},
        example: "{ATTITUDE: 10, GLOBAL_POSITION_INT: 5}"
      ),
      field(
        :timesync_s,
        {:number, 0, 3600},
        "Time between two measurements of a vehicle's clock (TIMESYNC); 0: none.",
        default: 10.0
      ),
      field(
        :read_gcs_parameters,
        :boolean,
        """
        Read once from each vehicle which ground station its failsafe listens to (a handful of parameters).
        """,
        default: true
      ),
      field(
        :dialects,
        {:list, {:enum, [:all, :upstream, :ardupilot, :common]}},
        """
        Message definitions that are understood: all, upstream (PX4), ardupilot, common.
        """,
        default: [:all]
      ),
      field(:sysid32, :boolean, "Understand frames with 32-bit system ids (a draft of the standard).",
        default: false
      )
    ])
  end

  defp link_fields do
    [
      field(:id, Types.token(), "Name of the link; its connection string if left out."),
      field(:url, Types.link_url(), "Connection string.", required: true),
      field(:network, Types.token(), "System ids are unique within a network."),
      field(:label, :string, "Words for people."),
      field(
        :high_latency,
        :boolean,
        "A satellite link or the like: commands only, no parameters, streams or heartbeats.",
        default: false
      ),
      field(:enabled, :boolean, "Open it.", default: true),
      field(:secure, :boolean, "A cable that nobody else can hear: signing keys may go over it.",
        default: false
      ),
      field(
        :group,
        Types.token(),
        "Redundant links to the same vehicles share a group: the best one carries."
      ),
      field(
        :carry,
        {:map, :string},
        "For a group: the link that carries a class (control, ack, state, transfer, bulk), or all."
      )
    ] ++ rule_fields()
  end

  @doc "The keys of one of `clients`."
  @spec client_fields() :: [Field.t()]
  def client_fields do
    [
      field(:id, Types.token(), "Name of the client; its connection string if left out."),
      field(:url, Types.link_url(), "Connection string.", required: true),
      field(
        :networks,
        {:one_or_list, Types.token()},
        "Networks that it sees. Where two have the same system id, it sees the one that is named first.",
        default: []
      ),
      field(:label, :string, "Words for people."),
      field(:enabled, :boolean, "Open it.", default: true),
      field(:role, {:enum, [:full, :read_only]}, "read_only: nothing that it says goes to anyone.",
        default: :full
      ),
      field(:sniffer, :boolean, "It gets what is addressed to others, too.", default: false),
      field(:coalesce, :boolean, "Several frames that are there at once may share a datagram.",
        default: true
      ),
      field(:queue_frames, {:integer, 1, 100_000}, "Frames that wait for one that does not keep up.",
        default: 1000
      ),
      field(:queue_kb, {:integer, 1, 65_536}, "… and kilobytes.", default: 256)
    ] ++ rule_fields()
  end

  # What holds for links and clients alike.
  defp rule_fields do
    [
      section(:filter_in, "What may come from it: by message name, system, component.", filter_fields()),
      section(
        :filter_out,
        "What may go to it; sources are the links and clients that it comes from.",
        filter_fields() ++ sources()
      ),
      field(
        :rate_limits,
        {:map, {:number, 0, 10_000}},
        "Messages by name, and how often a second each goes to it.",
        default: %{}
      ),
      field(
        :bytes_per_s,
        {:integer, 50, 1_000_000_000},
        """
        Bytes a second that may go to each of its peers; what is important goes first. A serial line's own if left out.
        """
      )
    ]
  end

  defp filter_fields do
    for {name, type} <- [
          messages: :string,
          systems: {:integer, 0, 4_294_967_295},
          components: {:integer, 0, 255}
        ],
        kind <- ["allow", "block"],
        do: field(:"#{kind}_#{name}", {:one_or_list, type}, "", default: [])
  end

  defp sources,
    do: for(key <- [:allow_sources, :block_sources], do: field(key, {:one_or_list, :string}, "", default: []))

  defp router do
    section(:router, "How frames go from one to the other.", [
      field(
        :between_vehicles,
        {:enum, [:auto, :all, :heartbeats, :none]},
        """
        What vehicles hear of what other vehicles say to everybody: all, heartbeats, none; auto: all where at most 8
        vehicles' ways are in a network, else heartbeats. What is addressed to a vehicle always goes there.
        """,
        default: :auto
      )
    ])
  end

  defp signing do
    section(:signing, "Signed MAVLink links.", [
      field(
        :keys,
        {:list, {:section, key_fields()}},
        """
        One key per vehicle or per network. Each entry names its key by key_file (a file that only its owner can read) or
        key_env (an environment variable): 64 hexadecimal digits, base64 of 32 bytes, or a passphrase. system_id left out
        means every system of the network that has no entry of its own. policy: required (what is not signed rightly is
        refused), accept_unsigned (UNSAFE: what is not signed is taken in) or off. allow_unsigned are message ids that
        need no signature: RADIO_STATUS (109), which radios send themselves.
        """,
        default: [],
        example:
          ~S([{network: main, system_id: 7, key_file: "/etc/aerie/keys/vid-007.key", policy: required}])
      ),
      field(:dir, :path, "Folder of the time stamps of signed links; no keys are in it.",
        default: "var/signing"
      )
    ])
  end

  defp recorder do
    section(:recorder, "Recordings (tlog files) of links and vehicles, without keys and signatures.", [
      field(:dir, :path, "Folder; made when the first recording begins.", default: "var/recordings"),
      field(
        :links,
        {:enum, [:off, :armed, :always]},
        "Record each link: armed means while a vehicle on it is armed.",
        default: :off
      ),
      field(
        :vehicles,
        {:enum, [:off, :armed, :always]},
        "Record each vehicle, by whatever links it is heard.",
        default: :off
      ),
      field(:sent, :boolean, "Record what is sent to vehicles as well.", default: true),
      field(:max_file_mb, {:number, 0.01, 4096}, "Size at which a recording goes on in a new file.",
        default: 64.0
      ),
      field(:max_file_minutes, {:number, 0.1, 10_080}, "Time after which it does.", default: 60.0),
      field(
        :max_mb,
        {:number, 0.1, 1_048_576},
        "Size of our recordings together; the oldest of ours go first.",
        default: 2048.0
      ),
      field(
        :min_free_mb,
        {:number, 0, 1_048_576},
        """
        What is to stay free on the disk: our oldest recordings are removed for it, and when that does not help nothing is
        recorded.
        """,
        default: 512.0
      ),
      field(
        :queue_kb,
        {:integer, 64, 1_048_576},
        "What may wait for the disk, for each recording; beyond it records are dropped and counted.",
        default: 4096
      ),
      field(
        :after_s,
        {:number, 0, 3600},
        "How long a recording goes on after disarming, or after the event that it is saved for.",
        default: 30.0
      ),
      field(
        :fsync,
        {:enum, [:always, :interval, :never]},
        "When data is forced to the disk: always (after each write), interval (once a second), never.",
        default: :interval
      ),
      section(
        :ring,
        "The last moments of each vehicle, in memory, saved when something happens or on request.",
        [
          field(:enabled, :boolean, "Keep them.", default: true),
          field(:seconds, {:number, 1, 3600}, "How far back, if max_kb is enough for it.", default: 120.0),
          field(:max_kb, {:integer, 16, 1_048_576}, "Memory for one vehicle.", default: 2048),
          field(
            :total_mb,
            {:number, 0.1, 65_536},
            "Memory for all vehicles; with many of them each has less.",
            default: 128.0
          ),
          field(:save_on, {:list, {:enum, @save_on}}, "Events on which the ring is saved; [] for none.",
            default: [:failsafe, :gcs_failsafe, :"battery.critical", :geofence]
          )
        ]
      )
    ])
  end

  defp key_fields do
    [
      field(:network, Types.token(), "Its network."),
      field(:system_id, {:integer, 1, 4_294_967_295}, "Its MAVLink system id."),
      field(:key_file, :path, "File with the key."),
      field(:key_env, :string, "Environment variable with the key."),
      field(:policy, {:enum, [:required, :accept_unsigned, :off]}, "What is asked of frames.",
        default: :required
      ),
      field(:allow_unsigned, {:list, {:integer, 0, 16_777_215}}, "Message ids.", default: [109])
    ]
  end

  defp vehicle_fields do
    [
      field(:id, Types.token(), "Public name.", required: true),
      field(:network, Types.token(), "Its network."),
      field(:system_id, {:integer, 1, 4_294_967_295}, "Its MAVLink system id.", required: true)
    ]
  end

  defp nats do
    section(:nats, "The NATS side.", [
      field(
        :mode,
        {:enum, [:embedded, :url, :off]},
        """
        embedded: start and supervise a nats-server of our own. url: use the servers at nats.url.
        off: no NATS; events stay in memory.
        Left out: url if nats.url is given, else embedded.
        """,
        example: "embedded"
      ),
      field(:url, {:one_or_list, Types.nats_url()}, "Server, or a list of servers that are tried in turn.",
        default: [],
        example: ~S("nats://localhost:4222")
      ),
      field(:credentials, :path, "Credentials file (user JWT and nkey seed).",
        example: ~S("/etc/gateway/vehicle.creds")
      ),
      field(:nkey_seed_file, :path, "File with an nkey seed (SU…).", example: ~S("/etc/gateway/vehicle.nk")),
      field(:user, :string, "User name, with nats.password.", example: "gateway"),
      field(:password, :secret, "Password. Better given by the environment than in a file.",
        example: "secret"
      ),
      field(:token, :secret, "Authentication token.", example: "secret"),
      section(:tls, "TLS to the servers at nats.url.", [
        field(:enabled, :boolean, "Use TLS; a tls:// URL means it too.", default: false),
        field(
          :ca_file,
          :path,
          "Certificates of the authorities that are trusted (PEM); the system's if left out.",
          example: ~S("/etc/gateway/ca.pem")
        ),
        field(:cert_file, :path, "This gateway's certificate (PEM).",
          example: ~S("/etc/gateway/gateway.pem")
        ),
        field(:key_file, :path, "The certificate's private key (PEM).",
          example: ~S("/etc/gateway/gateway.key")
        ),
        field(:server_name, :string, "Name expected in the server's certificate; the URL's host if left out.",
          example: "nats.example.org"
        ),
        field(:verify, :boolean, "Check the server's certificate.", default: true)
      ]),
      field(:address, Types.ip(), "Embedded: address to listen on.", default: "127.0.0.1"),
      field(
        :port,
        {:integer, 0, 65_535},
        """
        Embedded: port. Taken: an error if given here, the next free one if not. 0: any free one.
        """,
        default: 4222
      ),
      field(:store_dir, :path, "Embedded: folder of the server's data, configuration and log.",
        default: "var/nats"
      ),
      field(:max_memory_mb, {:integer, 1, 65_536}, "Embedded: memory that JetStream may use.", default: 64),
      field(:max_store_mb, {:integer, 1, 1_048_576}, "Embedded: disk that JetStream may use.", default: 2048),
      field(:binary, :path, "Embedded: the server's program.", default: "nats-server"),
      field(:connect_timeout_s, {:number, 0.1, 60}, "How long one attempt to connect may take.",
        default: 3.0
      ),
      field(
        :retry_min_ms,
        {:integer, 10, 60_000},
        "Pause after the first failed attempts; doubled each time.",
        default: 250
      ),
      field(:retry_max_ms, {:integer, 10, 600_000}, "The longest pause between attempts.", default: 30_000),
      section(:streams, "The JetStream streams, made if they are not there.", [
        field(
          :state_max_mb,
          {:integer, 1, 1_048_576},
          "Size of FLEET_STATE, the last value of each state group.",
          default: 64
        ),
        field(:event_max_mb, {:integer, 1, 1_048_576}, "Size of FLEET_EVENTS; the oldest events go first.",
          default: 512
        ),
        field(
          :event_max_age_days,
          {:number, 0, 3650},
          "Age at which events go; 0 keeps them until size decides.",
          default: 30.0
        ),
        field(
          :duplicate_window_s,
          {:integer, 1, 86_400},
          """
          How long the server knows an event's id and drops a second copy. Past it, an event whose confirmation was lost
          with the connection is in the stream twice (with the same id).
          """,
          default: 3600
        ),
        field(:replicas, {:integer, 1, 5}, "Copies in a cluster.", default: 1)
      ])
    ])
  end

  defp outbox do
    section(:outbox, "Events wait here on disk while NATS is away.", [
      field(:dir, :path, "Folder.", default: "var/outbox"),
      field(:max_mb, {:integer, 1, 65_536}, "Size; the oldest events go first, and are counted.",
        default: 64
      ),
      field(:segment_kb, {:integer, 4, 65_536}, "Size of one file in it.", default: 1024),
      field(
        :fsync,
        {:enum, [:always, :interval, :never]},
        """
        When data is forced to the disk: always (after each write), interval, never (left to the system).
        """,
        default: :interval
      ),
      field(:fsync_interval_ms, {:integer, 10, 60_000}, "For interval.", default: 1000)
    ])
  end

  defp sampling do
    section(:sampling, "How often each group of a vehicle's state is published. Full rate stays inside.", [
      field(:position_hz, {:number, 0.001, 100}, "Short for groups.position.hz.", default: 1.0),
      field(:attitude_hz, {:number, 0.001, 100}, "Short for groups.attitude.hz.", default: 1.0),
      field(
        :battery_change_threshold,
        {:number, 0, 1},
        """
        Battery is published when its remaining charge (0 to 1) has changed by this; short for
        groups.battery.threshold.remaining.
        """,
        default: 0.01
      ),
      section(
        :groups,
        """
        Strategies: time (mean over each period), change (when a value differs), threshold (when a value named under
        threshold has moved by its amount), aggregate (min, max and mean over each period). hz is the rate, for change
        and threshold the highest one. After refresh_s seconds a value is published even if nothing moved; 0: never.
        """,
        Enum.map(@groups, &group/1)
      )
    ])
  end

  defp group({name, {strategy, hz, threshold, refresh}}) do
    section(name, "", [
      field(:strategy, {:enum, [:time, :change, :threshold, :aggregate]}, "", default: strategy),
      field(:hz, {:number, 0.001, 100}, "", default: hz),
      field(:threshold, {:map, {:number, 0, 1_000_000_000}}, "", default: threshold),
      field(:refresh_s, {:number, 0, 86_400}, "", default: refresh)
    ])
  end

  defp policy do
    section(
      :policy,
      "Limits on what commands may ask for. Read and checked; nothing in this version applies them yet.",
      [
        field(
          :max_altitude,
          {:number, 0, 100_000},
          "Highest altitude above home that is passed on, m. Left out: no limit.",
          example: "120"
        ),
        field(:geofence_file, :path, "JSON file of the fence that goto targets must be inside.",
          example: ~S("/etc/gateway/geofence.json")
        )
      ]
    )
  end

  defp api do
    section(
      :api,
      """
      Who may use /api and the WebSocket. Without a key only programs on this machine may, and pages that it serves.
      """,
      [
        field(
          :key,
          :secret,
          "The key that goes into the header X-Aerie-Key, 16 characters or more. Better by AERIE_API_KEY than in a file.",
          example: "a-long-random-text"
        ),
        field(
          :keys_file,
          :path,
          """
          File of further keys, one a line, as KEY or NAME KEY, # for comments; only its owner may be able to read it.
          """,
          example: ~S("/etc/aerie/keys")
        ),
        field(
          :origins,
          {:list, Types.origin()},
          """
          Web pages of other servers that may use /api and the WebSocket, as SCHEME://HOST[:PORT]; they need a key all the same.
          """,
          default: [],
          example: ~S(["https://gcs.example.org"])
        )
      ]
    )
  end

  defp websocket do
    section(:websocket, "MAVLink frames over WebSocket, for ground stations in a browser.", [
      field(:enabled, :boolean, "Serve it.", default: true),
      field(:address, Types.ip(), "Address to listen on. Beyond loopback only with a key (api) and TLS.",
        default: "127.0.0.1"
      ),
      field(
        :port,
        {:integer, 0, 65_535},
        "Port. Taken: an error if given here, the next free one if not. 0: any free one.",
        default: 8765
      ),
      field(:max_clients, {:integer, 1, 10_000}, "Clients at a time; further ones are refused.", default: 32),
      field(:cert_file, :path, "Certificate (PEM, with its chain); with it the server speaks wss only.",
        example: ~S("/etc/aerie/gateway.pem")
      ),
      field(:key_file, :path, "The certificate's private key (PEM).", example: ~S("/etc/aerie/gateway.key"))
    ])
  end

  defp sockets do
    section(
      :sockets,
      "Unix sockets for programs on this machine: state.sock (JSON lines) and mavlink.sock (frames).",
      [
        field(:enabled, :boolean, "Open them.", default: true),
        field(
          :dir,
          :path,
          "Folder. Left out: $XDG_RUNTIME_DIR/aerie, /run/aerie, or var/run. Who may use them is what its permissions say.",
          example: ~S("/run/aerie")
        ),
        field(:state_hz, {:number, 0.1, 50}, "How often state.sock tells every vehicle's state.",
          default: 10.0
        ),
        field(:max_clients, {:integer, 1, 10_000}, "Clients of each socket; further ones are refused.",
          default: 32
        )
      ]
    )
  end

  defp serial do
    section(
      :serial,
      "Where links with the url serial:auto and serial:DEVICE listen. Nothing is written while they do.",
      [
        field(
          :ports,
          {:list, :string},
          """
          Ports that are listened to before any others: names in /dev or paths. Those of the machine itself (ttyAMA0, ttyTHS1,
          ttyS0) are only listened to when they are named here; then /dev/serial/by-id/*, ttyACM* and ttyUSB* follow.
          """,
          default: [],
          example: "[/dev/ttyTHS1]"
        ),
        field(
          :bauds,
          {:list, {:integer, 50, 20_000_000}},
          "Baud rates that are tried, in this order; 20 at most.",
          default: Detector.bauds()
        )
      ]
    )
  end

  defp timeouts do
    section(:timeouts, "When silence means something.", [
      field(:vehicle_stale_s, {:number, 0.1, 3600}, "A vehicle without a heartbeat for this long is stale.",
        default: 3.0
      ),
      field(:vehicle_lost_s, {:number, 0.1, 86_400}, "… and lost after this long.", default: 5.0),
      field(
        :vehicle_lost_high_latency_s,
        {:number, 1, 86_400},
        "A vehicle that is heard by high-latency links only is lost after this long.",
        default: 180.0
      ),
      field(:link_idle_s, {:number, 0.1, 86_400}, "A link that hears nothing for this long is idle.",
        default: 10.0
      )
    ])
  end

  defp limits do
    section(:limits, "What bounds memory when a radio (or somebody) makes vehicles up.", [
      field(:max_vehicles, {:integer, 1, 100_000}, "Vehicles; further ones are counted and ignored.",
        default: 250
      ),
      field(:max_links, {:integer, 1, 10_000}, "Links.", default: 64),
      field(:max_clients, {:integer, 1, 10_000}, "Client endpoints.", default: 64),
      field(:max_peers, {:integer, 1, 100_000}, "Peers of one listening link.", default: 256),
      field(:max_events_in_flight, {:integer, 1, 10_000}, "Events sent to NATS and not yet confirmed.",
        default: 64
      )
    ])
  end
end
