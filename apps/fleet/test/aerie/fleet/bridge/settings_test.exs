defmodule Aerie.Fleet.Bridge.SettingsTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Connection.Settings
  alias Aerie.Fleet.Bridge.{Message, Metrics, Streams}
  alias Gnat.Jetstream.API.Stream

  @moduletag :tmp_dir

  defp gnat(overrides, url \\ "nats://nats.example:4333"),
    do: Settings.gnat(Aerie.BridgeCase.settings([{"nats.url", url} | overrides]), url)

  describe "settings of the connection" do
    test "host, port and time-out; IPv6 with its family" do
      assert {:ok, %{host: "nats.example", port: 4333, connection_timeout: 500}} =
               gnat([{"nats.connect_timeout_s", 0.5}])

      assert {:ok, %{host: "::1", port: 4222, tcp_opts: [:binary, :inet6 | tcp]}} = gnat([], "nats://[::1]")
      assert tcp[:send_timeout] == 10_000
    end

    test "one way to log in, revealed only here", %{tmp_dir: dir} do
      assert {:ok, %{username: "a", password: "b", auth_required: true}} =
               gnat([{"nats.user", "a"}, {"nats.password", "b"}])

      assert {:ok, %{token: "t"}} = gnat([{"nats.token", "t"}])
      seed = Nkey.seed(Nkey.generate(:user))

      File.write!(Path.join(dir, "creds"), """
      -----BEGIN NATS USER JWT-----
      a.b.c
      ------END NATS USER JWT------
      -----BEGIN USER NKEY SEED-----
      #{seed}
      ------END USER NKEY SEED------
      """)

      assert {:ok, %{jwt: "a.b.c", nkey_seed: ^seed}} = gnat([{"nats.credentials", Path.join(dir, "creds")}])
      assert {:error, "/x.creds: no such file" <> _} = gnat([{"nats.credentials", "/x.creds"}])
      File.write!(Path.join(dir, "seed"), "SUABC\n")
      assert {:ok, %{nkey_seed: "SUABC"}} = gnat([{"nats.nkey_seed_file", Path.join(dir, "seed")}])

      assert {:error, "cannot read nats.nkey_seed_file" <> _} =
               gnat([{"nats.nkey_seed_file", Path.join(dir, "none")}])
    end

    test "TLS checks the server's name, unless that is switched off" do
      assert {:ok, settings} = gnat([{"nats.tls.ca_file", "/ca.pem"}], "tls://nats.example")
      assert settings.tls
      assert settings.ssl_opts[:verify] == :verify_peer
      assert settings.ssl_opts[:cacertfile] == "/ca.pem"
      assert settings.ssl_opts[:server_name_indication] == ~c"nats.example"

      own = [
        {"nats.tls.enabled", true},
        {"nats.tls.verify", false},
        {"nats.tls.cert_file", "/c.pem"},
        {"nats.tls.key_file", "/k.pem"}
      ]

      assert {:ok, settings} = gnat(own)
      assert settings.ssl_opts == [verify: :verify_none, certfile: "/c.pem", keyfile: "/k.pem"]
      assert {:ok, settings} = gnat([])
      refute Map.has_key?(settings, :tls)
    end
  end

  describe "streams" do
    test "differences are texts; defaults that the server fills in are not differences" do
      [state, events] = Streams.wanted(Aerie.BridgeCase.settings())
      assert Streams.differences(state, %{state | max_age: 0, allow_rollup_hdrs: nil}) == []

      assert Streams.differences(events, %{events | max_bytes: -1, subjects: ["a", "b"]}) == [
               "subjects is a b, configured fleet.*.*.event.>",
               "max_bytes is -1, configured 536870912"
             ]
    end

    test "a duplicate window is never longer than events live, or the server refuses the stream" do
      config = Aerie.BridgeCase.settings([{"nats.streams.event_max_age_days", 0.01}])
      assert [_, %Stream{max_age: age, duplicate_window: age}] = Streams.wanted(config)
      config = Aerie.BridgeCase.settings([{"nats.streams.event_max_age_days", 0}])
      assert [_, %Stream{max_age: 0, duplicate_window: 3_600_000_000_000}] = Streams.wanted(config)
    end
  end

  test "numbers that JSON has no form for are null, bytes that are not text are replaced, structure stays" do
    data = %{
      a: :nan,
      b: {:nan, 5},
      c: [:infinity, %{d: :neg_infinity}],
      e: nil,
      f: true,
      g: "ok",
      h: <<255>>,
      i: 1.5
    }

    body = "V" |> Message.state("gps", data, nil, 0) |> JSON.decode!()

    assert body["data"] == %{
             "a" => nil,
             "b" => nil,
             "c" => [nil, %{"d" => nil}],
             "e" => nil,
             "f" => true,
             "g" => "ok",
             "h" => "\uFFFD",
             "i" => 1.5
           }

    assert body["time"] == "1970-01-01T00:00:00.000Z"
  end

  test "metrics have the names, types and help that Prometheus wants" do
    gateway = make_ref()
    start_supervised!({Aerie.Base.Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
    start_supervised!({Aerie.Fleet.Bridge.Status.Tables, gateway: gateway})
    tables = Aerie.Fleet.Bridge.Status.Tables.get(gateway)
    Aerie.Fleet.Bridge.Status.Tables.count(tables, :published, [subject: "state.position"], 3)
    metrics = Metrics.all(gateway, tables)

    assert Enum.find(metrics, &(&1.name == "gateway_nats_messages_published_total")).samples == [
             {[subject: "state.position"], 3}
           ]

    assert Enum.find(metrics, &(&1.name == "gateway_nats_publish_errors_total")).samples == [{[], 0}]

    for metric <- metrics do
      assert metric.name =~ ~r/\Agateway_[a-z_]+\z/
      assert String.ends_with?(metric.name, "_total") == (metric.type == :counter)
      assert String.ends_with?(metric.help, ".")
    end
  end
end
