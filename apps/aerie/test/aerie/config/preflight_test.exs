defmodule Aerie.Config.PreflightTest do
  use ExUnit.Case, async: true

  alias Aerie.Config
  alias Aerie.Config.Preflight

  @moduletag :tmp_dir

  defp config(dir, overrides) do
    Config.default(
      [
        {"nats.store_dir", Path.join(dir, "nats")},
        {"outbox.dir", Path.join(dir, "outbox")},
        {"policy.audit.dir", Path.join(dir, "audit")},
        {"commands.ledger.dir", Path.join(dir, "ledger")},
        {"nats.binary", "sh"}
      ] ++
        overrides
    )
  end

  defp lines({:error, errors}), do: Enum.map(errors, &to_string/1)

  test "everything that is wrong is found before anything is started", %{tmp_dir: dir} do
    {:ok, tcp} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, udp} = :gen_udp.open(0, ip: {127, 0, 0, 1})
    {:ok, tcp_port} = :inet.port(tcp)
    {:ok, udp_port} = :inet.port(udp)
    File.write!(Path.join(dir, "file"), "")

    config =
      config(dir, [
        {"http.port", tcp_port},
        {"links",
         [%{url: "tcp:127.0.0.1:1"}, %{url: "udpin:127.0.0.1:#{udp_port}"}, %{url: "replay:#{dir}/no.tlog"}]},
        {"nats.binary", "no-such-program"},
        {"nats.store_dir", Path.join(dir, "file")},
        {"policy.geofence_file", Path.join(dir, "fence.json")},
        {"policy.conditions", [%{types: ["rebot"], armed: false}]}
      ])

    assert lines(Preflight.check(config)) == [
             "command line: http.port: expected an address that is free, " <>
               "got TCP port #{tcp_port} of 127.0.0.1: address already in use",
             "command line: links[1].url: expected an address that is free, " <>
               "got UDP port #{udp_port} of 127.0.0.1: address already in use",
             "command line: links[2].url: expected a file that can be read, " <>
               "got #{dir}/no.tlog: no such file or directory",
             "command line: nats.binary: expected a program that can be run (bin/setup brings nats-server), " <>
               ~s|got "no-such-program"|,
             "command line: nats.store_dir: expected a folder that can be written, got #{dir}/file: " <>
               "not a directory",
             "command line: policy.geofence_file: expected a fence, got #{dir}/fence.json: no such file or directory",
             "command line: policy.conditions[0].types: expected names of commands (docs/commands.md lists them), " <>
               ~s|got rebot (did you mean "reboot"?)|
           ]
  end

  test "folders that a newer version wrote are refused with what to do", %{tmp_dir: dir} do
    for {name, text} <- [{"outbox", "aerie-outbox 99\n"}, {"shadow", "aerie-shadow 99\n"}] do
      File.mkdir_p!(Path.join(dir, name))
      File.write!(Path.join([dir, name, "FORMAT"]), text)
    end

    File.mkdir_p!(Path.join(dir, "ledger"))
    File.write!(Path.join(dir, "ledger/ledger"), "aerie-ledger 9\n")
    config = config(dir, [{"shadow.dir", Path.join(dir, "shadow")}])
    assert {:error, errors} = Preflight.check(config)

    assert Enum.sort(for(error <- errors, do: error.path)) == [
             "commands.ledger.dir",
             "outbox.dir",
             "shadow.dir"
           ]

    for error <- errors, do: assert(error.got =~ "newer version of Aerie")
  end

  test "a taken default is not an error: the next free one is taken", %{tmp_dir: dir} do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    config = config(dir, [])
    assert Preflight.check(%{config | http: %{config.http | port: port}}) == {:ok, []}
  end

  test "a folder of recordings that cannot be written is a warning, if something is to be recorded", %{
    tmp_dir: dir
  } do
    File.write!(Path.join(dir, "file"), "")
    there = {"recorder.dir", Path.join(dir, "file")}
    assert {:ok, []} = Preflight.check(config(dir, [there]))
    assert {:ok, [warning]} = Preflight.check(config(dir, [there, {"recorder.vehicles", "armed"}]))
    assert warning =~ "recorder.dir" and warning =~ "nothing is recorded"
  end

  test "an outbox that cannot be written is refused, where anything would be written to it", %{tmp_dir: dir} do
    File.write!(Path.join(dir, "file"), "")
    there = {"outbox.dir", Path.join(dir, "file")}
    assert [line] = lines(Preflight.check(config(dir, [there])))
    assert line =~ "outbox.dir: expected a folder that can be written" and line =~ Path.join(dir, "file")
    assert Preflight.check(config(dir, [there, {"nats.mode", "off"}])) == {:ok, []}
  end

  describe "a file that holds something else" do
    setup %{tmp_dir: dir} do
      file = Path.join(dir, "file")
      refused = fn key, content -> refused(dir, file, key, content) end
      %{path: file, refused: refused}
    end

    test "an nkey seed", %{refused: refused, tmp_dir: dir, path: file} do
      line = refused.("nats.nkey_seed_file", "hello\n")
      assert line =~ "nats.nkey_seed_file: expected a file with the nkey seed of a user (SU…)"
      assert line =~ file <> ": not an nkey seed"
      refute line =~ "hello"
      account = Nkey.seed(Nkey.generate(:account))
      assert refused.("nats.nkey_seed_file", account) =~ "for account, not for a user"
      write(file, Nkey.seed(Nkey.generate(:user)) <> "\n")
      assert Preflight.check(url(dir, [{"nats.nkey_seed_file", file}])) == {:ok, []}
    end

    test "credentials", %{refused: refused} do
      assert refused.("nats.credentials", "SUXXXX") =~ "no NATS USER JWT block"
    end

    test "certificates and keys", %{refused: refused, tmp_dir: dir, path: file} do
      assert refused.("nats.tls.ca_file", "hello") =~
               "expected a PEM file with certificates, got #{file}: it is not PEM"

      key = :public_key.generate_key({:namedCurve, :secp256r1})
      pem = :public_key.pem_encode([:public_key.pem_entry_encode(:ECPrivateKey, key)])
      assert refused.("nats.tls.ca_file", pem) =~ "no certificate in it"

      broken = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"
      assert refused.("nats.tls.ca_file", broken) =~ "cannot be decoded"

      %{cert: der} = :public_key.pkix_test_root_cert(~c"test", [])
      certificate = :public_key.pem_encode([{:Certificate, der, :not_encrypted}])
      write(file, certificate)
      assert Preflight.check(url(dir, [{"nats.tls.ca_file", file}])) == {:ok, []}

      write(Path.join(dir, "key.pem"), pem)
      pair = [{"nats.tls.cert_file", file}, {"nats.tls.key_file", Path.join(dir, "key.pem")}]
      assert Preflight.check(url(dir, pair)) == {:ok, []}
      pair = [{"nats.tls.cert_file", file}, {"nats.tls.key_file", file}]
      assert [line] = lines(Preflight.check(url(dir, pair)))
      assert line =~ "nats.tls.key_file: expected a PEM file with a private key"
    end

    test "the seed that signs commands for remote vehicles", %{refused: refused, tmp_dir: dir, path: file} do
      line = refused.("remote.nkey_seed_file", "hello\n")
      assert line =~ "remote.nkey_seed_file: expected a file with the nkey seed of a user (SU…)"
      assert line =~ file <> ": not an nkey seed"
      refute line =~ "hello"
      server = Nkey.seed(Nkey.generate(:server))
      assert refused.("remote.nkey_seed_file", server) =~ "for server, not for a user"
      write(file, Nkey.seed(Nkey.generate(:user)))
      assert Preflight.check(url(dir, [{"remote.nkey_seed_file", file}])) == {:ok, []}
      assert [line] = lines(Preflight.check(url(dir, [{"remote.nkey_seed_file", file <> "s"}])))
      assert line =~ "no such file"
      # Without NATS nothing is passed on.
      assert Preflight.check(config(dir, [{"nats.mode", "off"}, {"remote.nkey_seed_file", file <> "s"}])) ==
               {:ok, []}
    end

    for key <-
          ~w(nats.credentials nats.nkey_seed_file nats.tls.key_file remote.nkey_seed_file websocket.key_file
             nats.leaf.nkey_seed_file) do
      @key key
      test "#{key} that others can read", %{tmp_dir: dir, path: file} do
        write(file, content(@key))
        certificate = Path.join(dir, "certificate.pem")
        File.write!(certificate, certificate())
        config = config(dir, [{@key, file} | beside(@key, certificate)])
        assert Preflight.check(config) == {:ok, []}

        for mode <- [0o640, 0o604] do
          File.chmod!(file, mode)
          assert [line] = lines(Preflight.check(config))

          assert line =~
                   "#{@key}: expected a file that only its owner can read, got one that others can read"

          assert line =~ "chmod 600 #{file}"
        end
      end
    end

    defp content("nats.credentials") do
      """
      -----BEGIN NATS USER JWT-----
      eyJ0eXAi
      ------END NATS USER JWT------
      -----BEGIN USER NKEY SEED-----
      #{Nkey.seed(Nkey.generate(:user))}
      ------END USER NKEY SEED------
      """
    end

    defp content(key) do
      if key =~ "nkey" do
        Nkey.seed(Nkey.generate(:user))
      else
        key = :public_key.generate_key({:namedCurve, :secp256r1})
        :public_key.pem_encode([:public_key.pem_entry_encode(:ECPrivateKey, key)])
      end
    end

    defp certificate do
      %{cert: der} = :public_key.pkix_test_root_cert(~c"test", [])
      :public_key.pem_encode([{:Certificate, der, :not_encrypted}])
    end

    # What a key needs beside it.
    defp beside("nats.leaf" <> _key, _certificate), do: [{"nats.leaf.url", ["nats://127.0.0.1:7422"]}]
    defp beside("websocket" <> _key, certificate), do: [{"websocket.cert_file", certificate}]

    defp beside("nats.tls" <> _key, certificate),
      do: [{"nats.url", "tls://127.0.0.1:4222"}, {"nats.tls.cert_file", certificate}]

    defp beside(_key, _certificate), do: [{"nats.url", "nats://127.0.0.1:4222"}]

    # For its owner only.
    defp write(file, content) do
      File.write!(file, content)
      File.chmod!(file, 0o600)
    end

    defp refused(dir, file, key, content) do
      write(file, content)
      assert [line] = lines(Preflight.check(url(dir, [{key, file}])))
      line
    end

    defp url(dir, overrides) do
      tls? = Enum.any?(overrides, fn {key, _value} -> String.starts_with?(key, "nats.tls") end)

      config(dir, [
        {"nats.url", if(tls?, do: "tls://127.0.0.1:4222", else: "nats://127.0.0.1:4222")} | overrides
      ])
    end
  end

  test "nothing stays open, and what was checked can be opened", %{tmp_dir: dir} do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :gen_tcp.close(socket)
    assert {:ok, []} = Preflight.check(config(dir, [{"http.port", port}]))
    assert {:ok, _socket} = :gen_tcp.listen(port, ip: {127, 0, 0, 1})
  end

  test "keys that others could read are refused, wherever they stand", %{tmp_dir: dir} do
    keys = Path.join(dir, "keys")
    File.write!(keys, "alice 0123456789abcdef\n")
    File.chmod!(keys, 0o640)
    assert [line] = lines(Preflight.check(config(dir, [{"api.keys_file", keys}])))
    assert line =~ "api.keys_file" and line =~ "chmod 600"
    File.chmod!(keys, 0o600)
    assert Preflight.check(config(dir, [{"api.keys_file", keys}])) == {:ok, []}

    file = Path.join(dir, "gateway.yaml")
    File.write!(file, "api: {key: 0123456789abcdef}\n")
    File.chmod!(file, 0o644)
    overrides = [{"nats.mode", "off"}, {"outbox.dir", dir}]
    {:ok, config} = Config.load(file, overrides, env: %{})
    assert [line] = lines(Preflight.check(config))
    assert line =~ "api.key" and line =~ "chmod 600" and not (line =~ "0123456789abcdef")
    # From the environment, the file's mode does not matter.
    {:ok, config} = Config.load(file, overrides, env: %{"AERIE_API_KEY" => "fedcba9876543210"})
    assert Preflight.check(config) == {:ok, []}
    File.chmod!(file, 0o600)
    {:ok, config} = Config.load(file, overrides, env: %{})
    assert Preflight.check(config) == {:ok, []}
  end

  test "what the interfaces for clients need is looked at before anything starts", %{tmp_dir: dir} do
    {:ok, tcp} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(tcp)
    file = Path.join(dir, "file")
    write(file, "")

    config =
      config(dir, [
        {"websocket.port", port},
        {"websocket.cert_file", Path.join(dir, "no.pem")},
        {"websocket.key_file", file},
        {"sockets.dir", Path.join(file, "below")}
      ])

    assert [port_line, dir_line, cert_line, key_line] = lines(Preflight.check(config))
    assert port_line =~ "websocket.port" and port_line =~ "address already in use"
    assert dir_line =~ "sockets.dir" and dir_line =~ "not a directory"
    assert cert_line =~ "websocket.cert_file" and cert_line =~ "no such file"
    assert key_line =~ "websocket.key_file" and key_line =~ "it is not PEM"
  end

  test "a network that no link has is refused, with the key and the networks that there are", %{tmp_dir: dir} do
    links = [%{url: "tcp:127.0.0.1:1", network: "north"}, %{url: "tcp:127.0.0.1:2", network: "south"}]
    vehicles = [%{id: "V-1", network: "nroth", system_id: 1}, %{id: "V-2", network: "south", system_id: 2}]

    clients = [
      %{id: "c", url: "tcpin:127.0.0.1:0", networks: ["north", "main", "East"], id_offsets: %{west: 5}}
    ]

    text = JSON.encode!(%{links: links, vehicles: vehicles, clients: clients, nats: %{mode: "off"}})
    file = Path.join(dir, "gateway.yaml")
    File.write!(file, text)
    {:ok, config} = Config.load(file, [{"outbox.dir", Path.join(dir, "outbox")}], env: %{})

    assert lines(Preflight.check(config)) ==
             for(
               {key, name} <- [
                 {"vehicles[0].network", "nroth"},
                 {"clients[0].networks", "East"},
                 {"clients[0].id_offsets", "west"}
               ],
               do: ~s|#{file}: #{key}: expected a network that a link has (main, north, south), got "#{name}"|
             )

    # A recording or a link of the command line takes the place of the file's links: their names wait for another day.
    overrides = [{"outbox.dir", Path.join(dir, "outbox")}, {"links", [%{url: "tcp:127.0.0.1:1"}]}]
    {:ok, config} = Config.load(file, overrides, env: %{})
    assert {:ok, [_nroth, _south, _north, _east, _west] = warnings} = Preflight.check(config)
    assert Enum.all?(warnings, &(&1 =~ "expected a network that a link has (main)"))
  end

  test "a replay file that is not a recording is refused", %{tmp_dir: dir} do
    heartbeat = MavCodec.encode(%MavCodec.Messages.Heartbeat{type: 2, autopilot: 3}, system: 1)
    record = <<1_700_000_000_000_000::64, heartbeat::binary>>

    files = [
      {"text.tlog", String.duplicate("not a flight\n", 10_000), "not a recording"},
      {"empty.tlog", "", "not a recording"},
      {"zip.tlog", :zlib.gzip("not a flight either"), "not a recording"},
      {"flight.tlog", record, nil},
      {"torn.tlog", "torn" <> record, nil},
      {"flight.tlog.gz", :zlib.gzip(record), nil}
    ]

    for {name, bytes, reason} <- files do
      file = Path.join(dir, name)
      File.write!(file, bytes)

      result =
        Preflight.check(config(dir, [{"links", [%{url: "replay:#{file}"}]}, {"mavlink.local_addr", "off"}]))

      if reason do
        assert [line] = lines(result)
        assert line =~ "links[0].url: expected a recording (.tlog), got #{file}: not a recording"
      else
        assert {name, result} == {name, {:ok, []}}
      end
    end
  end
end
