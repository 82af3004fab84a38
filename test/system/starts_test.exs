defmodule Aerie.System.StartsTest do
  @moduledoc "Several starts at once, and compiling beside a running gateway."

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  @moduletag :tmp_dir

  test "three calls at once", _context do
    ports = for _n <- 1..3, do: open(["--version"])

    for port <- ports do
      assert {0, text} = collect(port, "")
      assert text =~ "aerie "
    end
  end

  test "nothing is compiled if nothing has changed, and every change is noticed", %{tmp_dir: folder} do
    root = Path.join(folder, "root")
    stamp = Path.join(folder, "stamp")

    for path <- ~w(apps/one/lib apps/one/test apps/one/cover packages config bin/lib _build/run/code),
        do: File.mkdir_p!(Path.join(root, path))

    for path <- ~w(mix.exs apps/one/lib/a.ex apps/one/lib/b.ex), do: File.write!(Path.join(root, path), "")
    code = Path.join(root, "_build/run/code")

    script = """
    . bin/lib/common.sh; . bin/lib/code.sh; AERIE_ROOT=$1 AERIE_TOOLCHAIN=$1
    case $2 in known) code_known "$3" ;; *) printf '%s\\n' "$(code_digest)" "$(code_elixir)" code >"$3" ;; esac
    """

    bash = fn what ->
      options = [cd: Path.expand("../..", __DIR__), stderr_to_stdout: true]
      {text, _status} = System.cmd("bash", ["-c", script, "bash", root, what, stamp], options)
      String.trim(text)
    end

    assert bash.("known") == ""

    changes = [
      fn -> File.write!(Path.join(root, "apps/one/lib/a.ex"), "changed") end,
      fn -> File.rm!(Path.join(root, "apps/one/lib/b.ex")) end,
      fn -> File.write!(Path.join(root, "packages/new.ex"), "") end,
      # With the modification time of another machine.
      fn ->
        File.write!(Path.join(root, "mix.exs"), "changed")
        File.touch!(Path.join(root, "mix.exs"), {{2020, 1, 1}, {0, 0, 0}})
      end,
      fn -> File.rmdir!(code) end
    ]

    for change <- changes do
      bash.("write")
      assert bash.("known") == code
      # Tests and what they write do not count.
      File.write!(Path.join(root, "apps/one/test/a_test.exs"), "")
      File.write!(Path.join(root, "apps/one/cover/one.html"), "")
      assert bash.("known") == code
      # Another time is no change: a copy of a checkout has other ones.
      File.touch!(Path.join(root, "mix.exs"))
      assert bash.("known") == code
      change.()
      assert bash.("known") == ""
    end
  end

  @tag :long
  test "three starts of an uncompiled checkout at once, which is then compiled again beside them", context do
    checkout = checkout(context.tmp_dir)
    cli = Path.join(checkout, "apps/aerie/lib/aerie/cli")
    write_late(cli, "first")
    ask_when_told(Path.join(Path.dirname(cli), "application.ex"))

    ports = for n <- 1..3, do: open(["--config", config(context.tmp_dir, n), "--quiet"], [], checkout)
    for port <- ports, do: await_output(port, "", ["connected to NATS at"])

    # Changes a module that none of them has loaded yet.
    write_late(cli, "second")

    assert {_words, 0} =
             System.cmd(Path.join(checkout, "bin/setup"), [],
               env: environment(checkout),
               stderr_to_stdout: true
             )

    File.write!(Path.join(checkout, "ask"), "")

    answers =
      eventually(
        fn ->
          answers = checkout |> Path.join("answer-*") |> Path.wildcard() |> Enum.map(&File.read!/1)
          # A file is there before what is written into it.
          length(answers) == 3 and "" not in answers and answers
        end,
        "all three answered"
      )

    assert answers == ["first", "first", "first"]

    # The next start runs the new code; the old copy stays while any of them runs.
    assert {0, _version} = run(["--version"], checkout)
    assert [_first, _second] = File.ls!(Path.join(checkout, "_build/run"))

    for port <- ports do
      {:os_pid, os_pid} = Port.info(port, :os_pid)
      {_output, 0} = System.cmd("kill", ["-INT", "#{os_pid}"])
    end

    for port <- ports, do: assert(await_exit(port) == 0)
    assert {0, _version} = run(["--version"], checkout)
    assert [_second] = File.ls!(Path.join(checkout, "_build/run"))
  end

  # What `bin/run` needs of a checkout, without this one's compiled code.
  defp checkout(folder) do
    root = Path.expand("../..", __DIR__)
    checkout = Path.join(folder, "checkout")

    for part <-
          ~w(bin config rel mix.exs packages/packages.exs) ++
            parts(root, "{apps,packages}/*/{lib,priv,src,mix.exs}") do
      File.mkdir_p!(Path.dirname(Path.join(checkout, part)))
      File.cp_r!(Path.join(root, part), Path.join(checkout, part))
    end

    # The toolchain, too, has to run from a folder of that name.
    toolchain = Path.join(root, ".toolchain")
    if File.dir?(toolchain), do: {_output, 0} = System.cmd("cp", ["-a", toolchain, checkout])
    checkout
  end

  defp parts(root, pattern),
    do: root |> Path.join(pattern) |> Path.wildcard() |> Enum.map(&Path.relative_to(&1, root))

  defp config(folder, n) do
    folder = Path.join(folder, "#{n}")
    File.mkdir_p!(folder)
    file = Path.join(folder, "gateway.yaml")

    File.write!(file, """
    nats: {port: 0, store_dir: "#{folder}/nats"}
    outbox: {dir: "#{folder}/outbox"}
    recorder: {dir: "#{folder}/recordings"}
    sockets: {dir: "#{short_dir()}"}
    http: {port: 0}
    websocket: {port: 0}
    mavlink: {local_addr: "off"}
    """)

    file
  end

  defp write_late(folder, word) do
    File.write!(Path.join(folder, "late.ex"), """
    defmodule Aerie.CLI.Late do
      def word, do: #{inspect(word)}
    end
    """)
  end

  # Replaces the application's module: the same, plus a process that calls a module late.
  # The application as it is, which also says what the module `Late` says when it is told to ask.
  defp ask_when_told(file) do
    source = File.read!(file)
    start = "def start(_type, _args) do\n"
    assert source =~ start

    source
    |> String.replace(start, start <> "spawn(fn -> answer(File.exists?(\"ask\")) end)\n")
    |> String.replace_suffix("end\n", answer() <> "end\n")
    |> then(&File.write!(file, &1))
  end

  defp answer do
    """
      defp answer(true), do: File.write!("answer-\#{System.pid()}", Aerie.CLI.Late.word())

      defp answer(false) do
        receive do
        after
          50 -> answer(File.exists?("ask"))
        end
      end
    """
  end
end
