defmodule Aerie.Config.Resolve do
  @moduledoc """
  What no single key can say: values derived from others, contradictions between keys, and warnings. Pure.
  """

  alias Aerie.Config
  alias Aerie.Client.Keys, as: ClientKeys
  alias Aerie.Config.Schema
  alias Aerie.Secret
  alias Aerie.Link.Clients
  alias Aerie.Link.Spec
  alias Aerie.Router.Settings

  @hub elem(Aerie.Identity.default_ids(), 0)
  @component elem(Aerie.Identity.default_ids(), 1)

  @doc "Fills in the derived values; gives the problems that remain."
  @spec run(Config.t()) :: {Config.t(), [Schema.problem()]}
  def run(%Config{} = config) do
    config =
      config
      |> system_id()
      |> component_id()
      |> heartbeat_type()
      |> vehicles()
      |> keys()
      |> links()
      |> endpoints()
      |> sampling()
      |> nats_mode()
      |> nats_userinfo()

    problems =
      Enum.flat_map(
        [
          &identity/1,
          &streams/1,
          &duplicates/1,
          &signing/1,
          &nats/1,
          &clients/1,
          &rules/1,
          &id_offsets/1,
          &ranges/1,
          &same_port/1
        ],
        & &1.(config)
      )

    {%{config | warnings: config.warnings ++ warnings(config)}, problems}
  end

  defp system_id(%{mavlink: %{system_id: nil}} = config) do
    put_in(config.mavlink.system_id, if(config.vehicle_id, do: 1, else: @hub))
  end

  defp system_id(config), do: config

  # Frames of an autopilot with our own ids would be taken for echoes of ours.
  defp component_id(%{mavlink: %{component_id: 1}} = config) do
    warning =
      "mavlink.component_id is 1, which is the autopilot's own: this gateway is component #{@component} (on-board computer)."

    %{put_in(config.mavlink.component_id, @component) | warnings: config.warnings ++ [warning]}
  end

  defp component_id(config), do: config

  defp heartbeat_type(%{mavlink: %{heartbeat_type: nil} = mavlink} = config) do
    put_in(config.mavlink.heartbeat_type, if(mavlink.i_am_the_gcs, do: :gcs, else: :onboard_controller))
  end

  defp heartbeat_type(config), do: config

  defp vehicles(config) do
    own =
      if config.vehicle_id != nil and config.mavlink.system_id != :auto,
        do: [%{id: config.vehicle_id, network: config.network, system_id: config.mavlink.system_id}],
        else: []

    listed = Enum.map(config.vehicles, &%{&1 | network: &1.network || config.network})
    %{config | vehicles: own ++ (listed -- own)}
  end

  defp keys(config) do
    put_in(config.signing.keys, Enum.map(config.signing.keys, &%{&1 | network: &1.network || config.network}))
  end

  defp links(config) do
    listed = Enum.map(config.links, &link(config, &1, true))
    %{config | links: listed ++ local_link(config, listed)}
  end

  # The address of the first gateway.yaml is one more link. Left out, it is there only when nothing else is asked for.
  defp local_link(config, listed) do
    case {config.mavlink.local_addr, listed} do
      {:off, _} -> []
      {nil, [_ | _]} -> []
      {nil, []} -> [local(config, {"0.0.0.0", 14_550}, false)]
      {address, _} -> [local(config, address, true)]
    end
  end

  defp local(config, {host, port}, given) do
    host = if String.contains?(host, ":"), do: "[#{host}]", else: host
    keys = %{id: "udp", url: "udpin:#{host}:#{port}", network: nil, label: nil, enabled: true, secure: false}
    link(config, keys, given)
  end

  # A connection string may name its id and network itself (`udpin::14550?network=field`); the keys of the list win.
  defp link(config, link, given) do
    names_network? = String.contains?(link.url, ["?network=", "&network="])
    network = link.network || if(names_network?, do: nil, else: config.network)
    {:ok, spec} = Spec.parse(link.url, id: link.id, network: network)
    Map.merge(link, %{id: spec.id, network: spec.network, given: given, spec: spec})
  end

  defp endpoints(%{clients: nil} = config), do: %{config | clients: :default}

  defp endpoints(config) do
    clients =
      for client <- config.clients do
        {:ok, spec} = Spec.parse(client.url, id: client.id)
        %{client | id: spec.id}
      end

    %{config | clients: clients}
  end

  defp listed(%{clients: :default}), do: []
  defp listed(%{clients: clients}), do: clients

  # What the types of single keys cannot tell: names of messages and classes, and what cannot be a client.
  defp rules(config) do
    links =
      for {link, i} <- Enum.with_index(config.links), words = Settings.wrong(link), do: {["links", i], words}

    clients =
      for {client, i} <- Enum.with_index(listed(config)),
          {:error, words} <- [Clients.Settings.client(client)],
          do: {["clients", i], words}

    exposed =
      for {link, i} <- Enum.with_index(config.links),
          link[:secure],
          spec = %{link.spec | options: %{secure: true}},
          {:error, words} <- [Spec.secure(spec)],
          do:
            problem(
              ["links", i, "secure"],
              "true for a cable of its own (serial, loopback, one interface)",
              words
            )

    exposed ++ for {path, words} <- links ++ clients, do: problem(path, "rules that make sense", words)
  end

  # Servers that others than this machine reach.
  defp open_to_all(clients) do
    for %{sign: true, url: url, id: id} <- clients,
        {:ok, %{kind: kind, host: host}} when kind in [:udp_server, :tcp_server] <- [Spec.parse(url)],
        not is_tuple(host) or not ClientKeys.loopback?(host),
        do: id
  end

  defp sampling(%{sampling: sampling} = config) do
    groups =
      sampling.groups
      |> short(config, "position.hz", [:position, :hz], sampling.position_hz)
      |> short(config, "attitude.hz", [:attitude, :hz], sampling.attitude_hz)
      |> short(config, "battery.threshold", [:battery, :threshold], %{
        "remaining" => sampling.battery_change_threshold
      })

    %{config | sampling: %{sampling | groups: groups}}
  end

  defp short(groups, config, key, path, value) do
    if Config.given?(config, "sampling.groups." <> key), do: groups, else: put_in(groups, path, value)
  end

  defp nats_mode(%{nats: %{mode: nil, url: url}} = config),
    do: put_in(config.nats.mode, if(url == [], do: :embedded, else: :url))

  defp nats_mode(%{nats: %{mode: :url, url: []}} = config),
    do: put_in(config.nats.url, ["nats://localhost:4222"])

  defp nats_mode(config), do: config

  # A password in a URL would be logged with it: it is moved to where secrets are.
  defp nats_userinfo(%{nats: nats} = config) do
    uris = Enum.map(nats.url, &URI.parse/1)
    userinfo = Enum.find_value(uris, & &1.userinfo)
    tls = tls?(config, uris)
    nats = %{nats | url: Enum.map(uris, &plain_url/1), tls: %{nats.tls | enabled: tls}}

    nats =
      case userinfo && String.split(userinfo, ":", parts: 2) do
        nil -> nats
        [user, password] -> %{nats | user: URI.decode(user), password: Secret.new(URI.decode(password))}
        [token] -> %{nats | token: Secret.new(URI.decode(token))}
      end

    %{config | nats: nats}
  end

  # TLS is for the servers at nats.url. In one file with mode embedded it is a contradiction, which is told; who asks for
  # `--nats embedded` with the configuration of a real gateway means the one server without the other.
  defp tls?(%{nats: %{mode: :embedded, tls: tls}} = config, _uris),
    do: tls.enabled and config.given["nats.mode"] != "command line"

  defp tls?(%{nats: nats}, uris), do: nats.tls.enabled or Enum.any?(uris, &(&1.scheme == "tls"))

  defp plain_url(uri),
    do: URI.to_string(%{uri | userinfo: nil, authority: nil, path: nil, port: uri.port || 4222})

  # A hub has nobody's id to take.
  defp identity(%{vehicle_id: nil, mavlink: %{system_id: :auto}}) do
    hint = "auto takes the id of the vehicle that this gateway is aboard of; a hub has one of its own"
    [%{problem(["mavlink", "system_id"], "a number, or vehicle_id beside it", "auto") | hint: hint}]
  end

  # A heartbeat that a vehicle takes for its operator's hides that the operator is gone (H5).
  defp identity(%{mavlink: %{i_am_the_gcs: true}}), do: []

  defp identity(%{mavlink: mavlink}) do
    hint =
      "a vehicle's failsafe would take this gateway's heartbeat for the operator's; " <>
        "give mavlink.i_am_the_gcs: true if it is meant to stand for the ground station"

    [
      {mavlink.system_id == 255, ["mavlink", "system_id"],
       "an id that no ground station uses, such as #{@hub}", "255"},
      {mavlink.heartbeat_type == :gcs, ["mavlink", "heartbeat_type"], "onboard_controller", "gcs"}
    ]
    |> failed()
    |> Enum.map(&%{&1 | hint: hint})
  end

  defp streams(%{mavlink: %{streams: streams}}) do
    for {name, _hz} <- streams, MavCodec.Dialects.All.message_id(name) == nil do
      problem(["mavlink", "streams", name], "the name of a message, such as ATTITUDE", "an unknown one")
    end
  end

  defp duplicates(config) do
    twice(config.links, & &1.id, ["links"], "link ids that differ") ++
      twice(
        Enum.uniq_by(config.links, & &1.id) ++ listed(config),
        & &1.id,
        ["clients"],
        "ids that differ, of links and of clients"
      ) ++
      twice(config.vehicles, & &1.id, ["vehicles"], "vehicle ids that differ") ++
      twice(
        config.vehicles,
        &"#{&1.network}/#{&1.system_id}",
        ["vehicles"],
        "one name for each network and system id"
      )
  end

  defp signing(%{signing: %{keys: keys}}) do
    one_of =
      for {key, index} <- Enum.with_index(keys), key.key_file == nil == (key.key_env == nil) do
        got = if key.key_file, do: "both", else: "neither"
        problem(["signing", "keys", index], "one of key_file and key_env", got)
      end

    one_of ++
      twice(
        keys,
        &"#{&1.network}/#{&1.system_id || "*"}",
        ["signing", "keys"],
        "one key for each network and system id"
      )
  end

  # A signature covers the ids.
  defp id_offsets(config) do
    signed = for %{network: network} <- config.signing.keys, uniq: true, do: network

    for {client, index} <- Enum.with_index(listed(config)),
        {network, offset} <- client.id_offsets,
        offset != 0 and network in signed,
        do: problem(["clients", index, "id_offsets"], "networks without signing keys", "\"#{network}\"")
  end

  defp twice(items, key, path, expected) do
    for {name, [_, _ | _]} <- Enum.group_by(items, key),
        do: problem(path, expected, "\"#{name}\" more than once")
  end

  defp nats(%{nats: nats}) do
    ways =
      Enum.filter([:credentials, :nkey_seed_file, :token, :user], &Map.fetch!(nats, &1))
      |> Enum.map_join(", ", &"nats.#{&1}")

    streams_mb = nats.streams.state_max_mb + nats.streams.event_max_mb

    [
      {String.contains?(ways, ","), ["nats"], "one way to sign in", ways},
      {nats.password != nil and nats.user == nil, ["nats", "user"], "a user name for nats.password",
       "nothing"},
      {nats.tls.cert_file == nil != (nats.tls.key_file == nil), ["nats", "tls"],
       "cert_file and key_file together", "one of them"},
      {nats.mode == :embedded and nats.tls.enabled, ["nats", "tls", "enabled"],
       "false with nats.mode embedded (the connection does not leave this machine)", "true"},
      {nats.mode == :embedded and nats.max_store_mb < streams_mb, ["nats", "max_store_mb"],
       "at least #{streams_mb}: nats.streams.state_max_mb (#{nats.streams.state_max_mb}) and event_max_mb " <>
         "(#{nats.streams.event_max_mb}), which the server reserves", "#{nats.max_store_mb}"},
      {nats.retry_max_ms < nats.retry_min_ms, ["nats", "retry_max_ms"], "at least nats.retry_min_ms",
       "#{nats.retry_max_ms}"}
    ]
    |> failed()
  end

  defp clients(%{api: api, http: http, websocket: websocket} = config) do
    short? = api.key != nil and byte_size(Secret.reveal(api.key)) < ClientKeys.shortest()
    keyless? = api.key == nil and api.keys_file == nil

    [
      {short?, ["api", "key"], "#{ClientKeys.shortest()} characters or more", "a shorter one"},
      {websocket.cert_file == nil != (websocket.key_file == nil), ["websocket"],
       "cert_file and key_file together", "one of them"},
      {http.enabled and keyless? and not local?(http.address), ["http", "address"],
       "a loopback address as long as there is no key (api.key or api.keys_file)", http.address},
      {websocket.enabled and keyless? and not local?(websocket.address), ["websocket", "address"],
       "a loopback address as long as there is no key (api.key or api.keys_file)", websocket.address},
      {websocket.enabled and config.http.enabled and websocket.port == config.http.port and
         websocket.port != 0, ["websocket", "port"], "another port than http.port", "#{websocket.port}"}
    ]
    |> failed()
  end

  defp local?(address) do
    {:ok, ip} = :inet.parse_strict_address(String.to_charlist(address))
    ClientKeys.loopback?(ip)
  end

  defp ranges(config) do
    outbox = config.outbox

    [
      {config.timeouts.vehicle_lost_s <= config.timeouts.vehicle_stale_s, ["timeouts", "vehicle_lost_s"],
       "more than timeouts.vehicle_stale_s (#{config.timeouts.vehicle_stale_s})",
       "#{config.timeouts.vehicle_lost_s}"},
      {config.events.battery_critical > config.events.battery_low, ["events", "battery_critical"],
       "at most events.battery_low (#{config.events.battery_low})", "#{config.events.battery_critical}"},
      {outbox.segment_kb * 2 > outbox.max_mb * 1024, ["outbox", "segment_kb"],
       "at most half of outbox.max_mb (#{div(outbox.max_mb * 1024, 2)})", "#{outbox.segment_kb}"},
      {config.nats.mode == :embedded and
         config.nats.streams.state_max_mb + config.nats.streams.event_max_mb > config.nats.max_store_mb,
       ["nats", "max_store_mb"], "at least the size of both streams (nats.streams)",
       "#{config.nats.max_store_mb}"},
      {length(config.links) > config.limits.max_links, ["links"],
       "at most limits.max_links (#{config.limits.max_links})", "#{length(config.links)}"},
      {length(config.serial.ports) > 16, ["serial", "ports"], "16 ports at most",
       "#{length(config.serial.ports)}"},
      {length(config.serial.bauds) not in 1..20, ["serial", "bauds"], "1 to 20 baud rates",
       "#{length(config.serial.bauds)}"},
      {length(listed(config)) > config.limits.max_clients, ["clients"],
       "at most limits.max_clients (#{config.limits.max_clients})", "#{length(listed(config))}"},
      {length(config.vehicles) > config.limits.max_vehicles, ["vehicles"],
       "at most limits.max_vehicles (#{config.limits.max_vehicles})", "#{length(config.vehicles)}"},
      {config.recorder.max_file_mb > config.recorder.max_mb, ["recorder", "max_file_mb"],
       "at most recorder.max_mb (#{config.recorder.max_mb})", "#{config.recorder.max_file_mb}"},
      {config.http.port == config.nats.port and config.nats.mode == :embedded and config.http.enabled and
         config.http.port != 0, ["http", "port"], "another port than nats.port", "#{config.http.port}"}
    ]
    |> failed()
  end

  defp same_port(config) do
    config.links
    |> Enum.filter(&(&1.enabled and &1.spec.kind in [:udp_server, :tcp_server] and &1.spec.port != 0))
    |> twice(
      &"#{&1.spec.kind |> protocol()} #{Spec.place(&1.spec)}",
      ["links"],
      "addresses to listen on that differ"
    )
  end

  defp protocol(:udp_server), do: "UDP"
  defp protocol(:tcp_server), do: "TCP"

  defp failed(checks), do: for({true, path, expected, got} <- checks, do: problem(path, expected, got))
  defp problem(path, expected, got), do: %{path: path, expected: expected, got: got, hint: nil}

  defp warnings(%{mavlink: mavlink, nats: nats} = config) do
    [
      {is_nil(config.vehicle_id) and Enum.any?(config.vehicles, &(&1.system_id == mavlink.system_id)),
       "mavlink.system_id #{mavlink.system_id} is also a vehicle's in the list: a hub needs an id of its own, " <>
         "such as #{@hub}. Aboard that vehicle, give vehicle_id instead."},
      {not is_nil(config.policy.max_altitude) or not is_nil(config.policy.geofence_file),
       "policy is NOT ENFORCED: this version reads and checks the section, but applies no altitude limit and no fence " <>
         "to any command. Set the limits on the vehicles themselves."},
      {Enum.any?(config.signing.keys, &(&1.policy != :required)),
       "signing.keys: a policy other than required is UNSAFE: frames that anybody could have sent are taken in."},
      {open_to_all(listed(config)) != [],
       "clients #{Enum.join(open_to_all(listed(config)), ", ")}: sign: true for a server that is not on loopback is UNSAFE: " <>
         "whoever reaches it has his commands signed."},
      {not nats.tls.verify and nats.tls.enabled,
       "nats.tls.verify is false: anybody on the way can read and change what is sent to NATS."},
      {config.websocket.enabled and config.websocket.cert_file == nil and not local?(config.websocket.address),
       "websocket.address is on the network without websocket.cert_file: keys and frames can be read on the way."},
      {not is_nil(nats.password) and nats.mode == :url and not nats.tls.enabled and not loopback?(nats.url),
       "nats.password goes over the network without TLS."}
    ]
    |> then(&for {true, text} <- &1, do: text)
  end

  defp loopback?(urls),
    do: Enum.all?(urls, &(URI.parse(&1).host in ["localhost", "127.0.0.1", "::1", "[::1]"]))
end
