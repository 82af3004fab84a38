defmodule Aerie.System.SetupTest do
  @moduledoc """
  The scripts that download and compile: what they say of a fault, that they end as a whole, whom they let wait.
  """

  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 2]

  alias Aerie.CLI.{Help, Parser, Subcommands}

  @moduletag :tmp_dir
  @root Path.expand("../..", __DIR__)

  # A checkout with the scripts alone, in a folder that a shell would take apart; programs of its own come first on the
  # PATH.
  setup %{tmp_dir: dir} do
    root = Path.join(dir, "Jörg's $drones & co")
    File.mkdir_p!(Path.join(root, "programs"))
    File.mkdir_p!(Path.join(root, "bin"))
    File.cp_r!(Path.join(@root, "bin/lib"), Path.join(root, "bin/lib"))
    File.mkdir_p!(Path.join(root, "config"))
    %{root: root}
  end

  defp program(root, name, script) do
    file = Path.join([root, "programs", name])
    File.write!(file, "#!/bin/sh\n" <> script)
    File.chmod!(file, 0o755)
  end

  defp script(root, text) do
    sources = for name <- ~w(common toolchain node code), do: ". \"$0/bin/lib/#{name}.sh\"\n"
    path = Path.join(root, "programs") <> ":" <> System.get_env("PATH")

    {["-c", "#{sources}#{text}", root],
     [{"PATH", path} | for(name <- ~w(AERIE_TOOLCHAIN AERIE_BUILD MIX_ENV), do: {name, nil})]}
  end

  defp bash(root, text) do
    {words, environment} = script(root, text)
    System.cmd("bash", words, env: environment, stderr_to_stdout: true)
  end

  defp start(root, text) do
    {words, environment} = script(root, text)

    environment =
      for {name, value} <- environment, do: {to_charlist(name), value != nil && to_charlist(value)}

    port =
      Port.open({:spawn_executable, System.find_executable("bash")}, [
        :binary,
        :exit_status,
        :stderr_to_stdout,
        args: words,
        env: environment
      ])

    {:os_pid, pid} = Port.info(port, :os_pid)
    {port, pid}
  end

  defp output(port, text \\ "", until \\ nil) do
    if until != nil and text =~ until do
      text
    else
      receive do
        {^port, {:data, more}} -> output(port, text <> more, until)
        {^port, {:exit_status, status}} -> {text, status}
      after
        Aerie.Patience.ms() -> flunk("no more than #{text}")
      end
    end
  end

  describe "in a checkout where nothing is installed or compiled" do
    setup %{root: root} do
      for name <- ~w(run aerie), do: File.cp!(Path.join([@root, "bin", name]), Path.join([root, "bin", name]))
      :ok
    end

    # Without Elixir, apt-get and pip on the PATH.
    defp bare(root, name, words) do
      environment = [
        {"PATH", "/usr/bin:/bin"}
        | for(name <- ~w(AERIE_TOOLCHAIN AERIE_BUILD AERIE_PROGRAM), do: {name, nil})
      ]

      System.cmd(Path.join([root, "bin", name]), words, env: environment, stderr_to_stdout: true)
    end

    test "help is there at once, of all, of a group and of one subcommand", %{root: root} do
      rows = Subcommands.all()
      {:ok, start} = Subcommands.fetch("start")
      assert {text, 0} = bare(root, "run", ["--sim", "2", "--help"])
      assert text == String.replace(Help.text(start), "aerie start", "bin/run")
      assert bare(root, "aerie", []) == {Help.text(rows), 0}

      for words <- [["--help"], ["-h"], ["help"]],
          do: assert(bare(root, "aerie", words) == {Help.text(rows), 0})

      for name <- ["start", "status", "params set", "config", "config check", "nats-setup"] do
        {:help, asked} = Parser.command_line(String.split(name) ++ ["--help"])
        assert bare(root, "aerie", String.split(name) ++ ["--help"]) == {Help.text(asked), 0}
      end

      refute File.exists?(Path.join(root, "_build"))
    end

    test "a question to a gateway finds none, as the compiled program says it", %{root: root} do
      {status, text} = Aerie.CLI.Gateway.choose([], nil, Path.join(root, "var/shell"))

      for words <- [["status"], ["status", "--json"], ["params", "list", "VID-001"], ["stop"]],
          do: assert(bare(root, "aerie", words) == {text, status})

      refute File.exists?(Path.join(root, "_build"))
    end
  end

  describe "a download that fails" do
    # What apt-get 2.6 and 3.0, pip 25 and npm 11 say.
    for {said, why} <- [
          {"W: Failed to fetch http://deb.debian.org/debian/dists/forky/InRelease  Temporary failure resolving 'deb.debian.org'",
           "the name of the server is not found"},
          {"NewConnectionError('<pip._vendor.urllib3.connection.HTTPSConnection object>: Failed to establish a new connection: [Errno -2] Name or service not known')",
           "the name of the server is not found"},
          {"npm error code EAI_AGAIN", "the name of the server is not found"},
          {"Could not connect to 127.0.0.1:9 (127.0.0.1). - connect (111: Connection refused)",
           "the server refuses connections"},
          {"npm error code ECONNREFUSED", "the server refuses connections"},
          {"Connection timed out [IP: 151.101.2.132 80]", "the server does not answer"},
          {"ReadTimeoutError(\"HTTPSConnectionPool(host='pypi.org', port=443): Read timed out. (read timeout=15)\")",
           "the server does not answer"},
          {"E: Release file for http://deb.debian.org/debian/dists/forky/InRelease is not valid yet (invalid for another 6d 3h 2min 1s). Updates for this repository will not be applied.",
           "the clock of this machine is slow: it says 20"},
          {"SSLCertVerificationError(1, '[SSL: CERTIFICATE_VERIFY_FAILED] certificate verify failed: certificate is not yet valid (_ssl.c:1006)')",
           "the clock of this machine is slow: it says 20"},
          {"E: Release file for http://mirror/debian/dists/forky/InRelease is expired (invalid since 12d 3h 2min 1s). Updates for this repository will not be applied.",
           "the mirror's lists are too old, or the clock of this machine is fast: it says 20"},
          {"npm error code CERT_HAS_EXPIRED",
           "the server's certificate has expired, or the clock of this machine is fast: it says 20"},
          {"SSLCertVerificationError(1, '[SSL: CERTIFICATE_VERIFY_FAILED] certificate verify failed: unable to get local issuer certificate (_ssl.c:1006)')",
           "not one that this machine trusts"},
          {"404  Not Found [IP: 151.101.2.132 80]", "the server does not have it"},
          {"ERROR: No matching distribution found for pymavlink==2.4.50", "the server does not have it"},
          {"503  Service Unavailable [IP: 151.101.2.132 80]", "the server has a fault of its own"},
          {"npm error 502 Bad Gateway - GET http://mirror/phoenix", "the server has a fault of its own"},
          {"File has unexpected size (52013 != 52008). Mirror sync in progress?",
           "not what its checksum says"},
          {"npm error code EINTEGRITY", "not what its checksum says"},
          {"E: You don't have enough free space in /tmp/apt/archives/.", "the disk is full"},
          {"ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device",
           "the disk is full"},
          {"E: Clearsigned file isn't valid, got 'NOSPLIT' (does the network require authentication?)",
           "something on the way answers in the server's place"},
          {"an unknown song", "the lines above say it"}
        ] do
      test "says what to do: #{String.slice(said, 0, 150)}", %{root: root} do
        File.write!(
          Path.join(root, "log"),
          "Get:500 http://mirror forky/main [502 kB]\n" <> unquote(said) <> "\n"
        )

        assert {text, 0} = bash(root, ~S(download_fault "$0/log"; printf '%s\n%s\n' "$why" "$cure"))
        assert [why, cure, ""] = String.split(text, "\n")
        assert why =~ unquote(why)
        assert String.length(cure) > 10
      end
    end

    @describetag skip: System.find_executable("apt-get") == nil && "no apt-get here"
    test "comes from apt-get itself: a mirror that is not there, that is empty, that has a fault", %{
      root: root
    } do
      mirror = fn port ->
        # Once, and at once.
        bash(root, """
        toolchain_mirror() { echo http://127.0.0.1:#{port}/debian; }
        apt-get() { command apt-get "$@" -o Acquire::Retries=0; }
        toolchain_lists "$0/work" amd64
        """)
      end

      {:ok, socket} = :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 1}, active: false])
      {:ok, port} = :inet.port(socket)

      for {status, why} <- [
            {"404 Not Found", "the server does not have it"},
            {"503 Service Unavailable", "the server has a fault of its own"}
          ] do
        server = Task.async(fn -> serve(socket, status) end)
        assert {text, 1} = mirror.(port)
        assert text =~ "error: cannot read the package lists of http://127.0.0.1:#{port}/debian (#{why}"
        Task.shutdown(server, :brutal_kill)
      end

      :ok = :gen_tcp.close(socket)
      assert {text, 1} = mirror.(port)
      assert text =~ "the server refuses connections). To fix it: "
    end
  end

  defp serve(socket, status) do
    {:ok, client} = :gen_tcp.accept(socket)
    _request = :gen_tcp.recv(client, 0)
    :ok = :gen_tcp.send(client, "HTTP/1.1 #{status}\r\ncontent-length: 0\r\nconnection: close\r\n\r\n")
    :gen_tcp.close(client)
    serve(socket, status)
  end

  # A compiler, or a download, with a child of its own; both say that they run and then do so forever.
  @endless ~S"""
  sh -c 'echo $$ >"$0.child"; exec sleep 100000' "$0" &
  trap '' INT
  echo $$ >"$0.pid"
  wait
  """

  for {what, name, call} <- [
        {"a compilation", "mix", "compile_quietly prod"},
        {"a download", "apt-get",
         ~S|toolchain_mirror() { echo http://127.0.0.1/debian; }; toolchain_system_ok() { false; }; toolchain_install|}
      ] do
    # Ctrl-C and SIGHUP do the same, but may be ignored where tests run.
    test "SIGTERM ends #{what} with all that it started, and the next one begins", %{root: root} do
      call = unquote(call)
      program(root, unquote(name), @endless)
      {port, pid} = start(root, call)

      started =
        eventually(
          fn ->
            found =
              for file <- ~w(pid child),
                  {:ok, text} <- [File.read(Path.join(root, "programs/#{unquote(name)}.#{file}"))],
                  text =~ "\n",
                  do: String.trim(text)

            length(found) == 2 && found
          end,
          "both run"
        )

      {_output, 0} = System.cmd("kill", ["#{pid}"])
      assert {_text, 143} = output(port)
      for one <- started, do: refute(File.exists?("/proc/#{one}"), "#{one} goes on")

      # No lock and nothing half-made is left.
      program(root, unquote(name), "exit 7\n")
      assert {text, 1} = bash(root, call)
      assert text =~ "error: "
      refute text =~ "waiting for it"
      refute File.exists?(Path.join(root, ".toolchain"))
    end
  end

  describe "the console's packages" do
    setup %{root: root} do
      File.write!(Path.join(root, "package-lock.json"), "{}")
      program(root, "node", "exit 0\n")
      # Comes to its end when the compiler has begun, which comes to its end after it.
      program(
        root,
        "npm",
        ~S(mkdir -p node_modules; read -r _ <"$AERIE_ROOT/compiling"; echo >"$AERIE_ROOT/npm")
      )

      program(root, "mix", ~S(echo >"$AERIE_ROOT/compiling"; read -r _ <"$AERIE_ROOT/npm"))
      for name <- ~w(compiling npm), do: {_text, 0} = System.cmd("mkfifo", [Path.join(root, name)])
      :ok
    end

    test "are installed while it compiles, and once", %{root: root} do
      call =
        "node_install_beside node_install_pages; compile_quietly prod; node_await; node_has pages && echo there"

      assert {text, 0} = bash(root, call)
      assert text == "==> node: installing the packages of package-lock.json into node_modules/\nthere\n"
      assert bash(root, "node_install_beside node_install_pages; node_await; echo on") == {"on\n", 0}
    end

    test "that cannot be had do not keep a gateway from its start", %{root: root} do
      program(root, "npm", "echo npm error code ENOTFOUND >&2; exit 1\n")
      assert {text, 0} = bash(root, "node_install_beside node_install_pages; node_await; echo on")
      assert text =~ "the name of the server is not found"
      assert text =~ "the gateway runs without its console"
      assert String.ends_with?(text, "\non\n")
    end

    test "are given up when the compiler fails, and when SIGTERM ends the script", %{root: root} do
      program(root, "npm", @endless)

      begun = fn ->
        for file <- ~w(pid child), path = Path.join(root, "programs/npm.#{file}"), reduce: true do
          all -> all and match?({:ok, <<_, _::binary>>}, File.read(path))
        end
      end

      ended = fn ->
        for file <- ~w(pid child) do
          path = Path.join(root, "programs/npm.#{file}")
          pid = path |> File.read!() |> String.trim()
          refute File.exists?("/proc/#{pid}"), "npm's #{file} goes on"
          File.rm!(path)
        end
      end

      program(root, "mix", ~S(read -r _ <"$AERIE_ROOT/compiling"; exit 7))
      {port, _pid} = start(root, "node_install_beside node_install_pages; compile_quietly prod; node_await")
      eventually(begun, "npm runs")
      {"", 0} = System.cmd("sh", ["-c", ~S(echo >"$0/compiling"), root])
      assert {_text, 1} = output(port)
      ended.()

      {port, pid} = start(root, "node_install_beside node_install_pages; compile_quietly prod; node_await")
      eventually(begun, "npm runs again")
      {_output, 0} = System.cmd("kill", ["#{pid}"])
      assert {_text, 143} = output(port)
      ended.()
    end
  end

  describe "while another start compiles" do
    setup %{root: root} do
      program(root, "elixir", "")
      File.mkdir_p!(Path.join(root, "_build/run/prod-1/consolidated"))
      File.write!(Path.join(root, "_build/code-prod"), "another content\nprograms/elixir\nprod-1\n")
      # Changed since.
      File.touch!(Path.join(root, "_build/code-prod"), {{2020, 1, 1}, {0, 0, 0}})
      File.write!(Path.join(root, "mix.exs"), "")
      {holder, _pid} = start(root, ~S(exec 9>"$0/_build/compile-prod.lock"; flock 9; echo held; read -r _))
      assert output(holder, "", "held")
      %{holder: holder}
    end

    test "the tool answers by the program of before", %{root: root} do
      assert {text, 0} = bash(root, ~S(code_install any; printf '%s\n' "${AERIE_CODE#"$0/"}"))

      assert text ==
               "==> another start is compiling here; this is the program as it was before\n_build/run/prod-1\n"
    end

    test "a question to a gateway is answered by the program of before, whether another start compiles or not",
         context do
      said = "this is the program as it was"
      assert {text, 0} = bash(context.root, ~S(code_install last; printf '%s\n' "${AERIE_CODE#"$0/"}"))
      assert text =~ said and text =~ "\n_build/run/prod-1\n"
      Port.command(context.holder, "\n")
      {_text, 0} = bash(context.root, ~S(lock "$0/_build/compile-prod.lock" waits))
      assert {text, 0} = bash(context.root, ~S(code_install last; printf '%s\n' "${AERIE_CODE#"$0/"}"))
      assert text == "==> the sources have changed since the last start; #{said} then\n_build/run/prod-1\n"
    end

    test "a gateway says that it waits, and starts when the other one has ended", %{
      root: root,
      holder: holder
    } do
      program(root, "mix", "exit 7\n")
      {port, _pid} = start(root, "code_install")
      text = output(port, "", "==> another start is compiling here; waiting for it\n")
      Port.command(holder, "\n")
      assert {text, 1} = output(port, text)
      assert text =~ "error: Aerie did not compile"
    end

    test "one that waited takes what the other one compiled", %{root: root, holder: holder} do
      Port.command(holder, "\n")
      File.mkdir_p!(Path.join(root, "_build/prod"))
      File.touch!(Path.join(root, "config/config.exs"))
      # Compiles at a sign, and copies nothing.
      program(root, "mix", ~S"""
      case $1 in
        compile) echo one >>"$AERIE_ROOT/compiled"; read -r _ <"$AERIE_ROOT/go" ;;
        run) mkdir -p "$5/consolidated" ;;
      esac
      """)

      {_text, 0} = System.cmd("mkfifo", [Path.join(root, "go")])
      {first, _pid} = start(root, "code_install")
      compiling = output(first, "", "==> compiling")
      {second, _pid} = start(root, "code_install")
      waiting = output(second, "", "==> another start is compiling here; waiting for it\n")
      {"", 0} = System.cmd("sh", ["-c", ~S(echo >"$0/go"), root])
      assert {_text, 0} = output(first, compiling)
      assert {text, 0} = output(second, waiting)
      refute text =~ "==> compiling"
      assert File.read!(Path.join(root, "compiled")) == "one\n"
    end

    test "also waits without a program of before the tool", %{root: root} do
      File.rm!(Path.join(root, "_build/code-prod"))
      {port, pid} = start(root, "code_install any")
      assert output(port, "", "==> another start is compiling here; waiting for it\n")
      {_output, 0} = System.cmd("kill", ["#{pid}"])
    end
  end

  test "a folder whose name Elixir or the loader takes apart is refused by its name", %{tmp_dir: dir} do
    for name <- ["a[1]", "a{b", "a*", "a?", "a\\b", "a:b", "a;b"] do
      lib = Path.join([dir, name, "bin/lib"])
      File.mkdir_p!(lib)
      File.cp!(Path.join(@root, "bin/lib/common.sh"), Path.join(lib, "common.sh"))
      assert {text, 1} = System.cmd("bash", ["-c", ". \"$0/common.sh\"", lib], stderr_to_stdout: true)
      assert text =~ "error: #{Path.join(dir, name)}: "
    end
  end
end
