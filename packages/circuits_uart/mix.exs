defmodule Mix.Tasks.Compile.CircuitsUart do
  @moduledoc """
  Builds the port program (`src/*.c`) with the machine's C compiler into `priv/` of the build folder.

  `CC`, `CFLAGS` and `LDFLAGS` are used when set. Linked statically where libc can be, so that a release runs on machines
  with another libc. Without a compiler, or off Linux, compilation goes on with one warning line:
  everything but opening a serial port works then.
  """

  use Mix.Task.Compiler

  @recompile_hint "apt-get install gcc libc6-dev, then mix deps.compile circuits_uart --force"

  @impl Mix.Task.Compiler
  def run(_args) do
    program = Path.join([Mix.Project.app_path(), "priv", "circuits_uart"])
    cc = System.get_env("CC") || Enum.find(["cc", "gcc", "clang"], &System.find_executable/1)
    fingerprint = fingerprint(cc)

    cond do
      File.regular?(program) and File.read(manifest()) == {:ok, fingerprint} -> {:noop, []}
      :os.type() != {:unix, :linux} -> go_without(program, "serial ports need Linux", "build on Linux")
      cc == nil -> go_without(program, "no C compiler was found", @recompile_hint)
      true -> build(cc, program, fingerprint)
    end
  end

  @impl Mix.Task.Compiler
  def manifests, do: [manifest()]

  @impl Mix.Task.Compiler
  def clean do
    File.rm(Path.join([Mix.Project.app_path(), "priv", "circuits_uart"]))
    File.rm(manifest())
    :ok
  end

  defp build(cc, program, fingerprint) do
    File.mkdir_p!(Path.dirname(program))

    # A name of its own, then renamed: nobody ever sees half a program, nor does a running one change under its process.
    fresh = "#{program}.#{System.pid()}"

    case Enum.find([["-static"], []], &usable?(cc, &1, fresh)) do
      nil -> go_without(program, "#{cc} cannot build a program", @recompile_hint)
      static -> compile(cc, flags() ++ static, program, fresh, fingerprint)
    end
  after
    File.rm("#{program}.#{System.pid()}")
  end

  defp compile(cc, flags, program, fresh, fingerprint) do
    case System.cmd(cc, flags ++ ["-o", fresh | sources("c")] ++ words("LDFLAGS"), stderr_to_stdout: true) do
      {output, 0} ->
        IO.write(:stderr, output)
        File.rename!(fresh, program)
        File.mkdir_p!(Path.dirname(manifest()))
        File.write!(manifest(), fingerprint)
        {:ok, []}

      {output, status} ->
        Mix.shell().error("#{cc} ended with status #{status}:\n#{output}")
        {:error, [diagnostic("the port program of circuits_uart did not compile")]}
    end
  end

  # gcc without libc's headers, no static libraries, flags that exclude them: told by a program that only prints.
  defp usable?(cc, static, fresh) do
    source = fresh <> ".c"

    File.write!(
      source,
      "#include <stdio.h>\n#include <asm/termbits.h>\nint main(void) { return puts(\"\") < 0; }\n"
    )

    match?({_, 0}, System.cmd(cc, words("CFLAGS") ++ static ++ ["-o", fresh, source], stderr_to_stdout: true))
  rescue
    # CC names something that is not there.
    ErlangError -> false
  after
    File.rm(fresh <> ".c")
  end

  defp go_without(program, why, mend) do
    File.rm(program)

    IO.puts(
      :stderr,
      "warning: circuits_uart has no port program, serial ports cannot be opened (#{why}). To mend it: #{mend}"
    )

    {:ok, []}
  end

  defp flags do
    strict = if Mix.env() in [:dev, :test], do: ["-Werror"], else: []
    ["-std=gnu11", "-O2", "-Wall", "-Wextra"] ++ strict ++ words("CFLAGS")
  end

  defp words(variable), do: variable |> System.get_env("") |> OptionParser.split()

  defp sources(extension), do: Enum.sort(Path.wildcard(Path.expand("src/*.#{extension}", __DIR__)))

  defp fingerprint(cc) do
    content = Enum.map(sources("{c,h}"), &File.read!/1)
    inputs = [inspect({cc, flags(), words("LDFLAGS")}) | content]
    inputs |> :erlang.md5() |> Base.encode16()
  end

  defp manifest, do: Path.join(Mix.Project.manifest_path(), "compile.circuits_uart")

  defp diagnostic(message) do
    %Mix.Task.Compiler.Diagnostic{
      file: Path.expand("src/circuits_uart.c", __DIR__),
      position: 0,
      severity: :error,
      message: message,
      compiler_name: "circuits_uart"
    }
  end
end

defmodule Circuits.UART.MixProject do
  use Mix.Project

  def project do
    [
      app: :circuits_uart,
      version: "1.6.0",
      elixir: "~> 1.20",
      elixirc_paths: elixirc_paths(Mix.env()),
      compilers: [:circuits_uart] ++ Mix.compilers(),
      test_coverage: [summary: [threshold: 85]],
      deps: []
    ]
  end

  def application do
    [extra_applications: [:logger] ++ test_applications(Mix.env())]
  end

  # PropEr is Debian's, not a dependency that Mix knows; naming it keeps it on the code path of the tests.
  defp test_applications(:test), do: [:proper]
  defp test_applications(_env), do: []

  defp elixirc_paths(:test), do: ["lib", "test/support"]
  defp elixirc_paths(_env), do: ["lib"]
end
