defmodule Aerie.Config.AuthorityTest do
  @moduledoc """
  Every key that gives or takes authority, sight or protection does so: of each, two values lead the code that decides to two
  different decisions. A key that is in neither list below is new: decide which it belongs to.
  """
  use ExUnit.Case, async: true

  alias Aerie.Base.Secret
  alias Aerie.Config
  alias Aerie.Control.Policy
  alias Aerie.Fleet.{Bridge, Remote, Shadow}
  alias Aerie.Vehicle.Command
  alias MavRouter.{Identity, Signing}
  alias Aerie.Config.Keys
  alias MavRouter.Client
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Server.Egress
  alias Aerie.Control.Policy.{Audit, Intent, ControlLease, Rate}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Roles.Signature
  alias Aerie.Control.Policy.Roles.Sources
  alias MavRouter.Endpoints.Access
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints.Owner.Filter
  alias Aerie.Base.Settings.Field
  alias Aerie.Access.HTTP.{Admission, Proxy}

  @moduletag :tmp_dir

  # Sections about how much and how often, none about who, what or whether.
  @neutral ~w(recorder outbox sampling events params serial timeouts limits log)

  # Names, places and amounts: they decide where something is and how much of it there is.
  @without ~w(
    vehicle_id environment network vehicles[].id vehicles[].network vehicles[].system_id
    mavlink.component_id mavlink.heartbeat_deadman_s mavlink.local_addr mavlink.dialects mavlink.sysid32 mavlink.request_streams
    mavlink.streams mavlink.timesync_s mavlink.read_gcs_parameters
    links[].id links[].url links[].label links[].enabled links[].group links[].carry links[].rate_limits links[].bytes_per_s
    clients[].id clients[].url clients[].label clients[].enabled clients[].coalesce clients[].queue_frames clients[].queue_kb
    clients[].transfer_kb clients[].rate_limits clients[].bytes_per_s
    signing.dir
    nats.port nats.store_dir nats.max_memory_mb nats.max_store_mb nats.binary nats.domain nats.connect_timeout_s nats.retry_min_ms
    nats.retry_max_ms nats.streams.state_max_mb nats.streams.state_storage nats.streams.state_max_age_days nats.streams.event_max_mb
    nats.streams.event_max_age_days nats.streams.events_per_vehicle nats.streams.duplicate_window_s nats.streams.replicas
    remote.max_vehicles remote.lost_s remote.announce_s
    commands.max_in_flight commands.grace_s commands.urgent_s commands.record_s commands.ledger.dir commands.ledger.max_entries
    commands.ledger.max_age_s
    policy.audit.dir policy.audit.max_mb
    shadow.max_tries shadow.lease_s shadow.dir shadow.buckets.desired_max_mb shadow.buckets.desired_history
    shadow.buckets.reported_max_mb shadow.buckets.reported_max_age_days shadow.buckets.plans_max_mb
    shadow.buckets.plans_max_age_days
    http.port console.dir console.max_pages console.map.dir console.map.cache_mb console.map.upload_mb
    console.map.layers[].id console.map.layers[].name console.map.layers[].kind console.map.layers[].url
    console.map.layers[].file console.map.layers[].key_file console.map.layers[].attribution
    console.map.layers[].min_zoom console.map.layers[].max_zoom
    websocket.port websocket.max_clients
    sockets.dir sockets.state_hz sockets.max_clients
    shell.dir
    tracks.enabled tracks.dir tracks.keep_h tracks.max_mb
  )

  @now 1_795_514_400_000_000
  @nkey Nkey.generate(:user)
  @other Nkey.generate(:user)
  @key String.duplicate("k", 20)
  @key2 String.duplicate("l", 20)

  # The key, what stands beside it, its two values (`:none`: left out), and who decides.
  defp rows(dir), do: policy(dir) ++ ends() ++ signing(dir) ++ nats(dir) ++ web(dir) ++ others(dir)

  defp policy(dir) do
    takeoff = &decide(&1, "takeoff", %{"altitude" => 100})

    [
      {"policy.max_altitude", %{}, 50, 150, takeoff},
      {"policy.min_altitude", %{}, 50, 150, takeoff},
      {"policy.max_altitude_msl", %{}, 550, 650, takeoff},
      {"policy.geofence_file", %{}, fence(dir, "inclusion"), fence(dir, "exclusion"),
       &decide(&1, "goto", %{"lat" => 47.0005, "lon" => 8.0005, "altitude" => 50})},
      {"policy.takeoff_battery", %{}, 0.2, 0.3, takeoff},
      {"policy.ready_battery", %{}, 0.2, 0.3, &compiled(&1).ready_battery},
      {"policy.modes.denied", %{}, ["ACRO"], ["RTL"], &decide(&1, "set_mode", %{"mode" => "ACRO"})},
      {"policy.modes.transitions", %{}, %{"STABILIZE" => ["ACRO"]}, %{"STABILIZE" => ["RTL"]},
       &decide(&1, "set_mode", %{"mode" => "ACRO"})},
      {"policy.conditions[].types", %{"armed" => true}, ["takeoff"], ["gripper"], takeoff},
      {"policy.conditions[].armed", %{"types" => ["takeoff"]}, true, false, takeoff},
      {"policy.conditions[].in_air", %{"types" => ["takeoff"]}, true, false, takeoff},
      {"policy.windows[].types", %{noon() | "from" => "13:00"}, ["takeoff"], ["gripper"], takeoff},
      {"policy.windows[].days", noon(), ["sun"], ["mon"], takeoff},
      {"policy.windows[].from", noon(), "10:00", "13:00", takeoff},
      {"policy.windows[].to", noon(), "14:00", "11:30", takeoff},
      {"policy.rates[].types", %{"per_minute" => 1}, ["takeoff"], ["gripper"], &rate/1},
      {"policy.rates[].sources", %{"per_minute" => 1}, ["elixir"], ["shadow"], &rate/1},
      {"policy.rates[].vehicles", %{"per_minute" => 1}, ["VID-001"], ["VID-002"], &rate/1},
      {"policy.rates[].per_minute", %{}, 1, 1000, &rate/1},
      {"policy.rates[].burst", %{"per_minute" => 1}, 1, 2, &rate/1},
      {"policy.clients[].id", %{"role" => "viewer"}, "gcs-tcp", "udp", &client/1},
      {"policy.clients[].role", %{}, "viewer", "operator", &client/1},
      {"policy.clients[].permissions", %{}, [], ["terminate"], &client/1},
      {"policy.sources[].name", listed(), "a", "b", &source/1},
      {"policy.sources[].nkey", listed(), @nkey.public, @other.public, &source/1},
      {"policy.sources[].role", listed(), "viewer", "admin", &source/1},
      {"policy.sources[].permissions", listed(), [], ["terminate"], &source/1},
      {"policy.sources[].expires", listed(), "2026-01-01", "2099-01-01", &source/1},
      {"policy.unsigned", %{}, "viewer", "operator", &Sources.identify(compiled(&1), nil, "s", "b", @now)},
      {"policy.unknown", %{}, "refuse", "maintain", &decide_unknown/1},
      {"policy.open[].message", %{}, 16_000_000, 16_000_001, &compiled(&1).open},
      {"policy.open[].command", %{}, 60_000, 60_001, &decide_unknown/1},
      {"policy.lease.required", %{}, true, false, takeoff},
      {"policy.lease.take_over", %{}, "operator", "admin", &take_over/1},
      {"policy.audit.required", %{}, true, false,
       &Audit.verdict({:error, "full"}, Intent.named("takeoff"), compiled(&1).audit_required)}
    ]
  end

  # What goes in from links and clients, and out to them.
  defp ends do
    own = [
      {"links[].network", link(), "main", "north", & &1.networks},
      {"links[].gcs", link(), "allow", "deny", &commands?/1},
      {"links[].gcs", link(), "auto", "allow", &commands?/1},
      {"links[].parts", link(), true, false, & &1.parts},
      {"links[].high_latency", link(), true, false, & &1.high_latency},
      {"clients[].networks", end_client(), ["main"], :none, & &1.networks},
      {"clients[].id_offsets", end_client(), %{"main" => 10}, :none, & &1.renumber},
      {"clients[].role", end_client(), "full", "read_only", & &1.role},
      {"clients[].sniffer", end_client(), true, false, & &1.sniffer},
      {"clients[].served", end_client(), true, false, & &1.served},
      {"clients[].sign", end_client(), true, false, & &1.sign}
    ]

    filters =
      for {section, beside} <- [{"links", link()}, {"clients", end_client()}],
          way <- ["in", "out"],
          kind <- ["allow", "block"],
          {axis, a, b} <- [
            {"messages", "HEARTBEAT", "ATTITUDE"},
            {"systems", 7, 8},
            {"components", 1, 2},
            {"sources", "udp-1", "udp-2"}
          ],
          {way, axis} != {"in", "sources"} do
        probe = &Filter.pass?(Map.fetch!(&1, String.to_existing_atom(way)), heartbeat(), "udp-1")
        {"#{section}[].filter_#{way}.#{kind}_#{axis}", beside, [a], [b], probe}
      end

    owners = for {key, beside, a, b, probe} <- own ++ filters, do: {key, beside, a, b, &probe.(owner(&1))}

    secure = fn config -> config.links |> List.last() |> Spec.configured() |> elem(1) |> Signing.trust() end

    [
      {"links[].secure", %{link() | "url" => "/dev/ttyUSB9"}, true, false, secure},
      {"router.between_vehicles", %{}, "all", "none", &MavRouter.Router.Settings.from(&1).between_vehicles}
      | owners
    ]
  end

  defp signing(dir) do
    [one, two] = for n <- 1..2, do: private(dir, "sign#{n}", String.duplicate("#{n}", 64))
    beside = %{"key_file" => one}

    [
      {"signing.keys[].network", beside, "main", "north", &scope(&1, dir).id},
      {"signing.keys[].system_id", beside, 7, 8, &scope(&1, dir).id},
      {"signing.keys[].key_file", %{}, one, two, &Secret.reveal(scope(&1, dir).secret)},
      {"signing.keys[].key_env", %{}, "AERIE_NO_SUCH_KEY_1", "AERIE_NO_SUCH_KEY_2", &scope(&1, dir).source},
      {"signing.keys[].policy", beside, "required", "accept_unsigned", &unsigned(&1, dir)},
      {"signing.keys[].policy", beside, "required", "off", &unsigned(&1, dir)},
      {"signing.keys[].allow_unsigned", beside, [], [0], &unsigned(&1, dir)}
    ]
  end

  defp nats(dir) do
    [one, two] = for n <- 1..2, do: private(dir, "seed#{n}", Nkey.seed(Nkey.generate(:user)))
    [creds1, creds2] = for n <- 1..2, do: private(dir, "creds#{n}", credentials("e#{n}"))
    url = %{"nats" => %{"url" => "tls://a:4222"}}
    plain = %{"nats" => %{"url" => "nats://a:4222"}}
    user = put_in(url["nats"]["user"], "u")
    tls = put_in(url["nats"]["tls"], %{"cert_file" => "/c", "key_file" => "/k"})
    leaf = %{"nats" => %{"leaf" => %{"url" => "tls://hub", "nkey_seed_file" => one}}}
    with_creds = %{"nats" => %{"leaf" => %{"url" => "tls://hub"}}}
    leaf_tls = put_in(leaf["nats"]["leaf"]["tls"], %{"cert_file" => "/c", "key_file" => "/k"})

    [
      {"nats.mode", %{}, "embedded", "off", &(&1 |> Bridge.Settings.from() |> Bridge.Settings.on?())},
      {"nats.url", %{}, "nats://a:4222", "tls://b:4222", &connection/1},
      {"nats.token", %{}, @key, @key2, &server/1},
      {"nats.token", url, "one", "two", &connection/1},
      {"nats.user", put_in(url["nats"]["password"], "p"), "u", "v", &connection/1},
      {"nats.password", user, "p", "q", &connection/1},
      {"nats.nkey_seed_file", url, one, two, &connection/1},
      {"nats.credentials", url, creds1, creds2, &connection/1},
      {"nats.tls.enabled", plain, true, false, &connection/1},
      {"nats.tls.ca_file", url, "/a", "/b", &connection/1},
      {"nats.tls.cert_file", tls, "/a", "/b", &connection/1},
      {"nats.tls.key_file", tls, "/a", "/b", &connection/1},
      {"nats.tls.server_name", url, "a", "b", &connection/1},
      {"nats.tls.verify", url, true, false, &connection/1},
      {"nats.address", %{}, "127.0.0.1", "0.0.0.0", & &1},
      {"nats.leaf.url", leaf, "tls://a", "tls://b", &server/1},
      {"nats.leaf.nkey_seed_file", with_creds, one, two, &server/1},
      {"nats.leaf.credentials", with_creds, creds1, creds2, &server/1},
      {"nats.leaf.tls.ca_file", leaf, "/a", "/b", &server/1},
      {"nats.leaf.tls.cert_file", leaf_tls, "/a", "/b", &server/1},
      {"nats.leaf.tls.key_file", leaf_tls, "/a", "/b", &server/1}
    ]
  end

  defp web(dir) do
    [one, two] =
      for {n, role} <- [{1, "viewer"}, {2, "operator"}],
          do: private(dir, "keys#{n}", "a #{@key} role=#{role}\n")

    key = %{"api" => %{"key" => @key}}
    tls = %{"websocket" => %{"cert_file" => "/c", "key_file" => "/k"}}

    [
      {"api.key", %{}, @key, @key2, &request(&1, key: @key)},
      {"api.keys_file", %{}, one, two, &request(&1, key: @key)},
      {"api.origins", key, ["https://a"], ["https://b"], &request(&1, key: @key, origin: "https://a")},
      {"http.hosts", %{}, ["a.example"], ["b.example"],
       &Admission.host(access(&1), %{facts([]) | host: "a.example", peer: {10, 0, 0, 1}})},
      {"http.proxies", %{}, ["10.0.0.1"], ["10.0.0.2"],
       fn config ->
         proxies = Enum.map(config.http.proxies, &Aerie.Api.Settings.ip/1)
         Proxy.client({10, 0, 0, 1}, %{"x-forwarded-for" => "10.9.9.9"}, proxies)
       end},
      {"http.address", %{}, "127.0.0.1", "0.0.0.0", & &1},
      {"http.enabled", %{}, true, false, &Aerie.Api.Settings.from(&1).http.enabled},
      {"console.enabled", %{}, true, false, &Aerie.Api.Settings.from(&1).console.enabled},
      {"console.map.openstreetmap", %{}, true, false, &Aerie.Api.Settings.from(&1).console.map.openstreetmap},
      {"websocket.enabled", %{}, true, false, &Aerie.Api.Settings.from(&1).websocket.enabled},
      {"websocket.address", %{}, "127.0.0.1", "0.0.0.0", & &1},
      {"websocket.sign", %{}, true, false, &Aerie.Api.Settings.from(&1).websocket.sign},
      {"websocket.cert_file", tls, "/a", "/b", &Aerie.Api.Settings.from(&1).websocket.cert_file},
      {"websocket.key_file", tls, "/a", "/b", &Aerie.Api.Settings.from(&1).websocket.key_file}
    ]
  end

  defp others(dir) do
    [
      {"mavlink.system_id", %{}, 237, 255, & &1},
      {"mavlink.i_am_the_gcs", %{}, true, false, &Identity.Settings.from(&1).heartbeat_type},
      {"mavlink.heartbeat", %{}, true, false, &Identity.Settings.from(&1).heartbeat},
      {"mavlink.heartbeat_type", %{"mavlink" => %{"i_am_the_gcs" => true}}, "gcs", "onboard_controller",
       &Identity.Settings.from(&1).heartbeat_type},
      {"remote.enabled", %{}, true, false, &Remote.Settings.from(&1).enabled},
      {"remote.nkey_seed_file", %{}, Path.join(dir, "a"), Path.join(dir, "b"),
       &Remote.Settings.from(&1).nkey_seed_file},
      {"commands.ledger.required", %{}, true, false,
       &Aerie.Control.Commands.Settings.from(&1).ledger.required},
      {"shadow.enabled", %{}, true, false, &Shadow.Settings.from(&1).enabled},
      {"shadow.hold_s", %{}, 10, 20, &Shadow.Settings.from(&1).hold_us},
      {"shadow.allow_arming", %{}, true, false, &shadow/1},
      {"shadow.without_nats", %{}, "hold", "act", &Shadow.Settings.from(&1).without_nats},
      {"shadow.key", %{}, @key, @key2, &Secret.reveal(Shadow.Settings.from(&1).key)},
      {"shadow.hub", %{}, "hq", "ground", &Shadow.Settings.from(&1).hub},
      {"shadow.former_key", %{}, @key, @key2, &Secret.reveal(Shadow.Settings.from(&1).former_key)},
      {"shadow.vehicle_key", %{"vehicle_id" => "VID-001"}, @key, @key2,
       &Secret.reveal(Shadow.Settings.from(&1).vehicle_key)},
      {"sockets.enabled", %{}, true, false, &Aerie.Fleet.Client.Settings.from(&1).enabled},
      {"sockets.sign", %{}, true, false, &Aerie.Fleet.Client.Settings.from(&1).sign},
      {"shell.enabled", %{}, true, false, &Aerie.Node.Settings.from(&1).enabled}
    ]
  end

  test "every key with authority makes a difference", %{tmp_dir: dir} do
    for {key, beside, a, b, probe} <- rows(dir) do
      [one, two] = for value <- [a, b], do: decision(key, beside, value, probe)
      assert one != two, "#{key}: #{inspect(a)} and #{inspect(b)} both give #{inspect(one, limit: 10)}"
      # The probe itself gives the same for the same.
      assert decision(key, beside, a, probe) == one, key
    end
  end

  test "every key is in one of the lists", %{tmp_dir: dir} do
    decided = dir |> rows() |> Enum.map(&elem(&1, 0)) |> Enum.uniq()
    keys = for key <- leaves(Keys.fields(), ""), hd(String.split(key, ".")) not in @neutral, do: key

    assert keys -- (decided ++ @without) == []
    assert (decided ++ @without) -- keys == []
  end

  defp leaves(fields, above) do
    Enum.flat_map(fields, fn
      %Field{type: {:section, below}} = field -> leaves(below, "#{above}#{Field.name(field)}.")
      %Field{type: {:list, {:section, below}}} = field -> leaves(below, "#{above}#{Field.name(field)}[].")
      field -> [above <> Field.name(field)]
    end)
  end

  # What is refused is a decision, too.
  defp decision(key, beside, value, probe) do
    case Config.load(nil, overrides(key, beside, value), env: %{}) do
      {:ok, config} -> probe.(config)
      {:error, errors} -> {:refused, Enum.map(errors, & &1.path)}
    end
  end

  # A key in a list is that of its last item.
  defp overrides(key, beside, value) do
    case String.split(key, "[].", parts: 2) do
      [list, below] ->
        nested(String.split(list, "."), items(list, put(beside, String.split(below, "."), value)))

      [plain] ->
        put(beside, String.split(plain, "."), value)
    end
  end

  defp items("links", link), do: [radio("udp-1"), radio("udp-2"), north(), link]
  defp items(_other, item), do: [item]

  defp put(map, _path, :none), do: map
  defp put(map, [key], value), do: Map.put(map, key, value)
  defp put(map, [key | below], value), do: Map.put(map, key, put(map[key] || %{}, below, value))

  defp nested(path, value) do
    whole = put(%{}, path, value)

    case path do
      ["clients"] -> Map.put(whole, "links", [radio("udp-1"), radio("udp-2")])
      ["signing", _] -> Map.put(whole, "links", [radio("udp-1"), north()])
      _other -> whole
    end
  end

  defp radio(id), do: %{"id" => id, "url" => "udpin:127.0.0.1:0"}
  defp north, do: %{"id" => "north", "url" => "udpin:127.0.0.1:0", "network" => "north"}
  defp link, do: %{"id" => "last", "url" => "udpin:127.0.0.1:0"}
  defp end_client, do: %{"id" => "last", "url" => "tcpin:127.0.0.1:0"}
  defp noon, do: %{"types" => ["takeoff"], "from" => "11:00", "to" => "14:00"}
  defp listed, do: %{"name" => "a", "nkey" => @nkey.public}

  defp compiled(config) do
    {:ok, policy} = Policy.compile(config.policy)
    policy
  end

  # On the ground, disarmed, at noon of a Sunday.
  defp decide(config, type, params) do
    vehicle = %{
      "position" => %{"lat" => 47.0, "lon" => 8.0, "alt_rel" => 0, "alt_msl" => 500, "heading" => 0},
      "home" => %{"lat" => 47.0, "lon" => 8.0, "alt_msl" => 500},
      "mode" => %{"mode" => "STABILIZE", "armed" => false, "in_air" => false},
      "battery" => %{"remaining" => 0.25},
      "at" => "2026-11-22T12:00:00Z"
    }

    {:ok, context} = Context.parse(vehicle, %{name: "ops", role: :operator, permissions: []}, 0)
    fields = %{"id" => "a", "vehicle" => "VID-001", "source" => "ops", "type" => type, "params" => params}
    {:ok, command} = Command.parse(fields, context.now)
    with {:deny, rule, _reason} <- Policy.decide(compiled(config), command, context), do: {:deny, rule}
  end

  # A command that has no row.
  defp decide_unknown(config) do
    facts =
      Policy.Mavlink.facts(%MavCodec.Messages.CommandLong{command: 60_000}, %{
        autopilot: :generic,
        vehicle_type: "copter"
      })

    source = %{name: "ops", role: :admin, permissions: []}

    with {:deny, rule, _reason} <- Policy.decide(compiled(config), facts, Context.new(%{}, source, @now)),
         do: {:deny, rule}
  end

  # Two at once, and one after a second.
  defp rate(config) do
    policy = compiled(config)

    {answers, _rate} =
      Enum.map_reduce([0, 0, 1_000_000], Rate.new(), fn at, rate ->
        case Rate.take(rate, policy, "elixir", "VID-001", "takeoff", at) do
          {:ok, rate} -> {:ok, rate}
          _denied -> {:denied, rate}
        end
      end)

    answers
  end

  defp client(config) do
    path = %{
      owner: "gcs-tcp",
      text: "127.0.0.1:5000",
      principal: nil,
      side: :client,
      auto: false,
      commands: true,
      local: true
    }

    config |> compiled() |> Policy.principal(path) |> Map.take([:role, :permissions])
  end

  defp source(config) do
    header = Signature.sign(@nkey, "s", "b", DateTime.from_unix!(@now, :microsecond))
    Sources.identify(compiled(config), header, "s", "b", @now)
  end

  defp take_over(config) do
    lease = %ControlLease{holder: "other", via: "nats", since: @now}
    source = %{name: "ops", role: :operator, permissions: []}
    ControlLease.change(lease, {:take, "he is ill", nil}, source, "rest", compiled(config).lease, @now)
  end

  # The rules of the last link or client as its process makes them.
  defp owner(%{clients: [_ | _] = clients}) do
    {:ok, spec} = Client.Settings.client(List.last(clients))
    Egress.open(__MODULE__, spec).owner
  end

  defp owner(%{links: links}) do
    {:ok, spec} = Spec.configured(List.last(links))
    Egress.open(__MODULE__, spec).owner
  end

  defp commands?(owner) do
    endpoint =
      Endpoint.new(__MODULE__, {"last", 1},
        text: "10.0.0.9:14550",
        kind: :link,
        out: {:pid, self(), 1},
        listens: false
      )

    Access.commands?(endpoint, owner)
  end

  defp heartbeat, do: %MavCodec.Frame{id: 0, system: 7, component: 1, version: 2, seq: 0, payload: ""}

  defp scope(config, dir) do
    {[scope], [], []} = Signing.Scope.all(Signing.Settings.from(config), Path.join(dir, "no-keys"))
    scope
  end

  defp unsigned(config, dir) do
    {verdict, _signing} =
      Signing.Verifiers.Verifier.check(scope(config, dir), nil, %{heartbeat() | component: 2}, :radio)

    verdict
  end

  defp connection(config) do
    settings = Bridge.Settings.from(config)
    {:ok, gnat} = Bridge.Connection.Settings.gnat(settings, hd(settings.nats.url))
    Map.update(gnat, :ssl_opts, nil, &Keyword.delete(&1, :customize_hostname_check))
  end

  defp server(config) do
    nats = Bridge.Settings.from(config).nats
    {:ok, seed} = Bridge.Leaf.Config.seed(nats.leaf)
    token = if nats.token, do: Secret.reveal(nats.token), else: ""
    fields = [:address, :port, :store_dir, :max_memory_mb, :max_store_mb, :domain, :leaf]

    Bridge.NatsServer.Settings.render(
      nats
      |> Map.take(fields)
      |> Map.merge(%{name: "n", token: token, seed: seed})
    )
  end

  defp access(config) do
    {:ok, keys} = Aerie.Access.Keys.load(config.api)
    %{keys: keys, origins: config.api.origins, ports: [], hosts: config.http.hosts}
  end

  defp request(config, more), do: Admission.decide(access(config), facts(more))

  defp facts(more),
    do:
      Map.merge(
        %{peer: {127, 0, 0, 1}, forwarded: false, host: "localhost", origin: nil, key: nil},
        Map.new(more)
      )

  defp shadow(config) do
    settings = Shadow.Settings.from(config)

    Shadow.Loop.Core.new(
      "VID-001",
      settings |> Map.take([:hold_us, :max_tries, :allow_arming]) |> Map.to_list()
    ).allow_arming
  end

  defp private(dir, name, text) do
    path = Path.join(dir, name)
    File.write!(path, text)
    File.chmod!(path, 0o600)
    path
  end

  defp fence(dir, kind) do
    ring = [[8.0, 47.0], [8.001, 47.0], [8.001, 47.001], [8.0, 47.001]]
    geometry = %{"type" => "Polygon", "coordinates" => [ring]}

    private(
      dir,
      kind,
      JSON.encode!(%{"type" => "Feature", "properties" => %{"fence" => kind}, "geometry" => geometry})
    )
  end

  defp credentials(jwt) do
    """
    -----BEGIN NATS USER JWT-----
    #{jwt}
    ------END NATS USER JWT------
    -----BEGIN USER NKEY SEED-----
    #{Nkey.seed(Nkey.generate(:user))}
    ------END USER NKEY SEED------
    """
  end
end
