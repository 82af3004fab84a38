defmodule Aerie.Config.RefusedTest do
  @moduledoc """
  Configurations as people misspell them, through the same check as `aerie config check`: what would do nothing, or the opposite
  of what it says, is refused with the file, the line and the key.
  """
  use ExUnit.Case, async: true

  alias Aerie.Config
  alias Aerie.Config.Preflight

  @moduletag :tmp_dir
  @nkey "UDXU4RCSJNZOIQHZNWXHXORDPRTGNJAHAHFRGZNEEJCPQTT2M7NLCNF4"
  @link ~s(url: "udpin:127.0.0.1:0")
  @client ~s(url: "tcpin:127.0.0.1:0")
  @key "aaaaaaaaaaaaaaaaaaaa"

  # Text of the file, and the beginning of an error behind the file's name.
  @refused [
    # An empty value where a value counts.
    {"policy:\n  max_altitude:\n", "2: policy.max_altitude: expected a number from 0 to 100000, got nothing"},
    {"policy: {max_altitude: ~}", "1: policy.max_altitude: expected a number"},
    {"policy: {max_altitude: null}", "1: policy.max_altitude: expected a number"},
    {"policy: {geofence_file: }", "1: policy.geofence_file: expected a file or folder name, got nothing"},
    {~s(policy: {geofence_file: ""}), "1: policy.geofence_file: expected a file or folder name"},
    {"policy: {takeoff_battery: }", "1: policy.takeoff_battery: "},
    {"policy: {unsigned: }", "1: policy.unsigned: "},
    {"policy: {rates: }", "1: policy.rates: "},
    {"policy: {modes: {denied: }}", "1: policy.modes.denied: "},
    {"policy: {windows: ~}", "1: policy.windows: "},
    {"policy: {clients: [{id: , role: viewer}]}", "1: policy.clients[0].id: "},
    {"policy: {lease: {required: }}", "1: policy.lease.required: expected true or false, got nothing"},
    {"policy: {audit: {required: ~}}", "1: policy.audit.required: "},
    {"links: [{id: a, #{@link}, gcs: }]", "1: links[0].gcs: "},
    {"clients: [{id: a, #{@client}, role: }]", "1: clients[0].role: "},
    {"clients: [{id: a, #{@client}, networks: }]", "1: clients[0].networks: "},
    {"signing: {keys: }", "1: signing.keys: "},
    {"api: {key: }", "1: api.key: expected text that is not empty, got nothing"},
    {"api: {keys_file: }", "1: api.keys_file: "},
    {"nats: {token: }", "1: nats.token: "},
    # Empty and cut secrets.
    {~s(nats: {token: ""}), ~s(1: nats.token: expected text that is not empty, got "")},
    {~s(nats: {token: "  "}), "1: nats.token: expected text that is not empty"},
    {~s(nats: {url: "nats://a", user: u, password: ""}), "1: nats.password: expected text that is not empty"},
    {~s(nats: {url: "nats://a", user: "", password: p}), "1: nats.user: expected text that is not empty"},
    {~s(api: {key: ""}), "1: api.key: expected text that is not empty"},
    {~s(shadow: {key: ""}), "1: shadow.key: expected text that is not empty"},
    {~s(signing: {keys: [{system_id: 7, key_env: ""}]}), "1: signing.keys[0].key_env: expected text"},
    {"api: {key: 1234567890123456}",
     "1: api.key: expected text that is not empty, got a number (write it in quotes)"},
    {"api: {key: 12345678901234567890123}", "1: expected numbers of at most 18 digits"},
    {"nats: {token: 0123}", "1: nats.token: expected text that is not empty, got a number"},
    # Numbers.
    {~s(policy: {max_altitude: "120"}), "1: policy.max_altitude: expected a number"},
    {"policy: {max_altitude: 120m}", "1: policy.max_altitude: "},
    {"policy: {max_altitude: .inf}", "1: policy.max_altitude: "},
    {"policy: {max_altitude: .nan}", "1: policy.max_altitude: "},
    {"policy: {max_altitude: -5}", "1: policy.max_altitude: "},
    {"policy: {max_altitude: 1e2}", "1: policy.max_altitude: "},
    {"policy: {max_altitude: [50]}", "1: policy.max_altitude: "},
    {"policy: {max_altitude: true}", "1: policy.max_altitude: "},
    {"policy: {min_altitude: 50, max_altitude: 50}", "1: policy.min_altitude: expected less than"},
    {"policy: {takeoff_battery: 30}", "1: policy.takeoff_battery: expected a number from 0 to 1"},
    {"policy: {takeoff_battery: 30%}", "1: policy.takeoff_battery: "},
    # Keys twice, misspelt, in the wrong place.
    {"policy:\n  max_altitude: 50\n  max_altitude: 500\n",
     ~s(3: expected each key once, got "max_altitude" twice)},
    {"policy: {max_altitude: 50}\npolicy: {takeoff_battery: 0.3}\n",
     ~s(2: expected each key once, got "policy" twice)},
    {"policy: {max_altitud: 50}", "1: policy.max_altitud: expected a known key"},
    {"Policy: {max_altitude: 50}", "1: Policy: expected a known key"},
    {"max_altitude: 50", "1: max_altitude: expected a known key"},
    {"policy: {lease: true}", "1: policy.lease: expected a section with keys below it, got true"},
    {"policy: {required: true}", "1: policy.required: expected a known key"},
    {~s(policy: {lease: {required: "true"}}), "1: policy.lease.required: expected true or false"},
    {"policy: {lease: {required: yes}}", "1: policy.lease.required: expected true or false"},
    {"policy: {lease: {take_over: viewer}}", "1: policy.lease.take_over: "},
    {"policy: {audit: {required: maybe}}", "1: policy.audit.required: "},
    {"policy: {unsigned: yes}", "1: policy.unsigned: "},
    {"policy: {<<: {max_altitude: 50}}", "1: policy.<<: expected a known key"},
    {"x: &a {max_altitude: 50}\npolicy: *a", "2: expected a plain value"},
    {"policy: {max_altitude: 50}\n---\npolicy: {}", "expected one YAML document"},
    {"policy: " <> String.duplicate("[", 2000), "expected at most 1000 brackets"},
    # Modes.
    {"policy: {modes: {denied: [ACROO]}}",
     ~s|1: policy.modes.denied: expected a flight mode of ArduPilot or PX4, or MODE(27)|},
    {~s(policy: {modes: {denied: [""]}}), "1: policy.modes.denied[0]: expected text that is not empty"},
    {"policy: {modes: {denied: [1]}}", "1: policy.modes.denied: expected a flight mode"},
    {"policy: {modes: {deny: [ACRO]}}", "1: policy.modes.deny: expected a known key"},
    {"policy: {modes: [ACRO]}", "1: policy.modes: expected a section"},
    {"policy: {modes: {transitions: {AUTOO: [RTL]}}}", "1: policy.modes.transitions: expected a flight mode"},
    {"policy: {modes: {transitions: {AUTO: [RTLL]}}}",
     "1: policy.modes.transitions.AUTO: expected a flight mode"},
    {"policy: {modes: {transitions: {AUTO: [RTL], auto: [LAND]}}}",
     "1: policy.modes.transitions: expected each mode once"},
    {"policy: {modes: {denied: [RTL], transitions: {AUTO: [rtl]}}}",
     "1: policy.modes.transitions.AUTO: expected modes that may"},
    # Conditions, windows, rates.
    {"policy: {conditions: [{types: [griper], in_air: false}]}",
     "1: policy.conditions[0].types: expected names of commands"},
    {"policy:\n  conditions:\n    - {types: [gripper], in_air: false}\n    - {types: [gripper], armed: true}\n",
     "2: policy.conditions: expected one entry for each command, got gripper twice"},
    {"policy: {conditions: [{types: [gripper]}]}",
     "1: policy.conditions[0]: expected armed or in_air, got neither"},
    {"policy: {conditions: [{types: [], in_air: false}]}",
     "1: policy.conditions[0].types: expected text that is not empty, or a list of them, got an empty list"},
    {"policy: {conditions: [{type: gripper, in_air: false}]}",
     "1: policy.conditions[0].type: expected a known key"},
    {~s(policy: {windows: [{from: "06:00", to: "25:00"}]}), "1: policy.windows[0].to: "},
    {~s(policy: {windows: [{from: "06:00", to: "06:00"}]}),
     "1: policy.windows[0].to: expected another time than from"},
    {~s(policy: {windows: [{days: [monday], from: "06:00", to: "20:00"}]}), "1: policy.windows[0].days[0]: "},
    {~s(policy: {windows: [{days: [], from: "06:00", to: "20:00"}]}), "1: policy.windows[0].days: "},
    {~s(policy: {windows: [{types: [], from: "06:00", to: "20:00"}]}), "1: policy.windows[0].types: "},
    {~s(policy: {windows: [{types: [land], from: "06:00", to: "20:00"}]}),
     "1: policy.windows[0].types: expected commands that may wait"},
    {~s(policy: {windows: [{from: "06:00", to: "20:00", tz: Europe/Zurich}]}), "1: policy.windows[0].tz: "},
    {"policy: {rates: [{types: [takeof], per_minute: 6}]}",
     "1: policy.rates[0].types: expected names of commands"},
    {"policy: {rates: [{types: [], per_minute: 6}]}", "1: policy.rates[0].types: "},
    {"policy: {rates: [{types: [land], per_minute: 6}]}",
     "1: policy.rates[0].types: expected commands that may wait"},
    {"policy: {rates: [{sources: [], per_minute: 6}]}", "1: policy.rates[0].sources: "},
    {"policy: {rates: [{vehicles: [], per_minute: 6}]}", "1: policy.rates[0].vehicles: "},
    {"policy: {rates: [{types: [takeoff], per_minute: 0}]}", "1: policy.rates[0].per_minute: "},
    {"policy: {rates: [{types: [takeoff], per_minute: 6, burst: 0}]}", "1: policy.rates[0].burst: "},
    {"policy:\n  rates:\n    - {per_minute: 6}\n    - {types: [takeoff], sources: [nobody], per_minute: 6}\n",
     ~s(4: policy.rates[1].sources: expected the name of a source of commands, got "nobody")},
    {"policy: {rates: [{vehicles: [nix], per_minute: 6}]}",
     ~s(1: policy.rates[0].vehicles: expected the name of a vehicle, got "nix")},
    {"vehicles: [{id: alpha, system_id: 7}]\npolicy: {rates: [{vehicles: [VID-007], per_minute: 6}]}",
     ~s(2: policy.rates[0].vehicles: expected the name of a vehicle, got "VID-007")},
    {"policy: {rates: [{vehicles: [north-007], per_minute: 6}]}", "1: policy.rates[0].vehicles: "},
    # Who.
    {"clients: [{id: laptop, #{@client}}]\npolicy: {clients: [{id: laptp, role: viewer}]}",
     ~s|2: policy.clients[0].id: expected the id of a client or link, got "laptp" (did you mean "laptop"?|},
    {"clients: []\npolicy: {clients: [{id: gcs-tcp, role: viewer}]}", "2: policy.clients[0].id: "},
    {"clients: [{id: a, #{@client}}]\npolicy: {clients: [{id: a, role: viewer}, {id: a, role: admin}]}",
     "2: policy.clients: expected each id once, got a twice"},
    {"policy: {clients: [{role: viewer}, {role: admin}]}",
     "1: policy.clients: expected one entry without an id"},
    {"policy: {clients: [{role: veiwer}]}", "1: policy.clients[0].role: "},
    {"policy: {clients: [{role: operator, permissions: [forcedisarm]}]}",
     "1: policy.clients[0].permissions[0]: "},
    {"policy: {clients: [{role: viewer, permissions: [force_disarm]}]}",
     "1: policy.clients[0].permissions: expected none for a viewer"},
    {"policy: {sources: [{name: a, nkey: #{@nkey}, role: viewer, permissions: [terminate]}]}",
     "1: policy.sources[0].permissions: expected none for a viewer"},
    {"policy: {sources: [{name: a, nkey: UABC}]}", "1: policy.sources[0].nkey: "},
    {"policy: {sources: [{name: a, nkey: #{@nkey}}, {name: b, nkey: #{@nkey}}]}",
     "1: policy.sources: expected each nkey once"},
    {~s(policy: {sources: [{name: a, nkey: #{@nkey}}, {name: b, nkey: " #{@nkey}"}]}),
     "1: policy.sources: expected each nkey once"},
    {"policy: {sources: [{name: a, nkey: #{@nkey}, expires: soon}]}", "1: policy.sources[0].expires: "},
    # Links and clients.
    {"links: [{id: a, #{@link}, gcs: denny}]", "1: links[0].gcs: "},
    {"links: [{id: a, #{@link}, role: read_only}]", "1: links[0].role: expected a known key"},
    {~s(links: [{id: a, url: "udpin:127.0.0.1:0?gcs=allow", gcs: deny}]),
     "1: links[0].gcs: expected the same in the key and in the url, or one of them, got deny contradicts gcs=allow in the url"},
    {~s(links: [{id: a, url: "udpin:127.0.0.1:0?gcs=allow", gcs: auto}]), "1: links[0].gcs: "},
    {~s(links: [{id: a, url: "udpin:127.0.0.1:0?gcs=allow&gcs=deny"}]),
     "1: links[0].url: expected each option once"},
    {~s(links: [{id: a, url: "udpin:127.0.0.1:0?id=b"}]), "1: links[0].id: "},
    {~s(links: [{id: a, url: "udpin:127.0.0.1:0?network=b", network: c}]), "1: links[0].network: "},
    {~s(links: [{id: a, url: "udpin:127.0.0.1:0?secure=true", secure: false}]), "1: links[0].secure: "},
    {~s(links: [{id: a, url: "udpin:127.0.0.1:0?secure=false", secure: true}]), "1: links[0].secure: "},
    {"links: [{id: a, #{@link}}, {id: a, #{@link}}]", "1: links: expected link ids that differ"},
    {"links: [{id: a, #{@link}, carry: {control: b}, group: g}]",
     "1: links[0].carry.control: expected the id of a link"},
    {"clients: [{id: a, #{@client}, role: readonly}]", "1: clients[0].role: "},
    {"clients: [{id: a, #{@client}, gcs: deny}]", "1: clients[0].gcs: expected a known key"},
    {~s(clients: [{id: a, url: "tcpin:127.0.0.1:0?gcs=deny"}]),
     "1: clients[0]: expected rules that make sense, got url: gcs is"},
    {~s(clients: [{id: a, url: "tcpin:127.0.0.1:0?network=main"}]),
     "1: clients[0]: expected rules that make sense, got url: network"},
    {~s(clients: [{id: a, url: "tcpin:127.0.0.1:0?id=b"}]),
     "1: clients[0]: expected rules that make sense, got id: a"},
    {"clients: [{id: a, #{@client}, networks: []}]", "1: clients[0].networks: "},
    {"clients: [{id: a, #{@client}, networks: [nowhere]}]",
     "1: clients[0].networks: expected a network that a link has"},
    {"clients: [{id: a, #{@client}, filter_in: {block_message: [SET_MODE]}}]",
     "1: clients[0].filter_in.block_message: "},
    {"clients: [{id: a, #{@client}, filter_in: {block_messages: [SET_MOD]}}]",
     "1: clients[0]: expected rules that make sense"},
    {"clients: [{id: a, #{@client}, filter_in: {allow_messages: []}}]",
     "1: clients[0].filter_in.allow_messages: "},
    {"clients: [{id: a, #{@client}, filter_out: {block_sources: [nowhere]}}]",
     "1: clients[0].filter_out.block_sources: expected the id"},
    {"clients: [{id: a, #{@client}, rate_limits: {ATTITUT: 1}}]",
     "1: clients[0]: expected rules that make sense"},
    {"clients: [{id: a, #{@client}, id_offsets: {nowhere: 1}}]", "1: clients[0].id_offsets: "},
    # Signing, servers, the shadow, the gateway's own identity.
    {"signing: {keys: [{system_id: 7, key_env: K, policy: requird}]}", "1: signing.keys[0].policy: "},
    {"signing: {keys: [{system_id: 7, key_env: NO_SUCH_KEY_OF_A_TEST}]}", "1: signing.keys[0].key_env: "},
    {"signing: {keys: [{key_env: A}, {key_env: B}]}",
     "1: signing.keys: expected one key for each network and system id"},
    {"http: {address: 0.0.0.0}", "1: http.address: expected a loopback address"},
    {"websocket: {address: 0.0.0.0}", "1: websocket.address: expected a loopback address"},
    {"api: {key: short}", "1: api.key: expected 16 characters or more"},
    {"nats: {address: 0.0.0.0}",
     "1: nats.address: expected a loopback address: the embedded server has no TLS"},
    {"nats: {address: \"::\", token: #{@key}}", "1: nats.address: "},
    {"nats: {address: 192.168.1.4, token: #{@key}}", "1: nats.address: "},
    {"nats: {user: a, password: b}", "1: nats.mode: expected url for nats.user, got embedded"},
    {"nats: {mode: embedded, credentials: /a.creds}", "1: nats.mode: expected url for nats.credentials"},
    {"nats: {tls: {ca_file: /ca.pem}}",
     "1: nats.tls: expected nats.mode url for nats.tls.ca_file, got embedded"},
    {~s(nats: {url: "nats://a", tls: {ca_file: /ca.pem}}),
     "1: nats.tls.enabled: expected true, or a tls:// address"},
    {~s(nats: {url: "nats://u:p@a", user: v, password: q}), "1: nats.url: expected one way to sign in"},
    {~s(nats: {url: "nats://u:p@a", token: t}), "1: nats.url: expected one way to sign in"},
    {~s(nats: {url: ["nats://u:p@a", "nats://v:q@b"]}),
     "1: nats.url: expected the same login in all addresses"},
    {~s(nats: {url: ["nats://u:@a"]}),
     "1: nats.url: expected a user and a password, or a token, in front of the @"},
    {~s(nats: {url: "nats://:p@a"}), "1: nats.url: expected a user and a password"},
    {~s(nats: {url: "nats://@a"}), "1: nats.url: expected a user and a password"},
    {~s(nats: {url: "nats://a", user: u}), "1: nats.password: expected a password for nats.user"},
    {~s(nats: {mode: embedded, url: "nats://a"}), "1: nats.mode: expected url for nats.url, got embedded"},
    {~s(nats: {url: "tls://a", tls: {enabled: false}}),
     "1: nats.tls.enabled: expected true for a tls:// address"},
    {"nats: {token: a}", "1: nats.token: expected 16 characters or more for the embedded server"},
    {"shadow: {key: a}", "1: shadow.key: expected 16 characters or more"},
    {~s(api: {key: " #{@key}"}), "1: api.key: expected a key without spaces"},
    {"policy: {sources: [{name: shadow, nkey: #{@nkey}}]}",
     "1: policy.sources[0].name: expected a name that the gateway"},
    {~s(links: [{id: a, url: "ws://127.0.0.1:1/?Gcs=deny"}]),
     "1: links[0].url: expected gcs (Gcs is not an option)"},
    {"clients: [{id: a, #{@client}, rate_limits: {ATTITUDE: 1, attitude: 50}}]",
     "1: clients[0]: expected rules that make sense"},
    {~s(api: {key: #{@key}, origins: ["*"]}), "1: api.origins[0]: "},
    {~s(http: {hosts: ["*"]}), "1: http.hosts[0]: "},
    {~s(http: {proxies: ["0.0.0.0/0"]}), "1: http.proxies[0]: "},
    {~s(shadow: {allow_arming: "no"}), "1: shadow.allow_arming: "},
    {"mavlink: {system_id: 255}", "1: mavlink.system_id: "},
    {"policy:\n\tmax_altitude: 50", "2: expected valid YAML"},
    {"- a", "1: expected keys with values at the top"},
    {"environment: \xE4", "1: expected UTF-8 text"},
    {"\uFEFFpolicy: {max_altitude: -1}", "1: policy.max_altitude: "}
  ]

  # What looks odd and does what it says.
  @taken [
    # Nothing above home.
    "policy: {max_altitude: 0}",
    # Unlike `rates: []`, which says that there is no limit, these are the defaults.
    "policy: {windows: [], conditions: [], clients: [], sources: [], modes: {denied: [], transitions: {}}}",
    "policy: {rates: []}",
    # One is a list of one, and case does not matter.
    "policy: {modes: {denied: acro, transitions: {auto: rtl}}}",
    "policy: {modes: {denied: [MODE(27), EXTERNAL1, QACRO, AUTO_FOLLOW_TARGET, FollowMe]}}",
    # No other mode may follow.
    "policy: {modes: {transitions: {AUTO: []}}}",
    # Over midnight, and to the end of the day.
    ~s(policy: {windows: [{from: "22:00", to: "06:00"}, {from: 06:00, to: "24:00"}]}),
    "clients: [{id: a, #{@client}, enabled: false}]\npolicy: {clients: [{id: a}, {id: udp, role: viewer}, {role: viewer}]}",
    "policy: {clients: [{id: gcs-tcp, role: viewer}]}",
    "vehicles: [{id: alpha, system_id: 7}]\npolicy: {rates: [{vehicles: [alpha, VID-008], sources: [gcs-tcp, elixir, bin/aerie, unsigned, shadow, ops], per_minute: 6}], sources: [{name: ops, nkey: #{@nkey}}]}",
    "policy: {unsigned: admin}",
    ~s(links: [{id: a, url: "udpin:127.0.0.1:0?gcs=allow&network=n&id=a", gcs: allow, network: n}]),
    ~s(links: [{id: a, #{@link}, group: g, carry: {control: all, bulk: a}}]),
    "clients: [{id: a, #{@client}, filter_out: {allow_sources: [udp, a], block_messages: []}}]",
    "nats: {address: 127.0.0.2, token: #{@key}}",
    "nats:\nhttp:\npolicy: []\n",
    ""
  ]

  defp check(dir, text, more \\ []) do
    path = Path.join(dir, "gateway.yaml")
    File.write!(path, text)
    File.chmod!(path, 0o600)

    folders =
      for {key, name} <- [
            {"nats.store_dir", "nats"},
            {"outbox.dir", "outbox"},
            {"policy.audit.dir", "audit"},
            {"commands.ledger.dir", "ledger"},
            {"console.dir", "console"}
          ],
          do: {key, Path.join(dir, name)}

    with {:ok, config} <- Config.load(path, folders ++ [{"nats.binary", "sh"} | more], env: %{}),
         {:ok, warnings} <- Preflight.check(config) do
      {:ok, config.warnings ++ warnings}
    else
      {:error, errors} ->
        {:error, for(error <- errors, do: error |> to_string() |> String.replace(path <> ":", ""))}
    end
  end

  test "what would not do what it says is refused, with its line and key", %{tmp_dir: dir} do
    for {text, expected} <- @refused do
      lines =
        with {:ok, _warnings} <- check(dir, text),
             do: flunk("taken: " <> text),
             else: ({:error, lines} -> lines)

      assert Enum.any?(lines, &String.starts_with?(String.trim_leading(&1), expected)),
             "#{text}\nexpected #{expected}\ngot #{Enum.join(lines, "\n")}"
    end
  end

  test "what looks odd and is enforced is taken", %{tmp_dir: dir} do
    for text <- @taken, do: assert({:ok, []} = check(dir, text), text)
  end

  test "names that may be elsewhere are warnings", %{tmp_dir: dir} do
    file = "clients: [{id: a, #{@client}}]\npolicy: {clients: [{id: a, role: viewer}]}"
    replaced = [{"clients", [%{"id" => "b", "url" => "tcpin:127.0.0.1:0"}]}]
    assert {:ok, [warning]} = check(dir, file, replaced)
    assert warning =~ ~s(policy.clients[0].id: "a" is not the id of a client or link)

    remote = "remote: {enabled: true}\npolicy: {rates: [{vehicles: [far], per_minute: 6}]}"
    assert {:ok, [warning]} = check(dir, remote)
    assert warning =~ ~s(policy.rates[0].vehicles: "far" is not the name of a vehicle)
  end

  test "names of keys and users are sources of commands", %{tmp_dir: dir} do
    text = fn name ->
      "api: {keys_file: \"#{dir}/keys\"}\npolicy: {rates: [{sources: [#{name}], per_minute: 6}]}"
    end

    File.write!(Path.join(dir, "keys"), "ci #{@key}\n")
    File.chmod!(Path.join(dir, "keys"), 0o600)
    assert {:ok, []} = check(dir, text.("ci"))
    assert {:error, [line]} = check(dir, text.("cd"))
    assert line =~ ~s(policy.rates[0].sources: expected the name of a source of commands, got "cd")
  end

  test "a file of keys in which one would not count, or would be another one", %{tmp_dir: dir} do
    file = Path.join(dir, "keys")

    for {keys, n, expected} <- [
          {"a #{@key}\nb #{@key} role=admin", 2, "each key once"},
          {"a #{@key}\na bbbbbbbbbbbbbbbbbbbb", 2, "each name once"},
          {"#{@key}\n\n#{@key}", 3, "each key once"},
          {"a #{@key} role=viewer role=admin", 1, "each of role="},
          {"a #{@key} Role=viewer", 1, "expected KEY, NAME KEY"},
          {"a #{@key} rol=viewer", 1, "expected KEY, NAME KEY"},
          {"a #{@key} role=veiwer", 1, "role= expects"},
          {"a #{@key} role=", 1, "role= expects"},
          {"a #{@key} permissions=", 1, "permissions= expects"},
          {"a #{@key} expires=2026-13-40", 1, "expires= expects"},
          {"a sha256:abcd", 1, "sha256: is followed by"},
          {"a short", 1, "a key has 16"},
          {"a #{@key} role=viewer permissions=terminate", 1, "role=viewer has no permissions="},
          # The field would be the key.
          {"#{@key} expires=2027-12-31", 1, "expected KEY, or NAME KEY and then"},
          {"#{@key} permissions=force_disarm", 1, "expected KEY, or NAME KEY and then"},
          {"#{@key} Permision=force_disarm", 1, "expected KEY, or NAME KEY and then"},
          # The key would be cut.
          {"a #{@key}#bbbbbbbbbbbb", 1, "# is not allowed in a key"},
          {String.duplicate("n", 65) <> " #{@key}", 1, "a name has at most"}
        ] do
      File.write!(file, keys <> "\n")
      File.chmod!(file, 0o600)
      assert {:error, [line]} = check(dir, "api: {keys_file: \"#{file}\"}"), keys
      assert line =~ "api.keys_file: "
      assert line =~ "#{file} line #{n}: #{expected}"
      refute line =~ @key
    end

    File.write!(file, "# none\nb #{@key} role=viewer # comment\n")
    assert {:ok, []} = check(dir, "api: {keys_file: \"#{file}\"}")
    assert {:error, [line]} = check(dir, "api: {key: #{@key}, keys_file: \"#{file}\"}")
    assert line =~ "each key once"
  end
end
