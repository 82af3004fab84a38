defmodule Aerie.ConfigTest do
  use ExUnit.Case, async: true

  alias Aerie.Config
  alias Aerie.Config.Error
  alias Aerie.Base.Secret

  @moduletag :tmp_dir

  defp write(%{tmp_dir: dir}, text) do
    path = Path.join(dir, "gateway.yaml")
    File.write!(path, text)
    path
  end

  defp load(context, text, overrides \\ [], env \\ %{}),
    do: Config.load(write(context, text), overrides, env: env)

  # The lines of keys are asserted where they are the point.
  defp lines({:error, errors}, %{tmp_dir: dir}) do
    for error <- errors do
      error
      |> Error.format()
      |> String.replace(dir <> "/", "")
      |> String.replace(~r/\Agateway\.yaml:\d+: (?=\S+: expected)/, "gateway.yaml: ")
    end
  end

  test "the gateway.yaml of the first design keeps its keys and meaning", context do
    yaml = File.read!(Path.expand("../fixtures/first_design.yaml", __DIR__))
    assert {:ok, config} = load(context, yaml)

    assert config.vehicle_id == "VID-001"
    assert config.environment == "prod"
    assert [%{url: "udpin:0.0.0.0:14550", network: "main", given: true}] = config.links
    assert config.vehicles == [%{id: "VID-001", network: "main", system_id: 1}]

    assert %{mode: :url, url: ["nats://localhost:4222"], credentials: "/etc/gateway/vehicle.creds"} =
             config.nats

    assert %{strategy: :time, hz: 1.0} = config.sampling.groups.position
    assert %{strategy: :threshold, threshold: %{"remaining" => 0.01}} = config.sampling.groups.battery
    assert %{max_altitude: 120.0, geofence_file: "/etc/gateway/geofence.json", rates: nil} = config.policy
    assert %{audit: %{dir: "var/audit", max_mb: 64, required: true}, clients: []} = config.policy
    assert [component, lease] = config.warnings
    assert component =~ "component_id is 1" and component =~ "191"
    assert lease =~ "shadow.key is not set"
  end

  test "without a file there are defaults: a hub with embedded NATS and UDP 14550 open" do
    assert {:ok, config} = Config.load(nil, [], env: %{})
    assert config == Config.default()
    assert config.nats.mode == :embedded
    assert %{system_id: 237, component_id: 191} = config.mavlink
    assert [%{id: "udp", url: "udpin:0.0.0.0:14550", given: false}] = config.links
    assert config.warnings == []
    refute Config.given?(config, "http.port")
  end

  test "every problem is reported at once, with file, key, expectation, value and hint", context do
    result =
      load(context, """
      enviroment: prod
      nats:
        prot: 4222
        max_store_mb: lots
        url: http://localhost
      mavlink:
        system_id: 0
      links:
        - url: udpin:0.0.0.0:14551
          netwrk: a
        - id: b
      sampling:
        groups:
          gps: {strategy: sometimes}
          position: 3
      """)

    assert lines(result, context) == [
             ~s|gateway.yaml: enviroment: expected a known key, got an unknown one (did you mean "environment"?)|,
             "gateway.yaml: mavlink.system_id: expected an integer from 1 to 4294967295, or auto, got 0",
             ~s|gateway.yaml: links[0].netwrk: expected a known key, got an unknown one (did you mean "network"?)|,
             "gateway.yaml: links[1].url: expected udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT, " <>
               "ws://HOST[:PORT][/PATH], serial:auto, serial:DEVICE or DEVICE,BAUD, msp:auto, msp:DEVICE,BAUD or msp:tcp:HOST:PORT, replay:FILE, got nothing (it is required)",
             ~s|gateway.yaml: nats.prot: expected a known key, got an unknown one (did you mean "port"?)|,
             ~s|gateway.yaml: nats.url[0]: expected a URL such as nats://host:4222 or tls://host:4222, | <>
               ~s|got "http://localhost"|,
             ~s|gateway.yaml: nats.max_store_mb: expected an integer from 1 to 1048576, got "lots"|,
             "gateway.yaml: sampling.groups.position: expected a section with keys below it, got 3",
             "gateway.yaml: sampling.groups.gps.strategy: expected one of time, change, threshold, aggregate, " <>
               ~s|got "sometimes"|
           ]
  end

  describe "a file that cannot be read" do
    test "is named with the reason", %{tmp_dir: dir} = context do
      assert ["none.yaml: expected a readable file, got no such file or directory"] =
               lines(Config.load(Path.join(dir, "none.yaml"), [], env: %{}), context)

      assert {:error, [%Error{expected: "a readable file"}]} = Config.load(dir, [], env: %{})
    end

    test "by its syntax gives the line", context do
      assert ["gateway.yaml:3: expected valid YAML, got " <> _] =
               lines(load(context, "nats:\n  port: 1\n\tx: 2\n"), context)
    end
  end

  test "a relative name of a file to read begins beside the configuration, those of the gateway's own folders do not",
       %{tmp_dir: dir} = context do
    text = """
    nats:
      url: tls://hub.example.org:4222
      nkey_seed_file: keys/gateway.nk
      tls: {ca_file: ca.pem}
      store_dir: var/nats
      binary: nats-server
    remote: {nkey_seed_file: gateway.nk}
    signing: {keys: [{system_id: 1, key_file: one.key}, {system_id: 2, key_file: /two.key}]}
    policy: {geofence_file: ../zones.json}
    api: {keys_file: users}
    """

    assert {:ok, config} =
             load(context, text, [{"websocket.cert_file", "a.pem"}, {"websocket.key_file", "a.key"}])

    assert config.nats.nkey_seed_file == Path.join(dir, "keys/gateway.nk")
    assert config.nats.tls.ca_file == Path.join(dir, "ca.pem")
    assert config.remote.nkey_seed_file == Path.join(dir, "gateway.nk")
    assert for(key <- config.signing.keys, do: key.key_file) == [Path.join(dir, "one.key"), "/two.key"]
    assert config.policy.geofence_file == Path.join(dir, "../zones.json")
    assert config.api.keys_file == Path.join(dir, "users")
    assert {config.nats.store_dir, config.nats.binary} == {"var/nats", "nats-server"}
    assert config.websocket.cert_file == "a.pem"
    # What is no name at all is named by its key.
    assert [error] = lines(load(context, "api: {keys_file: [users]}"), context)
    assert error =~ "api.keys_file: expected a file or folder name"
    assert [error] = lines(load(context, "signing: {keys: {key_file: one}}"), context)
    assert error =~ "signing.keys: expected a list"
  end

  describe "layers" do
    test "rise from file over environment to the command line", context do
      file = "environment: file\nnats: {port: 1001, retry_min_ms: 11}\nhttp:\n  port: 1\n"
      env = %{"AERIE_ENVIRONMENT" => "env", "AERIE_NATS_PORT" => "1002", "AERIE_HTTP_PORT" => "2"}
      assert {:ok, config} = load(context, file, [{"http.port", 3}], env)

      assert {config.environment, config.nats.port, config.nats.retry_min_ms, config.http.port} ==
               {"env", 1002, 11, 3}

      assert Config.given?(config, "nats.port")
    end

    test "a problem names the layer it came from", context do
      env = %{"AERIE_NATS_PORT" => "many", "AERIE_LINKS" => "[{url: 'tcp:10.0.0.1:5760', colour: red}]"}

      assert [
               "environment variable AERIE_LINKS: links[0].colour: expected a known key, " <> _,
               ~s|environment variable AERIE_NATS_PORT: nats.port: expected an integer from 0 to 65535, got "many"|,
               ~s|command line: http.port: expected an integer from 0 to 65535, got "x"|
             ] = lines(load(context, "environment: a", [{"http.port", "x"}], env), context)
    end

    test "lists and maps are given as YAML, JSON or words with commas", context do
      env = %{
        "AERIE_NATS_URL" => "nats://a:1,nats://b:2",
        "AERIE_VEHICLES" => ~s([{"id": "X-1", "system_id": 9}]),
        "AERIE_MAVLINK_DIALECTS" => "ardupilot, common",
        "AERIE_SAMPLING_GROUPS_GPS_THRESHOLD" => "{hdop: 0.2}",
        "AERIE_MAVLINK_SYSID32" => "true",
        "AERIE_SAMPLING_POSITION_HZ" => "2"
      }

      assert {:ok, config} = load(context, "", [], env)
      assert config.nats.url == ["nats://a:1", "nats://b:2"]
      assert config.vehicles == [%{id: "X-1", network: "main", system_id: 9}]
      assert config.mavlink.dialects == [:ardupilot, :common]
      assert config.sampling.groups.gps.threshold == %{"hdop" => 0.2}
      assert config.mavlink.sysid32
      assert config.sampling.groups.position.hz == 2.0
    end

    test "an AERIE_ variable below a section that is not a key is refused, and an empty one of a key; others are left alone",
         context do
      env = %{"AERIE_NATS_PROT" => "1", "AERIE_TOOLCHAIN" => "x", "AERIE_LOG_DIR" => "/tmp", "PATH" => "y"}

      assert lines(load(context, "", [], env), context) == [
               "environment variable AERIE_NATS_PROT: expected a variable of a key, got an unknown one " <>
                 ~s|(did you mean "AERIE_NATS_PORT"?)|
             ]

      # A section is not a key: its keys are given one by one, and leave each other alone.
      assert [error] = lines(load(context, "", [], %{"AERIE_NATS" => "{url: 'nats://a'}"}), context)
      assert error =~ "AERIE_NATS: expected a variable of a key"

      for text <- ["", " "] do
        assert lines(load(context, "", [], %{"AERIE_POLICY_MAX_ALTITUDE" => text}), context) == [
                 "environment variable AERIE_POLICY_MAX_ALTITUDE: policy.max_altitude: expected a value, got an empty text " <>
                   "(take the variable away for the default)"
               ]
      end

      # The configuration itself names this one.
      env = %{"AERIE_SIGNING_KEY_7" => String.duplicate("a", 64)}
      text = "signing: {keys: [{system_id: 7, key_env: AERIE_SIGNING_KEY_7}]}"
      assert {:ok, _config} = load(context, text, [], env)
    end

    test "overrides may be nested maps with atoms", context do
      assert {:ok, config} =
               load(context, "", %{nats: %{mode: :embedded, port: 0}, links: [%{url: "tcpin::5760"}]})

      assert config.nats.mode == :embedded
      assert [%{id: "tcpin::5760", spec: %{kind: :tcp_server}}] = config.links
    end
  end

  test "an override of one key leaves every other key as the layers below have it, in whatever form it comes" do
    leaves =
      for {path, field} <- Aerie.Base.Settings.Schema.leaves(Aerie.Config.Keys.fields()), do: {path, field}

    sections = for {[section, _key | _], _field} <- leaves, uniq: true, do: section

    key = fn config, path ->
      get_in(Map.from_struct(config), Enum.map(path, &Access.key!(String.to_atom(&1))))
    end

    base = [{"nats.url", "tls://hub:1"}, {"nats.tls.server_name", "hub"}, {"nats.tls.ca_file", "ca.pem"}]
    base = base ++ [{"http.port", 4001}, {"outbox.max_mb", 33}, {"mavlink.component_id", 192}]
    before = Config.default(base)

    for over <- [
          %{nats: %{url: "tls://other:2"}},
          %{"nats" => %{"url" => ["tls://other:2"]}},
          [{"nats", %{"url" => "tls://other:2"}}],
          [{"nats.url", "tls://other:2"}]
        ] do
      config = Config.default(base ++ Enum.to_list(over))
      assert config.nats.url == ["tls://other:2"]

      assert for({path, _field} <- leaves, key.(config, path) != key.(before, path), do: path) == [
               ["nats", "url"]
             ]
    end

    # A section of which nothing is said is as it was.
    for section <- sections,
        do: assert(%{Config.default(base ++ [{section, %{}}]) | given: before.given} == before)
  end

  describe "secrets" do
    test "are readable only on purpose", context do
      assert {:ok, config} = load(context, "nats:\n  url: 'nats://gw:pa%40ss@host:4333'\n")
      assert config.nats.url == ["nats://host:4333"]
      assert config.nats.user == "gw"
      assert Secret.reveal(config.nats.password) == "pa@ss"
      refute inspect(config, structs: false, limit: :infinity) =~ "pa@ss"
      refute to_string(:io_lib.format("~p", [config])) =~ "pa@ss"
    end

    test "are not shown when they are wrong either", context do
      assert [line] = lines(load(context, "nats: {user: a, password: [hunter2]}"), context)
      refute line =~ "hunter2"
    end
  end

  describe "links and names" do
    test "mavlink.local_addr opens one more link when given, none when off", context do
      both = "links: [{id: r, url: '/dev/ttyS0,57600'}]\nmavlink: {local_addr: '10.0.0.1:14540'}"
      assert {:ok, %{links: [%{id: "r"}, %{url: "udpin:10.0.0.1:14540"}]}} = load(context, both)

      assert {:ok, %{links: [%{id: "udpout:1.2.3.4:5"}]}} =
               load(context, "links: [{url: 'udpout:1.2.3.4:5'}]")

      assert {:ok, %{links: []}} = load(context, "mavlink: {local_addr: off}")
      assert {:ok, %{links: [%{url: "udpin:[::]:1"}]}} = load(context, "mavlink: {local_addr: '[::]:1'}")
    end

    test "a link is of the network in its key, in its string, or the default one", context do
      text = """
      network: field
      links:
        - {url: "udpin::1?network=b&id=x", network: b}
        - {url: "udpin::2?network=a"}
        - {url: "udpin::3"}
      """

      assert {:ok, %{links: links}} = load(context, text)
      assert [{"x", "b"}, {"udpin::2", "a"}, {"udpin::3", "field"}] = Enum.map(links, &{&1.id, &1.network})
      assert Enum.map(links, & &1.network) == Enum.map(links, & &1.spec.network)
    end

    test "a connection string that is wrong says why", context do
      assert ["gateway.yaml: links[0].url: expected tcp:HOST:PORT (the port is missing), got \"tcp:1.2.3.4\""] =
               lines(load(context, "links: [{url: 'tcp:1.2.3.4'}]"), context)
    end

    test "ids and listening addresses must differ", context do
      text = """
      links:
        - {id: a, url: "udpin:0.0.0.0:14550"}
        - {id: a, url: "udp:0.0.0.0:14550"}
      vehicles:
        - {id: V, system_id: 1}
        - {id: W, system_id: 1}
      """

      assert lines(load(context, text), context) == [
               ~s|gateway.yaml: links: expected link ids that differ, got "a" more than once|,
               ~s|gateway.yaml: links: expected addresses to listen on that differ, | <>
                 ~s|got "UDP 0.0.0.0:14550" more than once|,
               ~s|gateway.yaml: vehicles: expected one name for each network and system id, got "main/1" more than once|
             ]
    end
  end

  test "what is allowed and probably not meant is a warning", context do
    text = """
    mavlink: {system_id: 244}
    vehicles: [{id: V, system_id: 244}]
    nats: {url: "nats://gw:secret@nats.example"}
    """

    assert {:ok, %{warnings: [same_id, plain_password, lease]}} = load(context, text)
    assert lease =~ "shadow.key is not set"
    assert same_id =~ "is also a vehicle's"
    assert plain_password =~ "without TLS"
    refute plain_password =~ "secret"
  end

  test "H5: a ground station's identity is refused, with the reason, unless it is meant", context do
    assert [system_id, type] = lines(load(context, "mavlink: {system_id: 255, heartbeat_type: gcs}"), context)

    assert system_id =~
             "gateway.yaml: mavlink.system_id: expected an id that no ground station uses, such as 237, got 255"

    assert system_id =~ "mavlink.i_am_the_gcs: true"
    assert type =~ "gateway.yaml: mavlink.heartbeat_type: expected onboard_controller, got gcs"

    assert {:ok, %{mavlink: %{system_id: 255, heartbeat_type: :gcs}}} =
             load(context, "mavlink: {system_id: 255, i_am_the_gcs: true}")

    assert {:ok, %{mavlink: %{system_id: 237, heartbeat_type: :onboard_controller}}} = load(context, "")
  end

  test "streams are named as messages are", context do
    assert {:ok, %{mavlink: %{streams: %{"ATTITUDE" => 10.0}}}} =
             load(context, "mavlink: {streams: {ATTITUDE: 10}}")

    assert lines(load(context, "mavlink: {streams: {ALTITUTE: 10}}"), context) == [
             "gateway.yaml: mavlink.streams.ALTITUTE: expected the name of a message, such as ATTITUDE, got an unknown one"
           ]
  end

  test "keys that contradict each other are refused", context do
    assert [line] = lines(load(context, "nats: {mode: embedded, tls: {enabled: true}}"), context)
    assert line =~ "nats.tls.enabled: expected false with nats.mode embedded"

    text = """
    nats: {url: "nats://a", credentials: a.creds, token: t, retry_min_ms: 500, retry_max_ms: 400}
    timeouts: {vehicle_stale_s: 20}
    """

    assert lines(load(context, text), context) == [
             "gateway.yaml: timeouts.vehicle_lost_s: expected more than timeouts.vehicle_stale_s (20.0), got 5.0",
             "gateway.yaml: nats: expected one way to sign in, got nats.credentials, nats.token",
             "gateway.yaml: nats.retry_max_ms: expected at least nats.retry_min_ms, got 400"
           ]
  end

  test "default/1 raises on a wrong override" do
    assert_raise ArgumentError, ~r/http.port/, fn -> Config.default([{"http.port", -1}]) end
  end

  test "who may use the interfaces for clients: contradictions and things that are probably not meant",
       context do
    assert lines(load(context, "api: {key: too-short}\n"), context) == [
             "gateway.yaml: api.key: expected 16 characters or more, got a shorter one"
           ]

    for section <- ["websocket", "http"], address <- ["0.0.0.0", "10.0.0.1", "'::'"] do
      assert [line] = lines(load(context, "#{section}: {address: #{address}}\n"), context)
      assert line =~ "#{section}.address" and line =~ "no key"

      assert {:ok, _} =
               load(context, "#{section}: {address: #{address}}\n", [], %{
                 "AERIE_API_KEY" => "0123456789abcdef"
               })

      assert {:ok, _} = load(context, "#{section}: {address: #{address}, enabled: false}\n")
    end

    assert [line] = lines(load(context, "websocket: {cert_file: a.pem}\n"), context)
    assert line =~ "cert_file and key_file together"
    assert [line] = lines(load(context, "websocket: {port: 4000}\n"), context)
    assert line =~ "another port than http.port"
    assert [line] = lines(load(context, "api: {origins: [gcs.example.org]}\n"), context)
    assert line =~ "https://gcs.example.org"

    assert {:ok, config} =
             load(context, """
             api: {key: 0123456789abcdef, origins: ["https://GCS.example.org"]}
             websocket: {address: 0.0.0.0}
             """)

    assert config.api.origins == ["https://gcs.example.org"]
    assert [warning] = config.warnings
    assert warning =~ "without websocket.cert_file"
    refute inspect(config, limit: :infinity) =~ "0123456789abcdef"
  end

  test "ids of a network with signing keys are not renumbered: a signature covers them", context do
    file = """
    clients: [{id: gcs, url: "tcpin:127.0.0.1:0", id_offsets: {north: 10, south: 20}}]
    """

    assert {:ok, %{clients: [%{id_offsets: %{"north" => 10, "south" => 20}}]}} = load(context, file)
    signing = "signing: {keys: [{network: south, key_env: SOUTH}]}\n"
    env = %{"SOUTH" => String.duplicate("ab", 32)}
    assert [line] = context |> load(file <> signing, [], env) |> lines(context)
    assert line =~ "id_offsets" and line =~ "south" and line =~ "without signing keys"
    assert {:error, _} = load(context, String.replace(file, "10", "300"))
  end

  test "R11: auto takes the vehicle's id; a hub has one of its own", context do
    assert {:ok, %{mavlink: %{system_id: :auto}, vehicles: []}} =
             load(context, "vehicle_id: VID-007\nmavlink: {system_id: auto}\n")

    assert {:ok, %{mavlink: %{system_id: 7}}} =
             load(context, "vehicle_id: VID-007\nmavlink: {system_id: 7}\n")

    assert [line] = context |> load("mavlink: {system_id: auto}\n") |> lines(context)
    assert line =~ "mavlink.system_id" and line =~ "vehicle_id"
    assert [line] = context |> load("mavlink: {system_id: 0}\n") |> lines(context)
    assert line =~ "from 1 to"
    env = %{"AERIE_MAVLINK_SYSTEM_ID" => "auto", "AERIE_VEHICLE_ID" => "VID-007"}
    assert {:ok, %{mavlink: %{system_id: :auto}}} = load(context, "", [], env)
  end

  test "an own quota that is smaller than the streams is refused before anything starts", context do
    for {nats, text} <- [
          {"max_store_mb: 100",
           "nats.max_store_mb: expected at least 512: nats.streams.state_max_mb (0 in files)"},
          {"max_store_mb: 550, streams: {state_storage: file}",
           "nats.max_store_mb: expected at least 576: nats.streams.state_max_mb (64 in files) and event_max_mb (512)"},
          {"max_memory_mb: 63", "nats.max_memory_mb: expected at least 64: nats.streams.state_max_mb"}
        ] do
      assert {:error, errors} = load(context, "nats: {#{nats}}\n")
      assert Config.format_errors(errors) =~ text
    end

    assert {:ok, _config} = load(context, "nats: {max_store_mb: 100, streams: {event_max_mb: 30}}\n")
    assert {:ok, _config} = load(context, "nats: {max_memory_mb: 1, streams: {state_storage: file}}\n")
  end
end
