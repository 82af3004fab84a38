# Called by image.sh, which describes it. It knows those instructions and keys that are used in rel/container, and ends at any other.

defmodule Image do
  @here Path.expand("../..", __DIR__)
  Code.require_file("../support/containerfile.ex", __DIR__)
  alias Aerie.Containerfile

  @path "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
  @host "hub.example.org"

  def main([bare, context, work]) do
    image = build(bare, context, work)
    alone(image, work)
    compose(image, work)
    step("all well")
  end

  ## Building

  defp build(bare, context, work) do
    stages = Containerfile.parse(File.read!(Path.join(@here, "rel/container/Containerfile")))

    roots =
      Enum.reduce(stages, %{}, fn stage, roots ->
        root = Path.join(work, "stage-#{map_size(roots)}")
        run!("cp", ["-a", bare, root])
        step("FROM #{stage.from}: a copy of #{bare}")
        Enum.each(stage.steps, &build_step(&1, stage, root, context, roots))
        Map.put(roots, stage.name, root)
      end)

    stage = List.last(stages)
    root = roots[stage.name]
    step("the image has #{megabytes(root)} MB, #{megabytes(root) - megabytes(bare)} MB more than its base")
    # Keys and cookies are made where it runs, each time others.
    is("files in the folder of data", File.ls!(Path.join(root, "var/lib/aerie")), [])

    %{
      root: root,
      env: Containerfile.env(stage),
      user: Containerfile.last(stage, "USER"),
      dir: Containerfile.last(stage, "WORKDIR"),
      program: Containerfile.command(Containerfile.last(stage, "ENTRYPOINT")),
      words: Containerfile.command(Containerfile.last(stage, "CMD")),
      signal: Containerfile.last(stage, "STOPSIGNAL"),
      health: health(Containerfile.last(stage, "HEALTHCHECK")),
      mounts: [],
      caps: []
    }
  end

  defp build_step({"COPY", flags, rest}, _stage, root, context, roots) do
    {sources, [target]} = rest |> String.split() |> Enum.split(-1)
    from = if stage = flags["from"], do: Map.fetch!(roots, stage), else: context
    files = Enum.flat_map(sources, &Path.wildcard(Path.join(from, &1)))
    files != [] || fail("COPY #{rest}: nothing of that is in #{from}")
    step("COPY #{rest}")

    # Of a folder it copies what is in it.
    for file <- files do
      if File.dir?(file), do: File.mkdir_p!(root <> target)
      run!("cp", ["-a", if(File.dir?(file), do: file <> "/.", else: file), root <> target])
    end
  end

  defp build_step({"RUN", _flags, rest}, stage, root, _context, _roots) do
    step("RUN #{rest}")
    env = for {name, value} <- Containerfile.env(stage), do: "#{name}=#{value}"
    proxies = for name <- ~w(http_proxy https_proxy), value = System.get_env(name), do: "#{name}=#{value}"

    script = """
    cp -L /etc/resolv.conf "$1/etc/resolv.conf"
    mount -t proc proc "$1/proc"
    mount --bind /dev "$1/dev"
    root=$1; shift
    exec chroot "$root" env -i "$@"
    """

    words =
      [@path, "HOME=/root", "DEBIAN_FRONTEND=noninteractive"] ++ env ++ proxies ++ Containerfile.command(rest)

    run!("unshare", ~w(--mount --pid --fork --kill-child sh -euc) ++ [script, "sh", root | words])
  end

  defp build_step({word, _flags, _rest}, _stage, _root, _context, _roots)
       when word in ~w(ENV USER WORKDIR VOLUME EXPOSE HEALTHCHECK STOPSIGNAL ENTRYPOINT CMD),
       do: :ok

  defp build_step({word, _flags, _rest}, _stage, _root, _context, _roots),
    do: fail("this does not know #{word}")

  defp health("CMD " <> command), do: Containerfile.command(command)

  ## Running

  defp alone(image, work) do
    step("the image by itself")
    data = volume(work, "data", image)
    container = start(image, "alone", work, [{data, "/var/lib/aerie", :rw}], nil)
    await_health(container)
    IO.puts(elem(inside(container, ["aerie", "status"]), 0))
    is("who runs it", String.trim(elem(inside(container, ["id", "-un"]), 0)), "aerie")
    stop(container)
    kept(data)
  end

  defp compose(image, work) do
    step("the services of compose.yaml")
    {:ok, _started} = Application.ensure_all_started(:fast_yaml)
    folder = Path.join(work, "compose")
    File.mkdir_p!(Path.join(folder, "fleet"))
    run!("chown", ["-R", "10001:10001", Path.join(folder, "fleet")])
    run!("chmod", ["700", Path.join(folder, "fleet")])
    services = services()

    # The steps of docs/guides/container.md.
    setup = service(services["setup"], image, folder, work)
    setup = %{setup | words: ["--vehicle", "VID-001"]}
    is("aerie nats-setup", finish(start(setup, "setup", work, setup.mounts, nil)), 0)
    run!("install", ~w(-o 10001 -g 10001 -m 600 fleet/hub/gateway.yaml gateway.yaml), cd: folder)
    File.write!(Path.join(folder, "gateway.env"), "AERIE_API_KEY=a-key-of-32-characters-for-a-test\n")
    gateway = service(services["gateway"], image, folder, work)
    nats = service(services["nats"], image, folder, work)
    nats = start(nats, "nats", work, nats.mounts, nil)
    await_health(nats)
    gateway = start(gateway, "gateway", work, gateway.mounts, nats)
    await_health(gateway)
    {status, 0} = inside(gateway, ["aerie", "status", "--json"])
    IO.puts(elem(inside(gateway, ["aerie", "status"]), 0))
    is("NATS of the gateway", get_in(JSON.decode!(status), ["nats", "connected"]), true)
    add = ["sh", "-c", "echo a-password-of-ann | aerie user add ann --role admin"]
    is("aerie user add", elem(inside(gateway, add), 1), 0)

    is(
      "port 4000 on all addresses",
      elem(inside(gateway, ["grep", "-q", " 00000000:0FA0 ", "/proc/net/tcp"]), 1),
      0
    )

    stop(gateway)
    stop(nats)
    kept(Path.join(work, "volume-gateway"))
    is("streams at the hub", File.exists?(Path.join(work, "volume-nats/data/jetstream")), true)
  end

  defp services do
    text = File.read!(Path.join(@here, "rel/container/compose.yaml"))

    text =
      Regex.replace(~r/\$\$|\$\{([A-Z_]+)(?::[-?]([^}]*))?\}/, text, fn
        "$$", _name, _default -> "$"
        _all, "HUB_HOST", _default -> @host
        _all, _name, default -> default
      end)

    {:ok, [%{"services" => services}]} = :fast_yaml.decode(text, [:sane_scalars, :maps])
    services
  end

  # A service is the image with what its keys replace.
  defp service(keys, image, folder, work) do
    mounts =
      for mount <- keys["volumes"] do
        source =
          case mount do
            %{"type" => "volume", "source" => name} -> volume(work, name, image)
            %{"type" => "bind", "source" => path} -> Path.join(folder, path)
          end

        {source, mount["target"], if(mount["read_only"], do: :ro, else: :rw)}
      end

    %{
      image
      | program: keys["entrypoint"] || image.program,
        words: keys["command"] || image.words,
        dir: keys["working_dir"] || image.dir,
        env:
          image.env |> Map.merge(env_file(folder, keys["env_file"])) |> Map.merge(keys["environment"] || %{}),
        signal: keys["stop_signal"] || image.signal,
        health: with(["CMD" | words] <- get_in(keys, ["healthcheck", "test"]) || image.health, do: words),
        mounts: mounts,
        caps:
          if(keys["cap_drop"] == ["ALL"],
            do: ~w(--bounding-set -all --inh-caps -all --no-new-privs),
            else: []
          )
    }
  end

  defp env_file(_folder, nil), do: %{}

  defp env_file(folder, file) do
    for line <- folder |> Path.join(file) |> File.stream!(), into: %{} do
      [name, value] = line |> String.trim() |> String.split("=", parts: 2)
      {name, value}
    end
  end

  # A new volume is a copy of what the image has there.
  defp volume(work, name, image) do
    volume = Path.join(work, "volume-#{name}")
    File.exists?(volume) || run!("cp", ["-a", Path.join(image.root, "var/lib/aerie"), volume])
    volume
  end

  # It is process 1 of its namespace, as in a container without an init: signals without a handler do nothing there. `beside`: whose network
  # it shares, as if by a name.
  defp start(image, name, work, mounts, beside) do
    step("starting #{name}: #{Enum.join(image.program ++ image.words, " ")}")
    root = Path.join(work, "root-#{name}")
    run!("cp", ["-a", image.root, root])
    File.write!(Path.join(root, "etc/hosts"), "127.0.0.1 localhost #{@host}\n")
    log = Path.join(work, "#{name}.log")

    mount =
      for {source, target, mode} <- mounts do
        into = quoted(root <> target)

        make =
          if File.dir?(source),
            do: "mkdir -p #{into}",
            else: "mkdir -p \"$(dirname #{into})\" && touch #{into}"

        again = if mode == :ro, do: "mount -o remount,ro,bind #{into}", else: ":"
        "#{make}\nmount --bind #{quoted(source)} #{into}\n#{again}\n"
      end

    script = """
    exec >#{quoted(log)} 2>&1 </dev/null
    #{if beside, do: ":", else: "ip link set lo up"}
    root=$1; shift
    mount -t proc proc "$root/proc"
    mount --bind /dev "$root/dev"
    #{mount}
    exec chroot "$root" "$@"
    """

    namespaces =
      if beside, do: ["nsenter", "--target", "#{beside.pid}", "--net", "unshare"], else: ["unshare", "--net"]

    words =
      namespaces ++
        ~w(--mount --pid --fork --kill-child sh -euc) ++
        [script, "sh", root | as(image, image.program ++ image.words)]

    port =
      Port.open({:spawn_executable, System.find_executable(hd(words))}, [
        :exit_status,
        :binary,
        args: tl(words)
      ])

    {:os_pid, outer} = Port.info(port, :os_pid)
    pid = await("#{name} has begun", 100, fn -> child(outer) end)
    %{image: image, name: name, port: port, pid: pid, log: log}
  end

  defp as(image, words) do
    env = for {name, value} <- image.env, do: "#{name}=#{value}"

    ["setpriv", "--reuid", image.user, "--regid", image.user, "--init-groups"] ++
      image.caps ++ ["env", "-i", @path] ++ env ++ ["sh", "-c", "cd \"$0\" && exec \"$@\"", image.dir | words]
  end

  defp child(outer) do
    case File.read("/proc/#{outer}/task/#{outer}/children") do
      {:ok, children} -> children |> String.split() |> List.first()
      {:error, _gone} -> nil
    end
  end

  defp inside(container, words) do
    words = as(container.image, words)

    System.cmd("nsenter", ["--target", container.pid, "--mount", "--pid", "--net", "--root", "--wd" | words],
      stderr_to_stdout: true
    )
  end

  defp await_health(container) do
    since = now()

    await("#{container.name} is well; its log: #{container.log}", 120, fn ->
      File.exists?("/proc/#{container.pid}") ||
        fail("#{container.name} has ended:\n" <> File.read!(container.log))

      match?({_output, 0}, inside(container, container.image.health)) || wait(500)
    end)

    {spent, {_output, 0}} = :timer.tc(fn -> inside(container, container.image.health) end)
    step("#{container.name} is well after #{seconds(since)} s; a check takes #{div(spent, 1000)} ms")
  end

  defp stop(container) do
    since = now()
    step("stopping #{container.name} with #{container.image.signal}")
    run!("kill", ["-s", String.replace_prefix(container.image.signal, "SIG", ""), container.pid])
    status = finish(container)
    status == 0 || IO.puts(File.read!(container.log))
    is("exit status of #{container.name}", status, 0)
    step("#{container.name} has ended after #{seconds(since)} s")
  end

  defp finish(%{port: port} = container) do
    receive do
      {^port, {:exit_status, status}} ->
        status == 0 || IO.puts(File.read!(container.log))
        status
    after
      120_000 -> fail("#{container.name} does not end:\n" <> File.read!(container.log))
    end
  end

  defp kept(data) do
    is("what is kept", File.dir?(Path.join(data, "var")), true)
    is("files of others in the data", run!("find", [Path.join(data, "var"), "-not", "-uid", "10001"]), "")
  end

  ## Small things

  defp await(what, 0, _fun), do: fail("waited in vain: #{what}")

  defp await(what, tries, fun) do
    case fun.() do
      value when value in [nil, false] ->
        wait(100)
        await(what, tries - 1, fun)

      value ->
        value
    end
  end

  defp wait(ms) do
    Process.sleep(ms)
    nil
  end

  defp megabytes(root) do
    [size | _rest] = String.split(run!("du", ["-sxm", root]))
    String.to_integer(size)
  end

  defp now, do: System.monotonic_time(:millisecond)
  defp seconds(since), do: Float.round((now() - since) / 1000, 1)
  defp quoted(text), do: "'" <> String.replace(text, "'", "'\\''") <> "'"

  defp run!(program, words, options \\ []) do
    case System.cmd(program, words, [stderr_to_stdout: true] ++ options) do
      {output, 0} -> output
      {output, status} -> fail("#{program} ended with #{status}:\n#{output}")
    end
  end

  defp is(_what, same, same), do: :ok
  defp is(what, got, expected), do: fail("#{what}: expected #{inspect(expected)}, got #{inspect(got)}")
  defp step(text), do: IO.puts("== #{text}")

  defp fail(text) do
    IO.puts(:stderr, "FAILED: #{text}")
    System.halt(1)
  end
end

Image.main(System.argv())
