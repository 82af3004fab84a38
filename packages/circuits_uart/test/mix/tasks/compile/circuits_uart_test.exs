defmodule Mix.Tasks.Compile.CircuitsUartTest do
  use ExUnit.Case, async: true

  @moduletag :tmp_dir

  test "builds the port program once, and again when asked to differ", %{tmp_dir: dir} do
    program = Path.join(dir, "lib/circuits_uart/priv/circuits_uart")
    assert {_output, 0} = compile(dir, [])

    if File.exists?(program) do
      built = File.stat!(program).inode
      assert {"", 0} = compile(dir, [])
      assert File.stat!(program).inode == built
      assert {_output, 0} = compile(dir, [{"CFLAGS", "-DDIFFERENT"}])
      assert File.stat!(program).inode != built
      assert File.ls!(Path.dirname(program)) == ["circuits_uart"]
    end
  end

  test "without a usable compiler goes on, with one line that says what to do", %{tmp_dir: dir} do
    assert {output, 0} = compile(dir, [{"CC", "/does/not/exist"}])
    assert [warning] = for("warning: " <> text <- String.split(output, "\n"), do: text)
    assert warning =~ "/does/not/exist cannot build a program"
    assert warning =~ "apt-get install gcc libc6-dev"
    refute File.exists?(Path.join(dir, "lib/circuits_uart/priv/circuits_uart"))
    assert File.exists?(Path.join(dir, "lib/circuits_uart/ebin/circuits_uart.app"))
  end

  # The build as a dependency's, which is what Aerie does.
  defp compile(dir, env) do
    env = [{"MIX_BUILD_PATH", Path.expand(dir)}, {"MIX_ENV", "prod"} | env]
    System.cmd(System.find_executable("mix"), ["compile"], env: env, stderr_to_stdout: true)
  end
end
