defmodule Aerie.Config.Keys.Nats do
  @moduledoc "The NATS side: the server, how to reach it, and the streams."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.{Field, Types}

  @doc "The section `nats`."
  @spec section() :: Field.t()
  def section do
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
      field(
        :token,
        :secret,
        "Authentication token. Embedded: the one that clients need; a random one if left out (`url` in nats.store_dir).",
        example: "secret"
      ),
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
      field(
        :store_dir,
        :path,
        "Embedded: folder of the server's data, configuration, log, login and address (`url`).",
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
end
