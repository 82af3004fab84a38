defmodule Aerie.Fleet.Bridge.Settings do
  @moduledoc """
  The NATS side: the server, how to reach it, the streams, and where events wait. Secrets are `Aerie.Base.Secret`s until
  `Aerie.Fleet.Bridge.Connection.Settings` uses them.
  """
  use Aerie.Base.Settings

  import Aerie.Base.Settings.Rules

  alias Aerie.Fleet.Bridge.Leaf
  alias Aerie.Base.Secret
  alias Aerie.Base.Settings.{Schema, Types}

  @logins [:credentials, :nkey_seed_file, :token, :user]
  # As a key of REST.
  @shortest 16

  part :fleet, Aerie.Vehicle.Events.Journal.Settings
  part :vehicle, Aerie.Vehicle.Settings

  section ""

  setting :environment, Types.token(), "Second word of every NATS subject: fleet.{environment}.{vehicle}.…",
    default: "dev"

  setting :nats, {:section, nats_fields()}, "The NATS side."
  setting :outbox, {:section, outbox_fields()}, "Events wait here on disk while NATS is away."

  setting :port_given, :boolean, "Whether somebody asked for nats.port: then no other one is taken.",
    internal: true,
    default: false

  section "limits"

  setting :max_events_in_flight, {:integer, 1, 10_000}, "Events sent to NATS and not yet confirmed.",
    default: 64

  defp nats_fields do
    [
      field(
        :mode,
        {:enum, [:embedded, :url, :off]},
        """
        embedded: start and supervise a nats-server of our own. url: use the servers at nats.url.
        off: no NATS; events stay in memory. Nothing is kept between two starts then: what changed in between is not found, and
        the epoch is the time of the start.
        Left out: url if nats.url is given, else embedded.
        """,
        example: "embedded"
      ),
      field(:url, {:one_or_list, Types.nats_url()}, "Server, or a list of servers that are tried in turn.",
        default: [],
        example: ~S("nats://localhost:4222")
      ),
      field(:credentials, :file, "Credentials file (user JWT and nkey seed).",
        example: ~S("/etc/gateway/vehicle.creds")
      ),
      field(:nkey_seed_file, :file, "File with an nkey seed (SU…).", example: ~S("/etc/gateway/vehicle.nk")),
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
          :file,
          "Certificates of the authorities that are trusted (PEM); the system's if left out.",
          example: ~S("/etc/gateway/ca.pem")
        ),
        field(:cert_file, :file, "This gateway's certificate (PEM).",
          example: ~S("/etc/gateway/gateway.pem")
        ),
        field(:key_file, :file, "The certificate's private key (PEM).",
          example: ~S("/etc/gateway/gateway.key")
        ),
        field(:server_name, :string, "Name expected in the server's certificate; the URL's host if left out.",
          example: "nats.example.org"
        ),
        field(:verify, :boolean, "Check the server's certificate.", default: true)
      ]),
      field(:address, Types.ip(), "Embedded: loopback address to listen on, because the server has no TLS.",
        default: "127.0.0.1"
      ),
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
      field(:max_memory_mb, {:integer, 1, 65_536}, "Embedded: memory that JetStream may use.", default: 128),
      field(:max_store_mb, {:integer, 1, 1_048_576}, "Embedded: disk that JetStream may use.", default: 2048),
      field(:binary, :path, "Embedded: the server's program.", default: "nats-server"),
      field(
        :domain,
        Types.token(),
        """
        Embedded: name of this server's JetStream, not that of the hub's. Left out: with nats.leaf it is vehicle_id, or "leaf"; else
        there is none.
        """,
        example: "VID-001"
      ),
      Leaf.Config.section(),
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
        field(
          :state_storage,
          {:enum, [:memory, :file]},
          """
          Where FLEET_STATE is kept. By default: on the embedded server in memory, because values that change several times a second wear
          out a flash card, and a gateway that starts again soon gets them from its vehicles; with nats.url in a file.
          """,
          example: "file"
        ),
        field(
          :state_max_age_days,
          {:number, 0, 3650},
          "Age at which a last value goes; 0 keeps those of vehicles that are long gone.",
          default: 0.0
        ),
        field(:event_max_mb, {:integer, 1, 1_048_576}, "Size of FLEET_EVENTS; the oldest events go first.",
          default: 512
        ),
        field(
          :events_per_vehicle,
          :boolean,
          """
          For the gateway of a hub, with nats.url: each vehicle's events in a stream of their own, FLEET_EVENTS_{vehicle}, of
          event_max_mb, so that none takes another one's room. bin/nats-setup sets it. Else all are in FLEET_EVENTS.
          """,
          default: false
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
        field(
          :replicas,
          {:integer, 1, 5},
          "Copies of each stream and bucket in a cluster at nats.url: 3 of three servers outlive one of them.",
          default: 1
        )
      ])
    ]
  end

  defp outbox_fields do
    [
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
    ]
  end

  @doc """
  The mode follows from whether there is a URL. A password in a URL would be logged with it: it goes where secrets are.
  """
  @impl Aerie.Base.Settings
  def derive(%{nats: nats} = settings) do
    mode = nats.mode || if(nats.url == [], do: :embedded, else: :url)
    urls = if mode == :url and nats.url == [], do: ["nats://localhost:4222"], else: nats.url
    uris = Enum.map(urls, &URI.parse/1)
    # TLS is for the servers at nats.url.
    tls = nats.tls.enabled or (mode != :embedded and Enum.any?(uris, &(&1.scheme == "tls")))
    nats = %{nats | mode: mode, url: Enum.map(uris, &plain_url/1), tls: %{nats.tls | enabled: tls}}
    nats = %{nats | leaf: Leaf.Config.derive(nats.leaf), domain: nats.domain || domain(settings)}
    %{settings | nats: sign_in(nats, Enum.find_value(uris, & &1.userinfo))}
  end

  # Without a name of its own, a leaf's JetStream would be taken for a part of the hub's.
  defp domain(%{nats: %{leaf: %{url: []}}}), do: nil
  defp domain(%{vehicle: %{identity: %{vehicle_id: id}}}), do: id || "leaf"

  defp sign_in(nats, nil), do: nats

  defp sign_in(nats, userinfo) do
    case String.split(userinfo, ":", parts: 2) do
      [user, password] -> %{nats | user: URI.decode(user), password: Secret.new(URI.decode(password))}
      [token] -> %{nats | token: Secret.new(URI.decode(token))}
    end
  end

  defp plain_url(uri),
    do: URI.to_string(%{uri | userinfo: nil, authority: nil, path: nil, port: uri.port || 4222})

  @doc "Where a FLEET_STATE that this gateway makes is kept; nil if one that is there may be kept elsewhere."
  @spec state_storage(nats :: map()) :: :memory | :file | nil
  def state_storage(%{mode: :embedded, streams: %{state_storage: nil}}), do: :memory
  def state_storage(%{streams: %{state_storage: storage}}), do: storage

  @doc "Whether there is a bridge at all."
  @spec on?(t()) :: boolean()
  def on?(%__MODULE__{nats: %{mode: mode}}), do: mode != :off

  @doc """
  What contradicts itself in the section as it is written, before `derive/1` puts the login of an address in place of
  the keys. `given` says what was set, and where.
  """
  @spec contradictions(map(), given :: %{String.t() => String.t()}) :: [Schema.problem()]
  def contradictions(nats, given) do
    logins = for url <- nats.url, info = URI.parse(url).userinfo, uniq: true, do: info
    keys = for key <- @logins ++ [:password], Map.fetch!(nats, key), do: "nats.#{key}"
    # `--nats embedded` and AERIE_NATS_MODE put another mode over a file.
    beside? = nats.url != [] and given["nats.mode"] == given["nats.url"]

    failed([
      {match?([_, _ | _], logins), ["nats", "url"], "the same login in all addresses",
       "#{length(logins)} different ones"},
      {Enum.any?(logins, &("" in String.split(&1, ":", parts: 2))) or Enum.any?(nats.url, &(&1 =~ "://@")),
       ["nats", "url"], "a user and a password, or a token, in front of the @", "an empty one"},
      {logins != [] and keys != [], ["nats", "url"], "one way to sign in",
       "a login in the address and #{Enum.join(keys, ", ")}"},
      {nats.user != nil and nats.password == nil, ["nats", "password"], "a password for nats.user",
       "nothing"},
      {nats.mode == :embedded and beside?, ["nats", "mode"], "url for nats.url", "embedded"},
      {is_map_key(given, "nats.tls.enabled") and not nats.tls.enabled and
         Enum.any?(nats.url, &String.starts_with?(&1, "tls://")), ["nats", "tls", "enabled"],
       "true for a tls:// address", "false"}
    ])
  end

  @doc "A section without what is for servers at `nats.url`."
  @spec embedded(map()) :: map()
  def embedded(nats) do
    tls = %{nats.tls | enabled: false, ca_file: nil, cert_file: nil, key_file: nil, server_name: nil}
    %{nats | credentials: nil, nkey_seed_file: nil, user: nil, password: nil, tls: tls}
  end

  @doc "A section without what is for a hub."
  @spec without_hub(map()) :: map()
  def without_hub(%{leaf: leaf} = nats) do
    tls = Map.new(leaf.tls, fn {key, _value} -> {key, nil} end)
    %{nats | leaf: %{leaf | url: [], credentials: nil, nkey_seed_file: nil, tls: tls}}
  end

  # The embedded server has neither TLS nor other logins than its token.
  defp of_embedded(%{mode: :embedded} = nats) do
    given = for key <- [:credentials, :nkey_seed_file, :user], Map.fetch!(nats, key), do: "nats.#{key}"

    failed([
      {not Aerie.Base.Net.Address.loopback?(ip(nats.address)), ["nats", "address"],
       "a loopback address: the embedded server has no TLS, so its token could be read on the way (for others run a server of " <>
         "your own, nats.mode url)", nats.address},
      {nats.token != nil and byte_size(Secret.reveal(nats.token)) < @shortest, ["nats", "token"],
       "#{@shortest} characters or more for the embedded server", "a shorter one"},
      {given != [], ["nats", "mode"], "url for #{Enum.join(given, ", ")}",
       "embedded, whose server knows nats.token only"},
      {tls_keys(nats) != [], ["nats", "tls"], "nats.mode url for #{Enum.join(tls_keys(nats), ", ")}",
       "embedded"}
    ])
  end

  defp of_embedded(nats) do
    failed([
      {nats.mode == :url and not nats.tls.enabled and tls_keys(nats) != [], ["nats", "tls", "enabled"],
       "true, or a tls:// address, for #{Enum.join(tls_keys(nats), ", ")}", "false"}
    ])
  end

  defp tls_keys(%{tls: tls}),
    do:
      for(key <- [:ca_file, :cert_file, :key_file, :server_name], Map.fetch!(tls, key), do: "nats.tls.#{key}")

  defp ip(address) do
    {:ok, ip} = :inet.parse_strict_address(String.to_charlist(address))
    ip
  end

  @impl Aerie.Base.Settings
  def problems(%{nats: nats, outbox: outbox}) do
    logins =
      @logins
      |> Enum.filter(&Map.fetch!(nats, &1))
      |> Enum.map_join(", ", &"nats.#{&1}")

    state_mb = nats.streams.state_max_mb

    {in_memory_mb, in_files_mb} =
      if state_storage(nats) == :memory, do: {state_mb, 0}, else: {0, state_mb}

    streams_mb = in_files_mb + nats.streams.event_max_mb

    Leaf.Config.problems(nats.leaf, nats.mode) ++
      of_embedded(nats) ++
      failed([
        {String.contains?(logins, ","), ["nats"], "one way to sign in", logins},
        {nats.password != nil and nats.user == nil, ["nats", "user"], "a user name for nats.password",
         "nothing"},
        {nats.tls.cert_file == nil != (nats.tls.key_file == nil), ["nats", "tls"],
         "cert_file and key_file together", "one of them"},
        {nats.mode == :embedded and nats.tls.enabled, ["nats", "tls", "enabled"],
         "false with nats.mode embedded (the connection does not leave this machine)", "true"},
        {nats.mode == :embedded and nats.max_store_mb < streams_mb, ["nats", "max_store_mb"],
         "at least #{streams_mb}: nats.streams.state_max_mb (#{in_files_mb} in files) and event_max_mb " <>
           "(#{nats.streams.event_max_mb}), which the server reserves", "#{nats.max_store_mb}"},
        {nats.mode == :embedded and nats.max_memory_mb < in_memory_mb, ["nats", "max_memory_mb"],
         "at least #{in_memory_mb}: nats.streams.state_max_mb, which the server reserves",
         "#{nats.max_memory_mb}"},
        {nats.mode == :embedded and nats.streams.replicas > 1, ["nats", "streams", "replicas"],
         "1 with nats.mode embedded, which is one server", "#{nats.streams.replicas}"},
        {nats.mode != :url and nats.streams.events_per_vehicle, ["nats", "streams", "events_per_vehicle"],
         "false without nats.url: a server of our own has the stream FLEET_EVENTS", "true"},
        {nats.mode != :embedded and nats.domain != nil, ["nats", "domain"], "nats.mode embedded",
         "#{nats.mode}"},
        {nats.retry_max_ms < nats.retry_min_ms, ["nats", "retry_max_ms"], "at least nats.retry_min_ms",
         "#{nats.retry_max_ms}"},
        {outbox.segment_kb * 2 > outbox.max_mb * 1024, ["outbox", "segment_kb"],
         "at most half of outbox.max_mb (#{div(outbox.max_mb * 1024, 2)})", "#{outbox.segment_kb}"}
      ])
  end

  @impl Aerie.Base.Settings
  def warnings(%{nats: nats}) do
    Leaf.Config.warnings(nats.leaf) ++
      texts([
        {not nats.tls.verify and nats.tls.enabled,
         "nats.tls.verify is false: anybody on the way can read and change what is sent to NATS."},
        {not is_nil(nats.password) and nats.mode == :url and not nats.tls.enabled and not loopback?(nats.url),
         "nats.password goes over the network without TLS."}
      ])
  end

  defp loopback?(urls),
    do: Enum.all?(urls, &(URI.parse(&1).host in ["localhost", "127.0.0.1", "::1", "[::1]"]))
end
