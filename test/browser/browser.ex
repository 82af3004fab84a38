defmodule Aerie.Browser do
  @moduledoc "Runs scripts of tests with Node and the packages of the checkout's `node_modules`, and finds a Chromium for them."

  @root Path.expand("../..", __DIR__)

  @doc "What keeps scripts from running here, or nil."
  @spec missing() :: String.t() | nil
  def missing do
    cond do
      program() == nil -> "there is no Node >= 20"
      not File.exists?(Path.join(@root, "node_modules/.complete")) -> "node_modules/ is not installed"
      true -> nil
    end
  end

  @doc "What keeps a browser's tests from running here, or nil."
  @spec no_browser() :: String.t() | nil
  def no_browser, do: missing() || if(browser() == nil, do: "there is no Chromium")

  @doc """
  The tags of tests that cannot run here, for `ExUnit.start/1`. They are named loudly, because nothing else drives the real client.
  """
  @spec excluded() :: [atom()]
  def excluded do
    for {tag, reason} <- [node: missing(), chromium: no_browser()], reason != nil do
      IO.puts(
        :stderr,
        "\n*** SKIPPED: the tests of pages with #{tag}, because #{reason}. `bin/setup --tests` installs it. ***\n"
      )

      tag
    end
  end

  @doc """
  The tag of a browser's test that only `bin/test --full` runs. Without a browser it is not `:long`, because a tag that is included
  overrides the others of its test.
  """
  @spec long() :: :long | :chromium
  def long, do: if(browser(), do: :long, else: :chromium)

  @doc "The path of a browser."
  @spec browser() :: String.t() | nil
  def browser do
    unpacked = Path.join(@root, ".chromium/chromium")

    System.get_env("AERIE_CHROMIUM") ||
      Enum.find_value(
        ~w(chromium chromium-browser google-chrome google-chrome-stable),
        &System.find_executable/1
      ) ||
      if(File.exists?(unpacked), do: unpacked)
  end

  @doc "Runs a script: its output and exit status."
  @spec run(Path.t(), [String.t()]) :: {String.t(), non_neg_integer()}
  def run(script, arguments) do
    environment = [{"AERIE_CHROMIUM", browser()}, {"NODE_NO_WARNINGS", "1"}]
    [program | words] = modest() ++ [program(), script | arguments]
    System.cmd(program, words, stderr_to_stdout: true, env: environment)
  end

  @doc "The same as a port, for a test that acts while the script runs: the script prints lines, and reads them."
  @spec open(Path.t(), [String.t()]) :: port()
  def open(script, arguments) do
    environment =
      for {name, value} <- [AERIE_CHROMIUM: browser(), NODE_NO_WARNINGS: "1"], do: {~c"#{name}", ~c"#{value}"}

    [program | words] = modest() ++ [program(), script | arguments]

    Port.open({:spawn_executable, program}, [
      :binary,
      :exit_status,
      :stderr_to_stdout,
      line: 65_536,
      args: words,
      env: environment
    ])
  end

  @doc "A file of an npm package."
  @spec package(Path.t()) :: Path.t()
  def package(path), do: Path.join([@root, "node_modules", path])

  # As root, Chromium gives what draws a priority above everything else, and drawing without a graphics card never ends. This takes
  # the right to do so from it.
  defp modest do
    with setpriv when setpriv != nil <- System.find_executable("setpriv"),
         words = [setpriv, "--bounding-set=-sys_nice"],
         {_output, 0} <- System.cmd(setpriv, tl(words) ++ ["true"], stderr_to_stdout: true) do
      words
    else
      _not_root -> []
    end
  end

  defp program do
    own = Path.join(@root, ".node/bin/node")
    Enum.find([System.find_executable("node"), own], &(&1 != nil and new_enough?(&1)))
  end

  defp new_enough?(node) do
    with true <- File.exists?(node),
         {"v" <> version, 0} <- System.cmd(node, ["--version"], stderr_to_stdout: true) do
      version |> String.split(".") |> hd() |> String.to_integer() >= 20
    else
      _none -> false
    end
  end
end
