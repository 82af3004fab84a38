defmodule Aerie.Config.Preflight do
  @moduledoc """
  Checks what can only be found out by trying, before anything starts: ports, folders, files, programs.

  A configured port that is taken is an error; a default port is not checked, because it
  moves to the next free one. All problems are returned at once. Nothing stays open.
  """

  import Bitwise

  alias Aerie.Fleet.Bridge.Leaf
  alias Aerie.Fleet.Bridge.Events.Outbox
  alias Aerie.Base.Files.{Damaged, Format}
  alias Aerie.Config
  alias Aerie.Config.Error
  alias Aerie.Config.Preflight.Contents
  alias Aerie.Config.Yaml.Lines
  alias Aerie.Control.Ledger.Journal
  alias MavRouter.Link.Spec
  alias Aerie.Control.Policy.Compile
  alias Aerie.Base.Files.Private
  alias Aerie.Fleet.Replay.Source
  alias Aerie.Fleet.Shadow.Store.LocalStore
  alias Aerie.Fleet.Tracks
  alias Aerie.Access.Users

  @typedoc "Whether a port that is taken counts as free."
  @type ours :: (:tcp | :udp, :inet.port_number() -> boolean())

  @doc "`{:ok, warnings}` if the gateway can be started, otherwise all reasons why not. `ours?`: which ports it has already."
  @spec check(Config.t(), ours()) :: {:ok, [String.t()]} | {:error, [Error.t()]}
  def check(%Config{} = config, ours? \\ fn _protocol, _port -> false end) do
    {foreign, elsewhere} = networks(config)

    case ports(config, ours?) ++
           programs(config) ++ folders(config) ++ files(config) ++ signing(config) ++ foreign do
      [] -> {:ok, recorder(config) ++ elsewhere}
      errors -> {:error, errors}
    end
  end

  defp ports(config, ours?) do
    http =
      if config.http.enabled,
        do: tcp(config, "http.port", config.http.address, config.http.port, ours?),
        else: []

    websocket =
      if config.websocket.enabled,
        do: tcp(config, "websocket.port", config.websocket.address, config.websocket.port, ours?),
        else: []

    nats =
      if embedded?(config),
        do: tcp(config, "nats.port", config.nats.address, config.nats.port, ours?),
        else: []

    http ++
      websocket ++
      nats ++
      Enum.flat_map(Enum.with_index(config.links), &link(config, &1, ours?)) ++
      Enum.flat_map(Enum.with_index(clients(config)), &client(config, &1, ours?))
  end

  # The default one takes the first free port.
  defp clients(%{clients: :default}), do: []
  defp clients(%{clients: clients}), do: clients

  defp client(config, {%{enabled: true, url: url}, index}, ours?) do
    case Spec.parse(url) do
      {:ok, %Spec{server: true, protocol: protocol, host: ip, port: port}} when is_tuple(ip) ->
        try_open(config, "clients[#{index}].url", protocol, ip, port, ours?)

      _it_calls ->
        []
    end
  end

  defp client(_config, _not_opened, _ours?), do: []

  defp tcp(config, key, address, port, ours?) do
    {:ok, ip} = :inet.parse_strict_address(String.to_charlist(address))
    if Config.given?(config, key), do: try_open(config, key, :tcp, ip, port, ours?), else: []
  end

  defp link(config, {%{enabled: true, given: true, spec: %Spec{server: true, host: ip} = spec}, index}, ours?)
       when is_tuple(ip) do
    key = if index < listed(config), do: "links[#{index}].url", else: "mavlink.local_addr"
    try_open(config, key, spec.protocol, ip, spec.port, ours?)
  end

  defp link(config, {%{enabled: true, spec: %Spec{recorded: true, file: file}}, index}, _ours?),
    do: recording(config, "links[#{index}].url", file)

  defp link(_config, _link, _ours?), do: []

  defp listed(config),
    do: length(config.links) - if(Config.given?(config, "mavlink.local_addr"), do: 1, else: 0)

  defp try_open(_config, _key, _protocol, _ip, 0, _ours?), do: []

  defp try_open(config, key, protocol, ip, port, ours?) do
    family = if tuple_size(ip) == 8, do: [:inet6], else: []

    case open(protocol, port, [{:ip, ip} | family]) do
      :ok ->
        []

      {:error, reason} ->
        if ours?.(protocol, port), do: [], else: [taken(config, key, protocol, ip, port, reason)]
    end
  end

  defp taken(config, key, protocol, ip, port, reason) do
    place = "#{protocol |> Atom.to_string() |> String.upcase()} port #{port} of #{:inet.ntoa(ip)}"
    error(config, key, "an address that is free", "#{place}: #{:inet.format_error(reason)}")
  end

  defp open(:tcp, port, options) do
    with {:ok, socket} <- :gen_tcp.listen(port, [{:reuseaddr, true} | options]), do: :gen_tcp.close(socket)
  end

  defp open(:udp, port, options) do
    with {:ok, socket} <- :gen_udp.open(port, options), do: :gen_udp.close(socket)
  end

  defp programs(config) do
    binary = config.nats.binary

    if embedded?(config) and System.find_executable(binary) == nil do
      [
        error(
          config,
          "nats.binary",
          "a program that can be run (bin/setup brings nats-server)",
          "\"#{binary}\""
        )
      ]
    else
      []
    end
  end

  defp folders(config) do
    store = if embedded?(config), do: writable(config, "nats.store_dir", config.nats.store_dir), else: []
    store ++ outbox(config) ++ sockets(config) ++ console(config) ++ formats(config)
  end

  # This version must not use files of a newer one.
  defp formats(%Config{outbox: outbox, shadow: shadow, tracks: tracks, commands: %{ledger: ledger}} = config) do
    for {key, {:error, text}} <- [
          {"outbox.dir", Format.check(outbox.dir, Outbox.format())},
          {"shadow.dir", Format.check(shadow.dir, LocalStore.format())},
          {"tracks.dir", Format.check(tracks.dir, Tracks.Files.format())},
          {"commands.ledger.dir", Journal.check(ledger.dir)}
        ],
        do: error(config, key, "a folder that this version of Aerie can read", text)
  end

  defp console(%Config{http: %{enabled: true}, console: %{enabled: true, dir: dir}} = config) do
    case writable(config, "console.dir", dir) do
      [] -> users(config, Users.file(dir))
      errors -> errors
    end
  end

  defp console(_config), do: []

  # A damaged file is set aside when the console starts.
  defp users(config, file) do
    with {:error, text} <- Users.read(file), false <- Damaged.damaged?(file) do
      [error(config, "console.dir", "a folder with a file of users for its owner only, or none", text)]
    else
      _sound_or_damaged -> []
    end
  end

  # Without NATS nothing is written there.
  defp outbox(%Config{nats: %{mode: :off}}), do: []
  defp outbox(config), do: writable(config, "outbox.dir", config.outbox.dir)

  # The default folder may not be writable: the gateway then runs without its sockets, and reports that.
  defp sockets(%Config{sockets: %{enabled: true, dir: dir}} = config) when is_binary(dir),
    do: writable(config, "sockets.dir", dir)

  defp sockets(_config), do: []

  # The gateway runs without recordings. The first recording creates the folder, so this matters only if something is to be recorded.
  defp recorder(%Config{recorder: %{links: :off, vehicles: :off}}), do: []

  defp recorder(config) do
    for %Error{} = error <- writable(config, "recorder.dir", config.recorder.dir),
        do: "#{error}; nothing is recorded"
  end

  defp writable(config, key, dir) do
    probe = Path.join(dir, ".probe-#{System.pid()}-#{System.unique_integer([:positive])}")

    with :ok <- Private.new_folder(dir), :ok <- File.write(probe, "") do
      _ = File.rm(probe)
      []
    else
      {:error, reason} -> [error(config, key, "a folder that can be written", "#{dir}: #{text(reason)}")]
    end
  end

  defp files(config) do
    named = for {_key, _kind, _private?, file} = named <- named_files(config), file != nil, do: named

    contents =
      for {key, kind, _private?, file} <- named,
          {:error, expected, got} <- [Contents.check(kind, file)],
          do: error(config, key, expected, got)

    private = for {key, _kind, true, file} <- named, error <- private(config, key, file), do: error

    contents ++ private ++ policy(config) ++ ledger(config) ++ keys(config)
  end

  # Each with what it holds, and whether only its owner may read it. Without NATS nothing is passed on that would be signed.
  defp named_files(%Config{nats: nats, remote: remote, websocket: websocket}) do
    of_nats = [
      {"nats.credentials", :credentials, true, nats.credentials},
      {"nats.nkey_seed_file", :nkey_seed, true, nats.nkey_seed_file},
      {"nats.tls.ca_file", :certificates, false, nats.tls.ca_file},
      {"nats.tls.cert_file", :certificates, false, nats.tls.cert_file},
      {"nats.tls.key_file", :private_key, true, nats.tls.key_file}
    ]

    remote = if nats.mode == :off, do: nil, else: remote.nkey_seed_file

    Leaf.Config.files(nats.leaf) ++
      of_nats ++
      [
        {"remote.nkey_seed_file", :nkey_seed, true, remote},
        {"websocket.cert_file", :certificates, false, websocket.cert_file},
        {"websocket.key_file", :private_key, true, websocket.key_file}
      ]
  end

  defp ledger(%Config{commands: %{ledger: %{required: true, dir: dir}}} = config),
    do: writable(config, "commands.ledger.dir", dir)

  defp ledger(_config), do: []

  defp policy(%Config{policy: policy} = config) do
    case Compile.policy(policy) do
      {:ok, %{audit_required: true}} -> writable(config, "policy.audit.dir", policy.audit.dir)
      {:ok, _policy} -> []
      {:error, errors} -> for {key, expected, got} <- errors, do: error(config, key, expected, got)
    end
  end

  defp keys(config), do: keys_file(config) ++ own_file(config)

  defp keys_file(config) do
    case Aerie.Access.Keys.load(config.api) do
      {:ok, _keys} -> []
      {:error, text} -> [error(config, "api.keys_file", "a file of keys that only its owner can read", text)]
    end
  end

  # A configuration file with a key in it is a file of keys.
  defp own_file(%Config{file: file} = config) when is_binary(file) do
    if config.given["api.key"] == file,
      do: private(config, "api.key", file, "a configuration file that only its owner can read"),
      else: []
  end

  defp own_file(_config), do: []

  defp private(config, key, file, expected \\ "a file that only its owner can read") do
    case File.stat(file) do
      {:ok, %File.Stat{mode: mode}} when (mode &&& 0o077) != 0 ->
        got = "one that others can read (mode #{Integer.to_string(mode &&& 0o777, 8)}): chmod 600 #{file}"
        [error(config, key, expected, got)]

      _private_or_none ->
        []
    end
  end

  defp signing(%Config{signing: %{keys: keys}} = config) do
    for {key, index} <- Enum.with_index(keys),
        {name, source} = key_source(key),
        {:error, reason} <- [MavRouter.Signing.Key.read(source)] do
      error(config, "signing.keys[#{index}].#{name}", "a signing key that only its owner can read", reason)
    end
  end

  defp key_source(%{key_file: nil, key_env: name}), do: {"key_env", {:env, name}}
  defp key_source(%{key_file: file}), do: {"key_file", {:file, file}}

  defp readable(config, key, file) do
    case File.open(file, [:read, :raw], fn _file -> :ok end) do
      {:ok, :ok} -> []
      {:error, reason} -> [error(config, key, "a file that can be read", "#{file}: #{text(reason)}")]
    end
  end

  defp recording(config, key, file) do
    with [] <- readable(config, key, file), {:error, words} <- Source.recording(file) do
      [error(config, key, "a recording (.tlog)", words)]
    else
      :ok -> []
      errors -> errors
    end
  end

  # A misspelt network would silently see nothing. The default network always exists, because links may be added later. With
  # links from the command line the names in the file do not apply.
  defp networks(config) do
    there = Enum.uniq([config.network | Enum.map(config.links, & &1.network)])

    strays =
      for {key, network} <- named(config), network not in there do
        error(
          config,
          key,
          "a network that a link has (#{Enum.join(Enum.sort(there), ", ")})",
          "\"#{network}\""
        )
      end

    if config.given["links"] == "command line",
      do: {[], Enum.map(strays, &to_string/1)},
      else: {strays, []}
  end

  defp named(config) do
    vehicles = for {v, i} <- Enum.with_index(config.vehicles), do: {"vehicles[#{i}].network", v.network}
    keys = for {k, i} <- Enum.with_index(config.signing.keys), do: {"signing.keys[#{i}].network", k.network}

    clients =
      for {client, i} <- Enum.with_index(clients(config)),
          {key, names} <- [networks: client.networks, id_offsets: Map.keys(client.id_offsets)],
          name <- names,
          do: {"clients[#{i}].#{key}", name}

    vehicles ++ clients ++ keys
  end

  defp embedded?(config), do: config.nats.mode == :embedded

  defp text(reason), do: reason |> :file.format_error() |> to_string()

  defp error(config, key, expected, got) do
    top = key |> String.split("[") |> hd()
    source = config.given[key] || config.given[top] || config.file || "defaults"
    line = if source == config.file, do: Lines.at(config.lines, Error.segments(key))
    %Error{file: source, path: key, line: line, expected: expected, got: got}
  end
end
