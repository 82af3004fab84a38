defmodule Aerie.CLI.OptionsTest do
  use ExUnit.Case, async: true

  alias Aerie.CLI.Start
  alias Aerie.CLI.Start.{Options, Plan}

  describe "what was given" do
    test "no argument starts a demo with defaults" do
      assert {:ok, %Options{links: [], sim: nil, quiet: false, speed: 1.0}} = Start.parse([])
    end

    test "links keep their order" do
      assert {:ok, %{links: ["udpin:0.0.0.0:14550", "tcp:127.0.0.1:5760"]}} =
               Start.parse(["--link", "udpin:0.0.0.0:14550", "--link", "tcp:127.0.0.1:5760"])
    end

    test "speed is a number or max, and needs a replay or simulated vehicles" do
      assert {:ok, %{speed: :max, replay: "a.tlog"}} = Start.parse(["--replay", "a.tlog", "--speed", "max"])
      assert {:ok, %{speed: 2.5}} = Start.parse(["--replay", "a.tlog", "--speed", "2.5"])
      assert {:error, "--speed" <> _} = Start.parse(["--speed", "2"])

      for bad <- ["0", "-1", "fast", "1e9", ""],
          do: assert({:error, _} = Start.parse(["--replay", "a", "--speed", bad]))

      assert {:ok, %{speed: 5.0, sim: 2}} = Start.parse(~w(--sim 2 --speed 5))
      assert {:error, "--speed" <> _} = Start.parse(~w(--sim 2 --speed max))
      assert {:error, "--speed" <> _} = Start.parse(~w(--sim 2 --speed 0.01))
    end

    test "help and version win over everything else" do
      assert Start.parse(["--sim", "2", "--help"]) |> elem(0) == :help
      assert Start.parse(["-h"]) |> elem(0) == :help
      assert Start.parse(["--version"]) == :version
    end

    test "each error says what is wrong and what is expected" do
      assert {:error, message} = Start.parse(["--lnk", "x"])
      assert message =~ "did you mean --link?"
      assert {:error, message} = Start.parse(["--http", "99999"])
      assert message =~ "0 to 65535"
      assert {:error, message} = Start.parse(["--sim", "many"])
      assert message =~ "not a whole number"
      assert {:error, message} = Start.parse(["--sim", "-1"])
      assert message =~ "expected 0 to"
      assert {:error, message} = Start.parse(["udpin:0.0.0.0:14550"])
      assert message =~ "unexpected"
      assert {:error, message} = Start.parse(["--nats", "hub"])
      assert message =~ "nats://"
      assert {:error, message} = Start.parse(["--link"])
      assert message =~ "--link needs a value"
      assert {:error, message} = Start.parse(["--replay", "a.tlog", "--link", "tcp:h:1"])
      assert message =~ "exclude"
      assert {:error, message} = Start.parse(["--xyzzy"])
      assert message =~ "unknown option --xyzzy"
    end

    test "the help names every option" do
      {:help, help} = Start.parse(["--help"])

      for name <-
            ~w(--link --replay --speed --sim --config --http --nats --quiet --version --help) do
        assert help =~ name
      end
    end
  end

  describe "Plan.from/2" do
    defp plan(words) do
      {:ok, options} = Start.parse(words)
      Plan.from(options, "/home/me")
    end

    test "three simulated vehicles fly without a link, a replay or a configuration" do
      assert %{sim: 3, config_file: nil, overrides: overrides} = plan([])
      assert overrides == %{}
      assert plan(["--http", "0", "--nats", "embedded"]).sim == 3
    end

    test "with one of them, none fly unless --sim asks for them" do
      assert plan(["--link", "tcp:h:1"]).sim == 0
      assert plan(["--replay", "a.tlog"]).sim == 0
      assert plan(["--config", "c.yaml"]).sim == 0
      assert plan(["--config", "c.yaml", "--sim", "2"]).sim == 2
      assert plan(["--sim", "0"]).sim == 0
    end

    test "paths are relative to the user's directory, and a replay excludes live vehicles" do
      assert plan(["--config", "c.yaml"]).config_file == "/home/me/c.yaml"
      plan = plan(["--replay", "log/a.tlog", "--speed", "max"])
      assert [%{"url" => "replay:/home/me/log/a.tlog?speed=max"}] = plan.overrides["links"]
      assert plan.overrides["mavlink"]["local_addr"] == "off"
    end

    test "the command line's NATS and HTTP are overrides" do
      assert plan(["--nats", "nats://hub:4222"]).overrides["nats"] == %{
               "mode" => "url",
               "url" => "nats://hub:4222"
             }

      assert plan(["--nats", "embedded"]).overrides["nats"] == %{"mode" => "embedded"}
      assert plan(["--http", "8080"]).overrides["http"] == %{"enabled" => true, "port" => 8080}
    end
  end

  describe "an option over a configuration" do
    @describetag :tmp_dir

    # Every section that an option touches, with keys that have other values than their defaults.
    @file_text """
    environment: prod
    mavlink: {local_addr: ":14999", system_id: 244, component_id: 192, streams: {ATTITUDE: 5}}
    links: [{id: field, url: "udpin:127.0.0.1:14888"}]
    nats:
      url: "tls://hub.example:4222"
      credentials: vehicle.creds
      tls: {enabled: true, ca_file: ca.pem, cert_file: own.pem, key_file: own.key, server_name: hub, verify: true}
      port: 4999
      streams: {event_max_mb: 77}
      retry_max_ms: 5000
    http: {enabled: true, address: "127.0.0.2", port: 4001}
    websocket: {enabled: false}
    outbox: {max_mb: 33}
    """

    # What was configured, key by key, with what an option changes of it.
    defp changed(%{tmp_dir: dir}, words) do
      path = Path.join(dir, "gateway.yaml")
      File.write!(path, @file_text)
      {:ok, options} = Start.parse(words)
      {:ok, before} = Aerie.Config.load(path, %{}, env: %{})
      {:ok, config} = Aerie.Config.load(path, Plan.from(options, dir).overrides, env: %{})

      for {keys, _field} <- Aerie.Base.Settings.Schema.leaves(Aerie.Config.Keys.fields()),
          keys = Enum.map(keys, &String.to_existing_atom/1),
          value(before, keys) != value(config, keys),
          do: Enum.join(keys, ".")
    end

    defp value(config, [section | below]),
      do: Enum.reduce(below, Map.fetch!(config, section), &Map.fetch!(&2, &1))

    test "changes its own key and keeps the others of the section", context do
      assert changed(context, ~w(--nats nats://other:4222)) == ["nats.url"]
      assert changed(context, ~w(--http 8080)) == ["http.port"]
      assert changed(context, ~w(--link tcp:127.0.0.1:5760)) == ["links"]
      assert changed(context, ~w(--sim 2 --quiet)) == []
    end

    # What is recorded is not the fleet's.
    @apart ~w(nats.store_dir outbox.dir commands.ledger.dir policy.audit.dir shadow.dir)

    test "--replay has its own NATS and folders, and no hub", context do
      for words <- [~w(--replay a.tlog --speed 2), ~w(--replay a.tlog --nats embedded)] do
        changed = changed(context, words)
        assert "nats.mode" in changed and "nats.port" in changed
        assert [] == ["mavlink.local_addr", "links" | @apart] -- changed
        refute "environment" in changed
      end

      {:ok, options} = Start.parse(~w(--replay a.tlog))
      path = Path.join(context.tmp_dir, "leaf.yaml")

      File.write!(path, """
      nats: {leaf: {url: "tls://hub:7422", nkey_seed_file: a.nk, tls: {ca_file: ca.pem}}}
      """)

      assert {:ok, config} = Aerie.Config.load(path, Plan.from(options, context.tmp_dir).overrides, env: %{})
      assert %{mode: :embedded, port: 0, leaf: %{url: [], nkey_seed_file: nil}} = config.nats
    end

    test "--replay with --nats URL publishes there, where nobody takes it for the fleet's", context do
      changed = changed(context, ~w(--replay a.tlog --nats nats://other:4222))
      assert "nats.url" in changed and "environment" in changed
      assert [] == (@apart -- ["nats.store_dir"]) -- changed
    end

    test "--http serves HTTP although the file or the environment says not to", %{tmp_dir: dir} do
      path = Path.join(dir, "gateway.yaml")
      {:ok, options} = Start.parse(~w(--http 8080))
      overrides = Plan.from(options, dir).overrides

      for {text, env} <- [
            {"http: {enabled: false, port: 4001}", %{}},
            {"http: {port: 4001}", %{"AERIE_HTTP_ENABLED" => "false"}}
          ] do
        File.write!(path, text)
        assert {:ok, %{http: %{enabled: false, port: 4001}}} = Aerie.Config.load(path, %{}, env: env)
        assert {:ok, %{http: %{enabled: true, port: 8080}}} = Aerie.Config.load(path, overrides, env: env)
      end
    end

    test "--nats embedded over configured servers keeps the keys that are not about reaching them", context do
      assert changed(context, ~w(--nats embedded)) ==
               ~w(nats.mode nats.credentials nats.tls.enabled nats.tls.ca_file nats.tls.cert_file nats.tls.key_file nats.tls.server_name)
    end
  end
end
