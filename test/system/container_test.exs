defmodule Aerie.System.ContainerTest do
  @moduledoc """
  The Containerfile and compose.yaml of `rel/container`, without an engine: what a linter would say, and that they name what there is. Their steps
  run in `test/install/image.sh`.
  """

  use ExUnit.Case, async: true

  alias Aerie.{Config, Containerfile}
  alias Aerie.Fleet.Bridge.Hub.Setup

  @moduletag :tmp_dir
  @root Path.expand("../..", __DIR__)
  @host "hub.example.org"

  setup_all do
    stages = @root |> Path.join("rel/container/Containerfile") |> File.read!() |> Containerfile.parse()
    %{stages: stages, image: List.last(stages)}
  end

  describe "the Containerfile" do
    test "has pinned bases and fetches nothing by itself", %{stages: stages} do
      for stage <- stages do
        assert [_name, tag] = String.split(stage.from, ":")
        assert tag != "latest"
        words = for {word, _flags, _rest} <- stage.steps, do: word
        refute "ADD" in words
        for {"RUN", _flags, text} <- stage.steps, do: refute(text =~ ~r/\b(curl|wget|git|sudo|apt) /)

        for {"RUN", _flags, "apt-get" <> _rest = text} <- stage.steps do
          assert text =~ "apt-get update && apt-get install --yes --no-install-recommends "
          assert text =~ "&& rm -rf /var/lib/apt/lists/*"
        end
      end
    end

    test "copies what there is", %{stages: stages, tmp_dir: context} do
      # What bin/release writes.
      for machine <- ~w(x86_64 aarch64),
          do: File.touch!(Path.join(context, "aerie-0.1.0-linux-#{machine}.tar.gz"))

      names = for %{name: name} <- stages, name != nil, do: name

      for stage <- stages, {"COPY", flags, rest} <- stage.steps do
        {sources, [_target]} = rest |> String.split() |> Enum.split(-1)

        if from = flags["from"],
          do: assert(from in names),
          else: for(source <- sources, do: assert([_one, _other] = Path.wildcard(Path.join(context, source))))
      end
    end

    test "runs as a user of its own, ends in order and keeps no secret", %{image: image} do
      user = Containerfile.last(image, "USER")
      assert String.to_integer(user) > 0

      assert Enum.any?(image.steps, fn {_word, _flags, rest} ->
               rest =~ ~r/useradd .*--uid #{user} .* aerie$/
             end)

      # After it nothing runs or is copied.
      [{"USER", _flags, _user} | rest] = Enum.drop_while(image.steps, &(elem(&1, 0) != "USER"))
      for {word, _flags, _rest} <- rest, do: refute(word in ~w(RUN COPY USER))

      assert Containerfile.last(image, "STOPSIGNAL") == "SIGTERM"
      # Without a shell between engine and gateway, which would not hand the signal on.
      for word <- ~w(ENTRYPOINT CMD), do: assert("[" <> _json = Containerfile.last(image, word))
      assert "CMD " <> check = Containerfile.last(image, "HEALTHCHECK")
      assert Containerfile.command(check) == ["aerie", "status"]
      env = Containerfile.env(image)
      for {name, _value} <- env, do: refute(name =~ ~r/KEY|SEED|PASSWORD|TOKEN|SECRET/)
      assert env["AERIE_HOME"] == Containerfile.last(image, "VOLUME")
    end

    test "has the folders and ports of the service and of the defaults", %{image: image} do
      unit = File.read!(Path.join(@root, "rel/overlays/systemd/aerie.service"))
      [_all, settings] = Regex.run(~r/^Environment=(.*)$/m, unit)
      for setting <- String.split(settings), do: assert(Containerfile.last(image, "ENV") =~ setting)
      {:ok, config} = Config.load(nil, [], env: %{})
      exposed = image |> Containerfile.last("EXPOSE") |> String.split()

      for port <- [config.http.port, config.websocket.port, config.nats.port],
          do: assert(to_string(port) in exposed)

      assert [%{url: "udpin:0.0.0.0:" <> udp}] = config.links
      assert "#{udp}/udp" in exposed
    end
  end

  describe "compose.yaml" do
    setup do
      {:ok, compose} = @root |> Path.join("rel/container/compose.yaml") |> File.read!() |> Config.Yaml.parse()
      %{compose: compose, services: compose["services"]}
    end

    test "ends services in order and starts them again, without rights that they do not need", %{
      services: services
    } do
      for {name, service} <- services, name != "setup" do
        assert service["restart"] == "unless-stopped"
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]
        refute service["privileged"] || service["user"]
      end

      assert services["gateway"]["stop_grace_period"] == "2m"
      assert services["gateway"]["depends_on"] == %{"nats" => %{"condition" => "service_healthy"}}
      assert ["CMD" | _words] = services["nats"]["healthcheck"]["test"]
      # A console is for this machine, until somebody puts TLS in front of it.
      assert Enum.all?(services["gateway"]["ports"], &(&1 =~ ~r{\A127\.0\.0\.1:|/udp\z}))
    end

    test "mounts what aerie nats-setup writes, and a gateway takes it", %{
      compose: compose,
      services: services,
      tmp_dir: dir
    } do
      assert ["aerie", "nats-setup", "/fleet", "--host", "${HUB_HOST:?" <> _what] =
               services["setup"]["entrypoint"]

      {:ok, _lines} = Setup.write(Path.join(dir, "fleet"), %{hosts: [@host], vehicles: ["VID-001"]})
      File.cp!(Path.join(dir, "fleet/hub/gateway.yaml"), Path.join(dir, "gateway.yaml"))

      for {name, service} <- services, mount <- service["volumes"] do
        source = String.replace(mount["source"], "${HUB_HOST}", @host)

        if mount["type"] == "volume" do
          assert is_map_key(compose["volumes"], source)
        else
          assert File.exists?(Path.join(dir, source)), source
          assert mount["read_only"] == true or name == "setup"
          assert mount["bind"] == %{"create_host_path" => false}
        end
      end

      # The server finds all that its configuration names.
      mounted =
        for %{"type" => "bind", "target" => target} <- services["nats"]["volumes"], do: Path.basename(target)

      texts =
        for name <- ["hub.conf", "server.conf"], do: File.read!(Path.join([dir, "fleet/hub", @host, name]))

      for text <- texts,
          [_all, name] <- Regex.scan(~r/(?:include |_file: ")([a-z.]+\.(?:conf|pem|key))/, text),
          do: assert(name in mounted)

      # So does the gateway, beside its gateway.yaml.
      targets = for %{"type" => "bind", "target" => target} <- services["gateway"]["volumes"], do: target
      assert "/etc/aerie/gateway.yaml" in targets
      text = File.read!(Path.join(dir, "gateway.yaml"))

      for [_all, name] <- Regex.scan(~r/_file: (\S+)/, text), do: assert("/etc/aerie/#{name}" in targets)

      env = Map.put(services["gateway"]["environment"], "AERIE_API_KEY", "a-key-of-32-characters-for-a-test")
      assert {:ok, config} = Config.load(Path.join(dir, "gateway.yaml"), [], env: env)
      assert config.http.address == "0.0.0.0"
      assert config.nats.url == ["tls://#{@host}:4222"]
    end
  end
end
