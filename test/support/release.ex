defmodule Aerie.Release do
  @moduledoc "The release that `bin/release` makes of this checkout, made once for all tests that use it."

  @root Path.expand("../..", __DIR__)

  @doc """
  Makes it, or waits until another test has: its `folder`, the `tarball` in it, and what `bin/release` said (`output`).
  It is removed at the end of the suite. Copy what a test is going to change.
  """
  @spec made() :: %{folder: Path.t(), tarball: Path.t(), output: String.t()}
  def made do
    :global.trans({__MODULE__, self()}, fn ->
      case :persistent_term.get(__MODULE__, nil) do
        nil -> tap(make([]), &:persistent_term.put(__MODULE__, &1))
        made -> made
      end
    end)
  end

  @doc "Calls `bin/release` with these words and a folder whose name a shell would take apart."
  @spec make([String.t()]) :: %{folder: Path.t(), tarball: Path.t(), output: String.t()}
  def make(words) do
    name = "Aerie's $release & co #{System.unique_integer([:positive])}-#{System.pid()}"
    folder = Path.join(System.tmp_dir!(), name)
    ExUnit.after_suite(fn _result -> File.rm_rf!(folder) end)
    program = Path.join(@root, "bin/release")
    options = [env: Aerie.RunCase.environment(), stderr_to_stdout: true]
    {output, 0} = System.cmd(program, words ++ ["--output", folder], options)
    [tarball] = Path.wildcard(Path.join(folder, "*.tar.gz"))
    %{folder: folder, tarball: tarball, output: output}
  end
end
