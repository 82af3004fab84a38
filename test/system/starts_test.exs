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
      # New times alone are not a change: a copied checkout has them.
      File.touch!(Path.join(root, "mix.exs"))
      assert bash.("known") == code
      change.()
      assert bash.("known") == ""
    end
  end

  test "three starts of an uncompiled checkout at once, which is then compiled again beside them", context do
    checkout = checkout(context.tmp_dir)
    late(checkout, "first")

    ports = for _start <- 1..3, do: open([], [], checkout)
    for port <- ports, do: await_output(port, "", ["started"])

    # Changes a module that none of them has loaded yet.
    late(checkout, "second")

    assert {_words, 0} =
             System.cmd(Path.join(checkout, "bin/setup"), [],
               env: environment(checkout),
               stderr_to_stdout: true
             )

    File.write!(Path.join(checkout, "ask"), "")
    for port <- ports, do: await_output(port, "", ["first"])

    # The next start runs the new code; the old copy stays while any of them runs.
    next = open([], [], checkout)
    await_output(next, "", ["second"])
    assert [_first, _second] = File.ls!(Path.join(checkout, "_build/run"))
    for port <- ports ++ [next], do: interrupt(port)
    for port <- ports ++ [next], do: assert(await_exit(port) == 0)

    last = open([], [], checkout)
    await_output(last, "", ["second"])
    assert [_second] = File.ls!(Path.join(checkout, "_build/run"))
    interrupt(last)
    assert await_exit(last) == 0
  end

  defp interrupt(port) do
    {:os_pid, os_pid} = Port.info(port, :os_pid)
    {_output, 0} = System.cmd("kill", ["-INT", "#{os_pid}"])
  end

  # The scripts of this checkout and its toolchain. In place of the gateway there is an application that is compiled in
  # a second.
  defp checkout(folder) do
    root = Path.expand("../..", __DIR__)
    checkout = Path.join(folder, "checkout")
    lib = Path.join(checkout, "apps/aerie/lib")
    File.mkdir_p!(lib)
    for part <- ~w(bin config rel), do: File.cp_r!(Path.join(root, part), Path.join(checkout, part))
    # The toolchain has to run from a folder of that name as well.
    toolchain = Path.join(root, ".toolchain")
    if File.dir?(toolchain), do: {_output, 0} = System.cmd("cp", ["-a", toolchain, checkout])
    # The console's packages count as installed.
    lock = Path.join(checkout, "package-lock.json")
    File.write!(lock, "{}")
    File.mkdir_p!(Path.join(checkout, "node_modules"))
    digest = :sha256 |> :crypto.hash("{}") |> Base.encode16(case: :lower)
    File.write!(Path.join(checkout, "node_modules/.pages"), digest <> "\n")

    File.write!(Path.join(checkout, "mix.exs"), """
    defmodule Checkout.MixProject do
      use Mix.Project
      def project, do: [apps_path: "apps", version: "0.1.0", deps: []]
    end
    """)

    File.write!(Path.join(checkout, "apps/aerie/mix.exs"), """
    defmodule Checkout.Aerie.MixProject do
      use Mix.Project

      def project,
        do: [app: :aerie, version: "0.1.0", build_path: "../../_build", config_path: "../../config/config.exs"]

      def application, do: [mod: {Checkout.Aerie, []}]
    end
    """)

    File.write!(Path.join(lib, "aerie.ex"), """
    defmodule Checkout.Aerie do
      use Application

      @impl Application
      def start(_type, _arguments) do
        IO.puts("started")
        Task.start_link(fn -> ask(File.exists?("ask")) end)
      end

      defp ask(true) do
        IO.puts(Checkout.Late.word())
        Process.sleep(:infinity)
      end

      defp ask(false) do
        Process.sleep(50)
        ask(File.exists?("ask"))
      end
    end
    """)

    # Stands for the modules that the VM is started with.
    File.write!(Path.join(lib, "directory.ex"), """
    defmodule Aerie.Node.Directory do
      def start_link, do: :ignore
      def register_node(_name, _port), do: {:ok, 1}
      def register_node(_name, _port, _family), do: {:ok, 1}
    end
    """)

    checkout
  end

  defp late(checkout, word) do
    File.write!(Path.join(checkout, "apps/aerie/lib/late.ex"), """
    defmodule Checkout.Late do
      def word, do: #{inspect(word)}
    end
    """)
  end
end
